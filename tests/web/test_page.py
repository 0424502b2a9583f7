"""The page in a browser, from a photo dropped to files saved, by mouse and by keyboard."""

import json
import math
import re
import xml.etree.ElementTree as Xml
import zipfile

import numpy as np
import pytest
from commands import noting
from pages import SIZES
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from scenes import candidate_at

from skyline import read_dem, read_photo, read_trace, write_located


def off_m(dem, pose):
    """Return how far a pose is from where the photo was taken."""
    easting, northing = read_dem([dem]).frame.from_lonlat(pose["lon"], pose["lat"])
    return math.hypot(easting - 601_800.0, northing - 5_178_000.0)


def saved(page, downloads, kind, suffix):
    """Save one kind of file, and return its path; Chromium makes an empty file first."""
    before = set(downloads.iterdir())
    page.click(f"#save-{kind}")

    def whole():
        new = set(downloads.glob(f"*{suffix}")) - before
        return [one for one in new if one.stat().st_size]

    return page.until(whole)[0]


def test_a_photo_is_dropped_mended_found_dragged_fitted_and_saved(page, photo, dem, downloads):
    assert page.find("#welcome").is_displayed()
    page.open(photo)
    assert not page.find("#welcome").is_displayed()
    found = page.rows()
    middle = len(found) // 2
    row = np.nanmean(np.array(found[middle - 60 : middle + 60], dtype=float))

    page.draw("sky", [(middle - 80, row + 60), (middle, row + 60), (middle + 80, row + 60)])
    assert page.rows()[middle] > found[middle] + 40
    page.click("#undo")
    page.until(lambda: page.rows() == found)
    page.draw("erase", [(10, row), (40, row)])
    assert page.rows()[20] is None
    page.click("#undo")
    page.until(lambda: page.rows() == found)
    page.find("#tools label:has([value=move])").click()
    page.match()
    assert "Found" in page.find("#answer").text
    assert off_m(dem, page.state("state.pose")) < 60.0
    assert len(page.all("#map path[stroke='#fff']")) == 2  # the store's frame and the ellipse
    page.settled()
    candidates = page.all("#candidates button")
    candidates[-1].click()
    assert page.state("state.chosen") == len(candidates) - 1
    page.all("#candidates button")[0].click()
    best = page.settled()

    before = page.measured("look")
    page.drag(".camera", 9, 6, steps=3)
    page.until(lambda: page.measured("look") > before + 1)
    moved = page.state("state.pose")
    assert off_m(dem, moved) > 60.0
    page.until(lambda: page.state("state.sight.median_gap_deg") > best)
    apart = page.state("state.sight.median_gap_deg")
    page.click("#fit")
    page.until(lambda: page.find("#status").text == "Fitted")
    page.until(lambda: page.state("state.sight.median_gap_deg") < apart / 2)
    fitted = page.state("state.pose")
    assert off_m(dem, fitted) < 60.0

    for name, size in SIZES.items():
        page.resize(*size)
        assert fits_on(page), name
    page.resize(*SIZES["wide"])
    check_files(page, downloads, fitted, len(found))
    assert page.alerts() == []
    assert page.asked_elsewhere() == []


def verdict(page):
    """Return the texts on the page that may say how sure a pose is."""
    return page.find("#answer").text, page.find("#pose-verdict").text


LEAVING = {
    "drag": lambda page: page.drag(".camera", 30, 10),
    "turn": lambda page: page.drag(".turn", 20, 20),
    "heading": lambda page: page.type_into("#hand-heading_deg-number", "151.3"),
    "field of view": lambda page: page.type_into("#hand-fov_deg-number", "66"),
    "place": lambda page: page.type_into("#hand-lat", "46.75"),
}


def test_a_verdict_is_of_the_pose_that_was_judged(page, narrow, downloads):
    page.open(narrow)
    page.script("document.getElementById('known').open = true")
    page.click("#fov-known")
    # The whole photo is 60 degrees wide.
    page.script("const it = document.getElementById('fov'); it.value = 32; it.oninput()")
    page.match()
    found = page.find("#answer").text
    assert "Found within" in found
    second = page.all("#candidates button")[1]
    chance = second.text.split("\n")[1]
    second.click()
    assert page.find("#answer").text.startswith(f"Candidate 2: {chance} sure within 200 m.")
    check_origin(page, downloads, "found, rank 2", "Pose 2, chosen by a person: latitude")
    for leave in LEAVING.values():
        page.all("#candidates button")[0].click()
        assert verdict(page) == (found, "")
        leave(page)
        answer, said = verdict(page)
        assert "left the candidates" in answer
        assert "no search has judged this pose" in said
        assert "sure" not in answer + said
    check_origin(page, downloads, "set by hand", "Set by hand: latitude")

    page.type_into("#hand-heading_deg-number", "320")
    page.click("#fit")
    page.until(lambda: page.find("#status").text == "The fit has failed")
    answer, said = verdict(page)
    assert "Found" not in answer
    assert re.match(
        r"The fit has failed: the skylines are \d\.\d\d degrees apart \(rms\) over \d+ % of the "
        r"skyline; candidate 1, \d+ m and \d+ degrees of heading away, fits better\. ",
        said,
    )
    check_origin(page, downloads, "fitted", "Fitted, and the fit has failed: latitude")


@pytest.mark.parametrize("moved", [False, True])
def test_a_fit_at_a_candidate_has_its_verdict(page, photo, downloads, moved):
    page.open(photo)
    page.match()
    found, _ = verdict(page)
    best = page.state("state.photo.result.candidates[0].pose")
    if moved:
        page.drag(".camera", 3, 2, steps=2)
        page.type_into("#hand-heading_deg-number", f"{best['heading_deg'] + 1.0:.1f}")
        assert "Found" not in verdict(page)[0]
    page.settled()
    page.click("#fit")
    page.until(lambda: page.find("#status").text == "Fitted")
    answer, said = verdict(page)
    assert answer == found
    assert re.match(r"Fitted to candidate 1: the skylines are 0\.\d\d degrees apart \(rms\)", said)
    assert page.find("#candidates [aria-current=true]").get_attribute("data-rank") == "0"
    features = json.loads(saved(page, downloads, "geojson", ".geojson").read_text())["features"]
    assert features[0]["properties"]["origin"] == "found, rank 1"
    assert features[0]["properties"]["confidence"] == best["confidence"]
    report = saved(page, downloads, "report", ".html").read_text()
    sure = f"confidence {100.0 * best['confidence']:.0f}\xa0%"
    assert re.search(rf"Taken at latitude [^;]*, {sure}, right within 200 m\.", report)
    # What is known has changed, so no search stands, and the fit is judged alone.
    page.script("document.getElementById('known').open = true")
    page.click("#heading-known")
    assert verdict(page) == (
        "The skyline, or what you know, has changed since the last search. Find the place again.",
        "",
    )
    page.click("#fit")
    page.until(lambda: "No search has judged this pose" in verdict(page)[1])


def check_origin(page, downloads, origin, report):
    """Save files that say where a pose comes from, and how sure it is where that is its own."""
    rank = int(origin[-1]) if origin.startswith("found") else None
    features = json.loads(saved(page, downloads, "geojson", ".geojson").read_text())["features"]
    properties = features[0]["properties"]
    assert (properties["rank"], properties["origin"]) == (rank, origin)
    assert (properties["confidence"] is None) == (rank is None)
    said = saved(page, downloads, "report", ".html").read_text()
    assert report in said
    assert "right within" not in said
    with Image.open(saved(page, downloads, "names", ".png")) as picture:
        assert picture.height > picture.width * 0.6
    with Image.open(saved(page, downloads, "photo", ".jpg")) as picture:
        method = picture.getexif().get_ifd(IFD.GPSInfo)[GPS.GPSProcessingMethod]
    by_hand = origin == "set by hand"
    assert method == b"ASCII\0\0\0" + (b"MANUAL" if by_hand else f"SKYLINE: {origin}".encode())


def test_a_verdict_is_of_the_skyline_and_the_knowledge_that_were_searched_with(page, photo):
    page.open(photo)
    page.match()
    found = page.find("#answer").text
    assert "Found within" in found
    page.draw("erase", [(10, 100), (40, 100)])
    assert "Found" not in page.find("#answer").text
    assert page.all("#candidates button") == page.all(".spot") == []
    assert page.find("#photos .state").text == "ready"
    page.click("#undo")
    page.until(lambda: page.find("#answer").text == found)
    assert page.find("#photos .state").text == "✓ found"
    page.script("document.getElementById('known').open = true")
    for change in ("fov-known", "heading-known", "near-known", "elevation-known"):
        page.click(f"#{change}")
        assert "Found" not in page.find("#answer").text
        page.click(f"#{change}")
        assert page.find("#answer").text == found
    page.type_into("#eye", "2")
    assert "Found" not in page.find("#answer").text
    assert page.all("#candidates button") == []


def test_the_page_asks_what_the_photo_says_without_rounding(page, photo, dem, tmp_path):
    noted = tmp_path / "noted.jpg"
    place = candidate_at(602_000.0, 5_177_900.0, 141.377, frame=read_dem([dem]).frame)
    write_located(photo, noted, place)
    noting(noted, noted, {Base.FocalLengthIn35mmFilm: 31})
    page.open(noted)
    said = read_photo(noted)
    page.script("document.getElementById('known').open = true")
    for name in ("heading", "near"):
        page.click(f"#{name}-known")
    known = page.of("known", "it.known()")
    assert "fov_deg" not in known
    assert known["heading_deg"] == [said.noted.heading_deg, 30]
    assert tuple(known["near"][:2]) == said.noted.lonlat_deg
    page.match()
    # A slider that a person moves counts as it is shown.
    page.script("const it = document.getElementById('heading'); it.value = 150; it.oninput()")
    assert page.of("known", "it.known()")["heading_deg"][0] == 150
    page.browser.refresh()
    page.until(lambda: "Found" in page.find("#answer").text)
    assert page.of("known", "it.known()") == known


def fits_on(page):
    """Whether nothing reaches beyond the window, and every pane has room."""
    return page.script(
        "return document.documentElement.scrollWidth <= innerWidth && "
        "['photo', 'map', 'side'].every((id) => {"
        " const box = document.getElementById(id).getBoundingClientRect();"
        " return box.width > 250 && box.height > 200 && box.right <= innerWidth + 1"
        " && box.bottom <= innerHeight + 1; })"
    )


def check_files(page, downloads, pose, width):
    """Save every kind of file and read it back with something else."""
    place = pytest.approx(pose["lon"], abs=1e-5), pytest.approx(pose["lat"], abs=1e-5)
    camera = Xml.parse(saved(page, downloads, "kml", ".kml")).find(".//{*}PhotoOverlay/{*}Camera")
    assert (float(camera.findtext("{*}longitude")), float(camera.findtext("{*}latitude"))) == place
    with (
        zipfile.ZipFile(saved(page, downloads, "kmz", ".kmz")) as archive,
        archive.open("files/01.jpg") as file,
        Image.open(file) as picture,
    ):
        assert picture.size[0] == width
    waypoint = Xml.parse(saved(page, downloads, "gpx", ".gpx")).find("{*}wpt")
    assert (float(waypoint.get("lon")), float(waypoint.get("lat"))) == place
    trace = read_trace(saved(page, downloads, "trace", ".csv"))
    assert trace.width_px == width
    report = saved(page, downloads, "report", ".html").read_text()
    assert f"{pose['lat']:.5f}" in report
    with Image.open(saved(page, downloads, "photo", ".jpg")) as picture:
        gps = picture.getexif().get_ifd(IFD.GPSInfo)
    degrees, minutes, seconds = (float(part) for part in gps[GPS.GPSLatitude])
    assert degrees + minutes / 60.0 + seconds / 3600.0 == place[1]
    assert float(gps[GPS.GPSImgDirection]) == pytest.approx(pose["heading_deg"], abs=0.01)
    load_trace(page, downloads, page.rows())


def load_trace(page, downloads, rows):
    """Load the trace that was saved over a skyline that was drawn, undo and redo that."""
    page.draw("line", [(100, 50), (400, 50)])
    drawn = page.rows()
    assert drawn[200] == pytest.approx(50.0, abs=1.0)
    trace = next(path for path in downloads.iterdir() if path.suffix == ".csv")
    page.find("#trace-file").send_keys(str(trace))
    page.until(lambda: page.rows() == rows)
    page.click("#undo")
    page.until(lambda: page.rows() == drawn)
    page.click("#redo")
    page.until(lambda: page.rows() == rows)
    assert not page.state("state.photo.strokes.length")


def test_a_narrowed_search_a_cancelled_one_and_one_without_an_answer(page, photo, dem):
    page.open(photo)
    page.click("#known summary")
    page.click("#near-known")
    page.drag(".centre", 40, 0)
    page.click("#elevation-known")
    page.type_into("#low", "8000")
    page.type_into("#high", "8900")
    page.click("#find")
    page.until(lambda: any("no place of the store" in said for said in page.alerts()))
    page.click("#elevation-known")
    page.click("#near-known")
    page.click("#heading-known")
    page.script("const it = document.getElementById('heading'); it.value = 300; it.oninput()")
    page.match()
    assert "No answer" in page.find("#answer").text
    page.click("#heading-known")
    page.script(
        "document.getElementById('find').click(); document.getElementById('cancel').click()"
    )
    page.until(lambda: page.find("#status").text == "Cancelled")


def test_a_message_is_shown_once_and_as_long_as_it_is_true(page, photo, tmp_path):
    page.open(photo)
    for name in ("first.jpg", "second.jpg"):
        (tmp_path / name).write_text("no photo")
        page.drop(tmp_path / name)
        page.until(lambda name=name: [one for one in page.messages() if name in one])
    assert len(page.messages()) == 1
    page.click("#known summary")
    page.click("#elevation-known")
    page.type_into("#low", "8000")
    page.type_into("#high", "8900")
    for _ in range(2):
        page.click("#find")
        page.until(lambda: len(page.messages()) == 2)
    assert "no place of the store" in page.messages()[1]
    page.click("#elevation-known")
    assert len(page.messages()) == 1
    page.click("#photos li:last-child [aria-label^=Remove]")
    assert page.messages() == []


def test_a_photo_without_mountains_says_so_with_nothing_to_press(page, photo, tmp_path):
    noise = np.random.default_rng(1).integers(0, 255, (300, 400), dtype=np.uint8)
    Image.fromarray(noise).convert("RGB").save(tmp_path / "noise.png")
    page.open(tmp_path / "noise.png")
    assert page.find("#answer").text.startswith("No skyline of mountains is found: 0.0 degrees")
    assert not page.find("#find").is_enabled()
    page.open(photo)
    assert page.find("#answer").text == ""
    assert page.find("#find").is_enabled()


def test_a_place_is_read_as_it_is_written_or_not_at_all(page):
    """Half of a place would be another place, without a word."""
    for text, place in (
        ("46.8, -9.84", [46.8, -9.84]),
        ("46.8° N 9.84 W", [46.8, -9.84]),
        ("S33.5 W70.2", [-33.5, -70.2]),
        ("−33.5, −70.2", [-33.5, -70.2]),
        ("9.84 E, 46.8 N", [46.8, 9.84]),
        ("33.5 S 70.2 O", None),
        ("46,8 9,84", None),
    ):
        found = f"it.placeIn({json.dumps(text)})"
        assert page.of("known", f"{found} && [{found}.lat, {found}.lon]") == place, text

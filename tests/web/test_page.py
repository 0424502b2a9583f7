"""The page in a browser, from a photo dropped to files saved, by mouse and by keyboard."""

import json
import math
import re
import socket
import xml.etree.ElementTree as Xml
import zipfile

import numpy as np
import pytest
from commands import noting
from pages import SIZES, Page, serving
from PIL import Image
from PIL.ExifTags import GPS, IFD, Base
from rasterio.transform import Affine
from scenes import SPACING_M, candidate_at, fractal, write_dem
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.ui import Select

from skyline import build_places, read_dem, read_photo, read_trace, write_located

NAMED = "({0}.id || {0}.name || {0}.className || {0}.textContent)".format


@pytest.fixture
def page(chromium, served):
    """The page, with nothing on it."""
    made = Page(chromium, served)
    yield made
    severe = (entry for entry in chromium.get_log("browser") if entry["level"] == "SEVERE")
    # The log also holds what the server refuses with words, and, some time after, that Chromium
    # left a page of an earlier test with its strokes unsaved.
    expected = ("status of 400", "'beforeunload' confirmation panel")
    messages = [entry["message"] for entry in severe]
    assert [said for said in messages if not any(one in said for one in expected)] == []


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


def type_into(page, selector, text):
    """Type a number into a field, and leave it."""
    page.script("arguments[0].scrollIntoView({block: 'center'})", page.find(selector))
    page.find(selector).clear()
    page.find(selector).send_keys(text, Keys.ENTER)


LEAVING = {
    "drag": lambda page: page.drag(".camera", 30, 10),
    "turn": lambda page: page.drag(".turn", 20, 20),
    "heading": lambda page: type_into(page, "#hand-heading_deg-number", "151.3"),
    "field of view": lambda page: type_into(page, "#hand-fov_deg-number", "66"),
    "place": lambda page: type_into(page, "#hand-lat", "46.75"),
}


@pytest.fixture
def narrow(photo, tmp_path):
    """The middle half of the photo: other places resemble it more than the whole."""
    path = tmp_path / "narrow.jpg"
    with Image.open(photo) as image:
        width, height = image.size
        image.crop((width // 4, 0, 3 * width // 4, height)).save(path, quality=95)
    return path


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

    type_into(page, "#hand-heading_deg-number", "320")
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
        type_into(page, "#hand-heading_deg-number", f"{best['heading_deg'] + 1.0:.1f}")
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
    type_into(page, "#eye", "2")
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


def test_everything_is_reached_by_keyboard(page, photo):
    page.open(photo)
    found = page.rows()
    page.script("document.getElementById('photo').focus()")
    page.press("s", Keys.ENTER)
    page.press(Keys.ARROW_RIGHT, times=12)
    page.press(Keys.ARROW_UP, times=30)
    count = page.measured("stroke")
    page.press(Keys.ENTER)
    page.until(lambda: page.measured("stroke") > count)
    assert page.rows() != found
    ActionChains(page.browser).key_down(Keys.CONTROL).send_keys("z").key_up(Keys.CONTROL).perform()
    page.until(lambda: page.rows() == found)
    page.press("+", "+", "0", "1", "0", "]", "[", "m")
    page.press(Keys.TAB)
    reached = {
        page.script("return document.activeElement.id || document.activeElement.textContent")
    }
    page.script("document.getElementById('find').focus()")
    page.press(Keys.ENTER)
    page.until(lambda: page.find("#answer").text)
    page.settled()
    before = page.state("state.pose")
    page.script("document.querySelector('.camera').focus()")
    page.press(Keys.ARROW_LEFT, times=3)
    page.until(lambda: page.state("state.pose.lon") < before["lon"])
    page.script("document.querySelector('.turn').focus()")
    page.press(Keys.ARROW_RIGHT, times=3)
    page.until(lambda: page.state("state.pose.heading_deg") != before["heading_deg"])
    page.script("document.getElementById('hand-pitch_deg').focus()")
    page.press(Keys.ARROW_RIGHT, times=3)
    page.until(lambda: page.state("state.pose.pitch_deg") > before["pitch_deg"])

    page.script("document.getElementById('known').open = true; document.body.focus()")
    page.script("document.activeElement.blur()")
    for _ in range(120):
        page.press(Keys.TAB)
        reached.add(page.script(f"return {NAMED('document.activeElement')}"))
    enabled = page.script(
        "return [...document.querySelectorAll('button, input, summary, canvas[tabindex]')]"
        ".filter((one) => !one.disabled && one.checkVisibility() && one.type !== 'radio')"
        f".map((one) => {NAMED('one')})"
    )
    assert set(enabled) - reached == set()
    assert {"tool", "photo"} <= reached


def test_every_control_has_a_name_and_every_text_its_contrast(page, photo):
    page.open(photo)
    page.match()
    page.script("document.getElementById('known').open = true")
    tree = page.browser.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    roles = {"button", "slider", "checkbox", "radio", "spinbutton", "progressbar", "link"}
    controls = [node for node in tree if node.get("role", {}).get("value") in roles]
    assert len(controls) > 30
    assert [node for node in controls if not node.get("name", {}).get("value")] == []
    poor = page.script(CONTRAST)
    assert poor == []


CONTRAST = """
const parse = (text) => text.match(/[\\d.]+/g).map(Number);
const light = ([r, g, b]) => [r, g, b].map((value) => value / 255)
  .map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4))
  .reduce((sum, value, k) => sum + value * [0.2126, 0.7152, 0.0722][k], 0);
const behind = (one) => {
  for (let at = one; at; at = at.parentElement) {
    const colour = parse(getComputedStyle(at).backgroundColor);
    if (colour.length < 4 || colour[3] > 0.7) return colour;
  }
  return [255, 255, 255];
};
return [...document.querySelectorAll("body *")].filter((one) =>
  one.checkVisibility() && !one.closest("button:disabled, :disabled") &&
  [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim()))
  .map((one) => {
    const [front, back] = [light(parse(getComputedStyle(one).color)), light(behind(one))];
    const ratio = (Math.max(front, back) + 0.05) / (Math.min(front, back) + 0.05);
    return [one.textContent.trim().slice(0, 30), ratio];
  }).filter(([, ratio]) => ratio < 4.5);
"""


def test_a_narrowed_search_a_cancelled_one_and_one_without_an_answer(page, photo, dem):
    page.open(photo)
    page.click("#known summary")
    page.click("#near-known")
    page.drag(".centre", 40, 0)
    page.click("#elevation-known")
    type_into(page, "#low", "8000")
    type_into(page, "#high", "8900")
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
    type_into(page, "#low", "8000")
    type_into(page, "#high", "8900")
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


def test_a_second_tab_follows_the_first(page, photo):
    page.open(photo)
    first = page.browser.current_window_handle
    page.browser.switch_to.new_window("tab")
    page.resize(*SIZES["wide"])
    page.reload()
    page.until(lambda: page.state("state.rows && state.rows.length"))
    page.draw("line", [(100, 50), (400, 50)])
    assert page.find("#unsaved").text.startswith("Not saved: the mended skyline of photo.jpg.")
    page.script("document.getElementById('known').open = true")
    Select(page.find("#projection")).select_by_value("cylindrical")
    page.until(lambda: page.state("state.photo.projection") == "cylindrical")
    second = page.browser.current_window_handle
    page.browser.switch_to.window(first)
    page.until(lambda: page.state("state.photo.projection") == "cylindrical")
    page.until(lambda: page.state("state.photo.strokes.length") == 1)
    page.until(lambda: page.state("state.rows && Math.abs(state.rows[200] - 50) < 1"))
    page.browser.switch_to.window(second)
    page.click("#photos [aria-label^=Remove]")
    page.browser.close()
    page.browser.switch_to.window(first)
    page.until(lambda: page.find("#welcome").is_displayed())


def test_a_search_that_another_tab_has_begun_can_be_cancelled(page, photo):
    page.open(photo)
    number = page.state("state.photo.id")

    def told(done):
        progress = {"photo": number, "step": "fitting", "share": 0.5, "done": done}
        page.of("state", f"it.emit('progress', {json.dumps(progress)})")

    told(False)
    assert page.find("#cancel").is_displayed()
    assert not page.find("#find").is_enabled()
    told(True)
    page.until(lambda: page.find("#find").is_enabled())


def test_a_bad_photo_is_one_line_and_a_reload_keeps_the_good_one(page, photo, tmp_path):
    text = tmp_path / "letter.jpg"
    text.write_text("no photo")
    page.drop(text)
    said = page.until(page.alerts)
    assert len(said) == 1
    assert said[0].startswith("letter.jpg is not an image that can be read")
    page.open(photo)
    page.match()
    page.draw("line", [(100, 50), (400, 50)])
    answer, rows = page.find("#answer").text, page.rows()
    page.browser.refresh()
    page.until(lambda: page.state("state.rows && state.rows.length"))
    assert page.state("state.photo.name") == "photo.jpg"
    assert page.rows() == rows
    page.until(lambda: page.find("#answer").text == answer)


def test_a_photo_that_is_dropped_twice_is_one_photo(page, photo, tmp_path):
    again = tmp_path / "again.jpg"
    again.write_bytes(photo.read_bytes())
    page.open(photo)
    page.drop(again)
    page.until(lambda: page.find("#status").text == "again.jpg is open already")
    assert page.state("state.photos.map((one) => one.name)") == ["photo.jpg"]


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


def test_many_photos_are_found_in_turn_and_say_where_they_were(page, photo, dem, tmp_path):
    place = candidate_at(602_500.0, 5_178_500.0, 33.0, frame=read_dem([dem]).frame)
    located = tmp_path / "located.jpg"
    write_located(photo, located, place)
    page.open(photo)
    page.drop(located)
    states = ".map((one) => one.state)"
    page.until(lambda: page.state(f"state.photos{states}") == ["ready", "ready"])
    page.until(lambda: page.find("#find-all").is_displayed())
    page.click("#find-all")
    page.until(lambda: page.state(f"state.photos{states}") == ["answered", "answered"])
    assert page.state("state.photo.name") == "located.jpg"
    page.click("#known summary")
    page.click("#near-known")
    near = page.of("known", "it.known().near")
    assert near[:2] == pytest.approx([place.lon, place.lat], abs=1e-5)
    # While the server is silent, the answer of one photo does not stand under another.
    page.script("window.asked = window.fetch; window.fetch = () => new Promise(() => {})")
    assert page.find("#answer").text
    page.click("#photos li:first-child .pick")
    assert page.find("#answer").text == ""
    assert not page.find("#find").is_enabled()
    page.script("window.fetch = window.asked")
    page.click("#photos li:first-child .pick")
    page.until(lambda: page.state("state.photo.name") == "photo.jpg")
    page.settled()
    page.click("#photos li:first-child [aria-label^=Remove]")
    page.until(lambda: page.find("#welcome").is_displayed())
    assert page.state("state.photos.length") == 1


def test_what_is_said_of_a_photo_and_its_pose_by_hand_are_its_own(page, photo, narrow):
    """Another photo is shown, the page is loaded again, and all photos are found."""
    page.open(photo)
    page.script("document.getElementById('known').open = true")
    page.click("#fov-known")
    page.script("const it = document.getElementById('fov'); it.value = 61; it.oninput()")
    page.click("#heading-known")
    page.script("const it = document.getElementById('heading'); it.value = 141; it.oninput()")
    said = page.of("known", "it.known()")
    assert (said["fov_deg"], said["heading_deg"]) == (61, [141, 30])
    page.click("#place-here")
    type_into(page, "#hand-heading_deg-number", "151.3")

    def shows(name):
        page.until(lambda: page.state(f"state.rows && state.photo.name == '{name}'"))
        page.until(lambda: page.find("#find").is_enabled())

    page.open(narrow)
    other = page.of("known", "it.known()")
    assert (other.get("fov_deg"), other["heading_deg"]) == (None, None)
    assert page.state("state.pose") is None
    page.click("#photos li:first-child .pick")
    shows("photo.jpg")
    assert page.of("known", "it.known()") == said
    assert page.state("state.pose.heading_deg") == 151.3
    assert page.state("state.origin") == "hand"
    page.reload()
    shows("photo.jpg")
    assert page.of("known", "it.known()") == said
    assert page.state("state.pose.heading_deg") == 151.3

    page.click("#find-all")
    page.until(lambda: page.state("state.photos.every((one) => one.result)"))
    asked = page.state("state.photos.map((one) => one.result.asked)")
    assert asked == [said, other]
    page.click("#photos li:first-child .pick")
    shows("photo.jpg")
    assert page.state("state.origin") == "found"


def test_the_page_says_where_photos_go(chromium, served, store):
    assert Page(chromium, served).find("#privacy").text == "Photos stay on this machine."
    with serving(store, "--host", "0.0.0.0") as server:
        said = Page(chromium, server).find("#privacy").text
    machine = socket.gethostname()
    assert said.startswith(f"Photos go to {machine}, the machine that serves this page, and to no")


def test_what_a_person_looks_for_is_in_sight(page, photo, dem, tmp_path):
    noting = tmp_path / "noting.jpg"
    frame = read_dem([dem]).frame
    write_located(photo, noting, candidate_at(602_300.0, 5_178_200.0, 33.0, frame=frame))
    page.open(noting)
    page.press("s")
    assert page.find("[name=tool]:checked").get_attribute("value") == "sky"
    page.find("#find").send_keys("m")
    assert page.find("[name=tool]:checked").get_attribute("value") == "move"
    assert len(page.all(".noted")) == 1
    page.match()
    page.settled()
    best = page.state("state.photo.result.candidates[0].pose")
    assert within(page, "#map", page.find(".spot.best"))

    def middle(rect):
        return np.array([rect["x"] + rect["width"] / 2, rect["y"] + rect["height"] / 2])

    for spot in page.all(".spot:not(.chosen)"):
        assert np.hypot(*(middle(spot.rect) - middle(page.find(".turn").rect))) > 23.0
    link = page.find("#answer a").get_attribute("href")
    place = f"{best['lat']:.5f}", f"{best['lon']:.5f}"
    assert link == "https://www.openstreetmap.org/?mlat={0}&mlon={1}#map=14/{0}/{1}".format(*place)
    for selector in ("#save-photo", "#save-trace", "#load-trace"):
        assert within(page, "body", page.find(selector))
    assert page.asked_elsewhere() == []


_WRITTEN = """(() => {
  const written = [], ctx = document.createElement("canvas").getContext("2d");
  ctx.fillText = (text, middle, foot) => {
    const half = ctx.measureText(text).width / 2;
    written.push([text, middle - half, middle + half, foot]);
  };
  const summits = [2, 358, 180, 181, 182, 183, 184, -50, 900].map(
    (column_px) => ({ label: `Piz ${column_px}`, column_px, row_px: 90 }));
  it.drawSummits(ctx, { scale: 1, left: 0, top: 0, width: 360, height: 200 }, summits, 24);
  return written;
})()"""


def test_names_keep_within_a_phone_s_width_and_off_other_words(page):
    page.resize(360, 740)
    *names, note = page.of("layers", _WRITTEN)
    assert [name for name, *_ in names] == [f"Piz {at}" for at in (2, 358, 180, 181, 182, 183)]
    assert all(0.0 <= left < right <= 360.0 for _, left, right, _ in names)
    assert note[0] == "1 peak has no room for a name"
    assert note[3] < 200 - 8 - 24
    # Without a photo the tools are hidden.
    tops = page.script(
        "document.getElementById('tools').hidden = false;"
        "return ['out', 'fit', 'pixel', 'in'].map((one) => "
        "document.getElementById(`zoom-${one}`).getBoundingClientRect().top)"
    )
    page.resize(*SIZES["wide"])
    assert len(set(tops)) == 1


def within(page, outer, inner):
    """Whether an element lies wholly in another and in the window."""
    return page.script(
        "const [one, box] = [arguments[1], arguments[0]].map((it) => it.getBoundingClientRect());"
        "return one.left >= box.left && one.right <= box.right && one.top >= box.top &&"
        " one.bottom <= Math.min(box.bottom, innerHeight)",
        page.find(outer),
        inner,
    )


def test_a_store_across_the_antimeridian_is_one_map(chromium, photo, tmp_path):
    grid = Affine(SPACING_M, 0.0, 817_650.0, 0.0, -SPACING_M, 8_119_650.0)
    heights = fractal(110, 120, 250.0, seed=11)
    dem = write_dem(tmp_path / "dem.tif", heights, "EPSG:32760", transform=grid)
    terrain, store = read_dem([dem]), tmp_path / "store.h5"
    build_places(terrain, store, 300.0)
    located = tmp_path / "located.jpg"
    place = candidate_at(819_440.0, 8_118_000.0, 90.0, frame=terrain.frame)
    write_located(photo, located, place)
    with serving(store) as server:
        page = Page(chromium, server)
        middle = page.of("map", "it.middle()")
        assert abs(middle["lon"]) == pytest.approx(180.0, abs=0.01)
        box = page.find("#map path").rect
        assert 100 < box["width"] < 1000  # the store's frame is not drawn round the world
        tiles = "return document.querySelectorAll('.leaflet-tile-loaded').length"
        page.until(lambda: page.script(tiles) > 1)
        page.open(located)
        page.click("#known summary")
        page.click("#near-known")
        near = page.of("known", "it.known().near")
        assert near[:2] == pytest.approx([place.lon, place.lat], abs=1e-5)
        page.click("#place-here")
        page.drag(".camera", 60, 0)
        east = page.state("state.pose")["lon"]
        assert -180.0 <= east < -179.9
        page.drag(".camera", -120, 0)
        assert 179.9 < page.state("state.pose")["lon"] <= 180.0
        assert page.alerts() == []

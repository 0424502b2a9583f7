"""The page in a browser, from a photo dropped to files saved, by mouse and by keyboard."""

import json
import math
import re
import xml.etree.ElementTree as Xml
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from pages import SIZES, Page
from PIL import Image
from PIL.ExifTags import GPS, IFD
from scenes import candidate_at
from selenium.webdriver.common.keys import Keys

from skyline import read_dem, read_trace, web, write_located

NAMED = "({0}.id || {0}.name || {0}.className || {0}.textContent)".format

EASTING_M, NORTHING_M = 601_800.0, 5_178_000.0


@pytest.fixture
def page(chromium, served):
    """The page, with nothing on it."""
    made = Page(chromium, served)
    yield made
    told = (entry for entry in chromium.get_log("browser") if entry["level"] == "SEVERE")
    # What the server refuses with words is in the log, too.
    assert [entry for entry in told if "status of 400" not in entry["message"]] == []


def off_m(dem, pose):
    """Return how far a pose is from where the photo was taken."""
    easting, northing = read_dem([dem]).frame.from_lonlat(pose["lon"], pose["lat"])
    return math.hypot(easting - EASTING_M, northing - NORTHING_M)


def saved(page, downloads, kind, suffix):
    """Save one kind of file, and return its path."""
    before = set(downloads.iterdir())
    page.click(f"#save-{kind}")

    def new():
        there = set(downloads.iterdir()) - before
        return [path for path in there if path.suffix == suffix]

    return page.until(new)[0]


def test_a_photo_is_dropped_mended_found_dragged_fitted_and_saved(
    page, photo, dem, downloads, tmp_path
):
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
    page.settled()
    candidates = page.all("#candidates button")
    candidates[-1].click()
    assert page.state("state.chosen") == len(candidates) - 1
    page.all("#candidates button")[0].click()
    best = page.settled()

    before = page.of("hand", "it.live.shown")
    page.drag(".camera", 9, 6, steps=3)
    page.until(lambda: page.of("hand", "it.live.shown") > before + 1)
    moved = page.state("state.pose")
    assert off_m(dem, moved) > 60.0
    page.until(lambda: page.state("state.sight.gap") > best)
    apart = page.state("state.sight.gap")
    page.click("#fit")
    page.until(lambda: page.find("#status").text == "Fitted")
    page.until(lambda: page.state("state.sight.gap") < apart / 2)
    fitted = page.state("state.pose")
    assert off_m(dem, fitted) < 60.0

    for name, size in SIZES.items():
        page.resize(*size)
        page.screenshot(tmp_path / f"{name}.png")
        assert fits_on(page)
    page.resize(*SIZES["wide"])
    check_files(page, downloads, fitted, len(found))
    assert page.alerts() == []
    assert page.asked_elsewhere() == []


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
    features = json.loads(saved(page, downloads, "geojson", ".geojson").read_text())["features"]
    assert tuple(features[0]["geometry"]["coordinates"]) == place
    assert features[0]["properties"]["query"] == "photo.jpg"
    kml = Xml.parse(saved(page, downloads, "kml", ".kml"))
    camera = kml.find(".//{*}PhotoOverlay/{*}Camera")
    assert (float(camera.findtext("{*}longitude")), float(camera.findtext("{*}latitude"))) == place
    with zipfile.ZipFile(saved(page, downloads, "kmz", ".kmz")) as archive:
        with archive.open("files/01.jpg") as file, Image.open(file) as picture:
            assert picture.size[0] == width
        href = Xml.fromstring(archive.read("doc.kml")).findtext(
            ".//{*}PhotoOverlay/{*}Icon/{*}href"
        )
        assert href == "files/01.jpg"
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
    assert float(gps[GPS.GPSImgDirection]) == pytest.approx(pose["heading"], abs=0.01)
    load_trace(page, downloads, page.rows())


def load_trace(page, downloads, rows):
    """Load the trace that was saved, after another skyline was drawn."""
    page.draw("line", [(100, 50), (400, 50)])
    assert page.rows()[200] == pytest.approx(50.0, abs=1.0)
    trace = next(path for path in downloads.iterdir() if path.suffix == ".csv")
    page.find("#trace-file").send_keys(str(trace))
    page.until(lambda: page.rows()[200] == rows[200])
    assert page.rows() == rows


def test_everything_is_reached_by_keyboard(page, photo):
    page.open(photo)
    found = page.rows()
    page.script("document.getElementById('photo').focus()")
    page.press("s", Keys.ENTER)
    page.press(Keys.ARROW_RIGHT, times=12)
    page.press(Keys.ARROW_UP, times=30)
    count = page.solved()
    page.press(Keys.ENTER)
    page.until(lambda: page.solved() > count)
    assert page.rows() != found
    page.control("z")
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
    page.until(lambda: page.state("state.pose.heading") != before["heading"])
    page.script("document.getElementById('hand-pitch').focus()")
    page.press(Keys.ARROW_RIGHT, times=3)
    page.until(lambda: page.state("state.pose.pitch") > before["pitch"])

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
    for name, value in (("low", "8000"), ("high", "8900")):
        page.find(f"#{name}").clear()
        page.find(f"#{name}").send_keys(value)
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


def test_many_photos_are_found_in_turn_and_say_where_they_were(page, photo, dem, tmp_path):
    frame = read_dem([dem]).frame
    lon, lat = (float(one) for one in frame.to_lonlat(602_500.0, 5_178_500.0))
    told = tmp_path / "told.jpg"
    write_located(photo, told, candidate_at(602_500.0, 5_178_500.0, 33.0, frame=frame))
    page.open(photo)
    page.drop(told)
    states = ".map((one) => one.state)"
    page.until(lambda: page.state(f"state.photos{states}") == ["ready", "ready"])
    page.until(lambda: page.find("#find-all").is_displayed())
    page.click("#find-all")
    page.until(lambda: page.state(f"state.photos{states}") == ["answered", "answered"])
    assert page.state("state.photo.name") == "told.jpg"
    page.click("#known summary")
    page.click("#near-known")
    near = page.of("known", "it.known().near")
    assert (near["lon"], near["lat"]) == pytest.approx((lon, lat), abs=1e-5)
    page.click("#photos li:first-child .pick")
    page.until(lambda: page.state("state.photo.name") == "photo.jpg")
    page.settled()
    page.click("#photos li:first-child [aria-label^=Remove]")
    page.until(lambda: page.find("#welcome").is_displayed())
    assert page.state("state.photos.length") == 1


_CONFUSED = {
    "deutan": ((0.367, 0.861, -0.228), (0.280, 0.673, 0.047), (-0.012, 0.043, 0.969)),
    "protan": ((0.152, 1.053, -0.205), (0.115, 0.786, 0.099), (-0.004, -0.048, 1.052)),
    "tritan": ((1.256, -0.077, -0.179), (-0.078, 0.931, 0.148), (0.005, 0.691, 0.304)),
}
"""What linear red, green and blue look like (Machado, Oliveira, Fernandes 2009, severity 1)."""


@pytest.mark.parametrize("kind", _CONFUSED)
def test_the_lines_are_told_apart_by_the_colour_blind(kind):
    layers = (Path(web.__file__).parent / "page" / "layers.js").read_text()
    names = dict(re.findall(r'(FOUND|RENDERED) = "#(\w{6})"', layers))
    found, rendered = ([int(names[n][k : k + 2], 16) for k in (0, 2, 4)] for n in names)
    near, far = [155, 231, 255], [255, 77, 0]
    assert f"[{near[0]}, {near[1]}, {near[2]}]" in layers
    assert f"[{far[0]}, {far[1]}, {far[2]}]" in layers
    for one, other in ((found, rendered), (near, far)):
        linear = (np.array([one, other]) / 255.0) ** 2.2
        seen = np.clip(linear @ np.array(_CONFUSED[kind]).T, 0.0, 1.0) ** (1.0 / 2.2)
        lab = cv2.cvtColor(seen.astype(np.float32)[np.newaxis], cv2.COLOR_RGB2LAB)[0]
        # 10 is a difference at a glance.
        assert np.linalg.norm(lab[0] - lab[1]) > 25.0

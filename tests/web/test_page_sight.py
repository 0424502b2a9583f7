"""What is in sight on the page and in reach, by mouse, by keyboard and on a narrow screen."""

import socket

import numpy as np
import pytest
from pages import SIZES, Page, serving
from rasterio.transform import Affine
from scenes import SPACING_M, candidate_at, fractal, write_dem
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys

from skyline import build_places, read_dem, write_located

NAMED = "({0}.id || {0}.name || {0}.className || {0}.textContent)".format


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


_PAST_ITS_ROW = """
const right = (one) => one.getBoundingClientRect().right;
return [...document.querySelectorAll("#side .row > *")]
  .filter((one) => one.checkVisibility() && right(one) > right(one.parentElement) + 0.5)
  .map((one) => one.id);
"""


@pytest.mark.parametrize("size", [*SIZES.values(), (390, 844)])
def test_what_a_person_knows_keeps_within_its_row(page, photo, size):
    page.open(photo)
    page.script("document.getElementById('known').open = true")
    page.resize(*size)
    assert page.script(_PAST_ITS_ROW) == []
    page.resize(*SIZES["wide"])


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

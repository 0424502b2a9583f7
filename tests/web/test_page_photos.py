"""Several photos on the page, in one tab or in two."""

import json

import pytest
from pages import SIZES
from scenes import candidate_at
from selenium.webdriver.support.ui import Select

from skyline import read_dem, write_located


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
    page.type_into("#hand-heading_deg-number", "151.3")

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

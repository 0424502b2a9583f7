"""The page when its server ends: nothing drawn is lost, and it goes on when the server is back."""

import signal

import pytest
from pages import Page, serving

from skyline import read_trace

LINES = {50: [(100, 50), (300, 50)], 80: [(400, 80), (600, 80)], 30: [(700, 30), (850, 30)]}
"""Lines that are drawn, by their rows."""


def middle_of(line):
    return (line[0][0] + line[1][0]) // 2


def follows(page, *rows):
    """Return whether the skyline runs along the lines of these rows."""
    found = page.rows()
    return all(abs(found[middle_of(LINES[row])] - row) < 2.0 for row in rows)


def end(server, how):
    """End a server by a signal."""
    server.process.send_signal(how)
    server.process.wait(20)


def warns(page):
    """Return whether the page would warn if it were left now."""
    return page.script(
        "const leaving = new Event('beforeunload', {cancelable: true});"
        "dispatchEvent(leaving); return leaving.defaultPrevented"
    )


def port_of(server):
    return int(server.address.split(":")[1])


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_what_is_drawn_without_a_server_is_there_when_it_is_back(
    chromium, store, photo, downloads, how
):
    with serving(store) as server:
        page = Page(chromium, server)
        page.open(photo)
        untouched = page.rows()
        assert not warns(page)
        page.draw("line", LINES[50])
        assert warns(page)
        page.match()
        pose = page.state("state.pose")
        end(server, how)
        page.until(page.messages)
    for row in (80, 30):
        page.draw("line", LINES[row], is_solved=False)
        page.click("#fit")
    said = page.messages()
    assert len(said) == 1
    assert said[0].startswith("The server does not answer; is `skyline serve` still running?")
    # The trace holds what the server has seen, and the page knows what it has not.
    before = set(downloads.iterdir())
    page.click("#save-trace")
    new = page.until(
        lambda: [one for one in set(downloads.glob("*.csv")) - before if one.stat().st_size]
    )
    row_px = read_trace(new[0]).row_px
    assert row_px[middle_of(LINES[50])] == pytest.approx(50.0, abs=1.0)
    assert row_px[middle_of(LINES[80])] == pytest.approx(untouched[middle_of(LINES[80])], abs=1.0)
    assert "without the last strokes" in page.find("#status").text
    assert warns(page)
    with serving(store, port=port_of(server)) as server:
        page.until(lambda: follows(page, *LINES))
        page.until(lambda: page.messages() == [])
        # The pose stands where it stood, but the new server has not searched.
        assert page.state("state.pose") == pose
        assert page.find("#answer").text == ""
        assert "no search has judged this pose" in page.find("#pose-verdict").text
        page.click("#undo")
        page.until(lambda: follows(page, 50, 80) and not follows(page, 30))
        page.match()
        page.settled()
        page.click("#save-trace")
        assert page.find("#status").text == "Saved"
        assert not warns(page)


def test_a_page_that_was_closed_asks_for_the_photo_and_has_its_strokes(
    chromium, store, photo, tmp_path
):
    other = tmp_path / "other name.jpg"
    other.write_bytes(photo.read_bytes())
    with serving(store) as server:
        page = Page(chromium, server)
        page.open(photo)
        page.draw("line", LINES[50])
        end(server, signal.SIGKILL)
        page.draw("line", LINES[80], is_solved=False)
        page.until(page.messages)
    with serving(store, port=port_of(server)) as server:
        page.reload()
        assert page.find("#kept").text.startswith("Unsaved strokes are kept for photo.jpg")
        page.open(other)
        page.until(lambda: follows(page, 50, 80))
        assert page.find("#kept").get_property("textContent") == ""
        assert warns(page)
        page.click("#undo")
        page.click("#undo")
        page.until(lambda: not warns(page))


def test_photos_come_back_from_the_page_from_the_command_and_from_the_user(
    chromium, store, photo, tmp_path
):
    given, changing = tmp_path / "given.jpg", tmp_path / "changing.jpg"
    given.write_bytes(photo.read_bytes() + b"given")
    changing.write_bytes(photo.read_bytes() + b"changing")
    with serving(store, given) as server:
        page = Page(chromium, server)
        page.until(lambda: page.state("state.rows && state.rows.length"))
        page.draw("line", LINES[50])
        page.open(photo)
        page.draw("line", LINES[80])
        page.reload()  # The page has no copy of the photo any more.
        page.until(lambda: page.state("state.rows && state.rows.length"))
        page.open(changing)
        page.find("#files").send_keys(str(changing))
        end(server, signal.SIGTERM)
        page.until(page.messages)
    with serving(store, given, port=port_of(server)) as server:
        states = "state.photos.map((one) => [one.name, one.state])"
        page.until(lambda: ["photo.jpg", "missing"] in page.state(states))
        page.until(lambda: ["changing.jpg", "ready"] in page.state(states))
        assert ["given.jpg", "ready"] in page.state(states)
        page.until(lambda: len(page.messages()) == 1)
        assert page.messages()[0].startswith("The server was started again without photo.jpg: add")
        page.open(photo)
        page.until(lambda: follows(page, 80))
        assert page.messages() == []
        assert ["photo.jpg", "missing"] not in page.state(states)
        page.click("#photos li:first-child .pick")
        page.until(lambda: page.state("state.photo.name") == "given.jpg")
        page.until(lambda: page.state("state.rows && state.rows.length"))
        page.until(lambda: follows(page, 50))

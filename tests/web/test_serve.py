"""``skyline serve`` from the shell: what it says when it cannot, and without the store's DEM."""

import json
import signal
import socket
import sys
from functools import partial

import pytest
from commands import assert_refused
from pages import POSE, TINY, live, look, ready, serving, told

from skyline import cli
from skyline.render.context import release_context
from skyline.store import Built, open_for_append, open_store


@pytest.fixture
def run(run_main):
    """Return a function that runs ``skyline ARGS...``."""
    return partial(run_main, cli.main, "skyline")


def test_what_cannot_be_served_is_one_line(run, store, photo, renderings, tmp_path):
    release_context()  # it is for the page's own thread
    assert_refused(run("serve", store, tmp_path / "none.jpg"), "none.jpg does not exist")
    assert_refused(run("serve", tmp_path / "none.h5", "--port", "0"), "none.h5")
    assert_refused(run("serve", photo, "--port", "0"), "photo.jpg")
    assert_refused(run("serve", renderings, "--port", "0"), "holds renderings, not places")
    assert_refused(run("serve", store, "--peaks", photo, "--port", "0"), "cannot be read as CSV")
    assert_refused(run("serve", store, "--host", "192.0.2.1"), "cannot be listened on")
    assert_refused(run("serve", store, "--port", "99999"), "65535")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_refused(run("serve", store, "--port", port), f"port {port} cannot be listened on")


def test_without_its_packages_it_says_what_to_install(run, store, monkeypatch):
    for name in [name for name in sys.modules if name.startswith("skyline.web")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    assert_refused(run("serve", store), "pip install 'skyline[web]'")


def test_ctrl_c_ends_it_without_a_word(store):
    with serving(store) as server:
        server.process.send_signal(signal.SIGINT)
        assert server.process.wait(20) == 0
        assert server.process.stderr.read() == ""


def test_of_an_unfinished_store_it_says_how_much_is_there(store, tmp_path):
    part = tmp_path / "part.h5"
    part.write_bytes(store.read_bytes())
    with open_store(part) as opened, open_for_append(part, opened.header) as writer:
        writer.note_built(Built(1, 2))
    with serving(part) as server:
        _, state = server.ask("GET", "/state")
        server.process.send_signal(signal.SIGINT)
        assert "its build is not finished: 50 % of the area is there" in state["unfinished"]
        assert state["unfinished"] in server.process.stderr.read()


def test_without_the_stores_dem_it_matches_and_says_what_is_missing(run, dem, photo, tmp_path):
    moved, store = tmp_path / "moved.tif", tmp_path / "store.h5"
    moved.write_bytes(dem.read_bytes())
    assert run("build", moved, "-o", store, "--spacing", "300").code == 0
    moved.unlink()
    with serving(store, photo) as server:
        _, state = server.ask("GET", "/state")
        assert (state["rendering"], state["terrain"], state["given"]) == (
            False,
            None,
            ["photo.jpg"],
        )
        session, of_photo = ready(server, photo)
        assert server.ask("POST", f"{session}/given/0")[1]["name"] == "photo.jpg"
        assert server.ask("POST", f"{session}/given/1")[0] == 404
        assert server.ask("GET", "/relief/9/270/180.png")[0] == 404
        with live(server, session) as socket_:
            socket_.send(look(of_photo))
            assert "DEM is not at hand" in told(socket_, "look")["error"]
            status, found = server.ask("POST", f"{of_photo}/match", TINY)
        assert status == 200
        assert found["candidates"][0]["refined"] is False
        pose = json.dumps({"pose": POSE})
        status, said = server.ask("POST", f"{of_photo}/fit", pose)
        assert (status, "DEM is not at hand" in said["error"]) == (400, True)
        for kind in ("geojson", "kml", "kmz", "gpx", "photo", "report", "trace"):
            assert server.ask("POST", f"{of_photo}/save/{kind}", b"{}")[0] == 200, kind

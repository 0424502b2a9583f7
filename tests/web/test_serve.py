"""``skyline serve`` from the shell: its errors, and its messages without the store's DEM."""

import io
import json
import re
import signal
import socket
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from commands import assert_refused, noting
from pages import POSE, TINY, Served, live, look, received, serving
from PIL import Image
from PIL.ExifTags import Base

from skyline import Matcher, Narrowing, read_skyline
from skyline.web.server import Reach, own_addresses


def test_what_cannot_be_served_is_one_line(run, store, photo, renderings, tmp_path):
    assert_refused(run("serve", store, tmp_path / "none.jpg"), "none.jpg does not exist")
    assert_refused(run("serve", tmp_path / "none.h5", "--port", "0"), "none.h5")
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
    assert_refused(run("serve", store), "pip install starlette uvicorn websockets")


def test_ctrl_c_ends_it_without_a_word(store):
    with serving(store) as server:
        server.process.send_signal(signal.SIGINT)
        assert server.process.wait(20) == 0
        assert server.process.stderr.read() == ""


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "::"])
def test_the_printed_address_opens_and_the_page_says_where_photos_go(store, host):
    if host == "::" and not socket.has_dualstack_ipv6():
        pytest.skip("this machine has no IPv6")
    with serving(store, "--host", host) as server:
        assert server.address.rpartition(":")[0] in {"127.0.0.1", "[::1]"}
        assert server.ask("GET", "/")[0] == 200
        machine = server.ask("GET", "/state")[1]["machine"]
        others = [Served(one, None) for one in re.findall(r"http://(\S+)/", server.said)[1:]]
        statuses = [one.ask("GET", "/state")[0] for one in others]
    assert machine == (None if host == "127.0.0.1" else socket.gethostname())
    assert len(others) >= len(own_addresses(4)) * (machine is not None)
    assert set(statuses) <= {200}


@pytest.mark.parametrize(
    ("host", "address", "words"),
    [
        ("localhost", "127.0.0.1", "at http://localhost:80/ (Ctrl-C"),
        ("::1", "::1", "at http://[::1]:80/ (Ctrl-C"),
        ("192.0.2.7", "192.0.2.7", "at http://192.0.2.7:80/ (Ctrl-C"),
        ("page.example", "192.0.2.7", "at http://page.example:80/ (Ctrl-C"),
        ("0.0.0.0", "0.0.0.0", "at http://127.0.0.1:80/ on this machine, and at http://"),
        ("::", "::", "at http://[::1]:80/ on this machine, and at http://"),
    ],
)
def test_each_host_has_an_address_that_opens(host, address, words):
    reach = Reach.of(host, address)
    said = reach.in_words(80)
    assert words in said
    assert "0.0.0.0" not in said
    assert "[::]" not in said
    is_open = host not in {"localhost", "::1"}
    assert reach.machine == (socket.gethostname() if is_open else None)


def test_two_stores_are_served_as_one(run, dem, photo, tmp_path):
    stores = [tmp_path / "west.h5", tmp_path / "east.h5"]
    whole = Matcher(built(run, dem, tmp_path / "whole.h5", "10.32,46.74,10.34,46.755"))
    for store, bounds in zip(
        stores, ("10.32,46.74,10.33,46.755", "10.33,46.74,10.34,46.755"), strict=True
    ):
        built(run, dem, store, bounds)
    other = tmp_path / photo.name
    other.write_bytes(photo.read_bytes())
    with serving(*stores, photo, other) as server:
        about = server.ask("GET", "/state")[1]
    about |= about["area"]
    assert about["store"] == "west.h5, east.h5"
    assert about["given"] == ["photo.jpg", "photo (2).jpg"]
    assert about["places"] == pytest.approx(whole.rows, rel=0.2)


def built(run, dem, store, bounds):
    """Build a store of a box; return its path."""
    assert run("build", dem, "-o", store, "--spacing", "150", "--bounds", bounds).code == 0
    return store


def test_without_the_stores_dem_it_matches_and_says_what_is_missing(run, dem, photo, tmp_path):
    moved, store, given = tmp_path / "moved.tif", tmp_path / "store.h5", tmp_path / "photo.jpg"
    moved.write_bytes(dem.read_bytes())
    given.write_bytes(photo.read_bytes())
    assert run("build", moved, "-o", store, "--spacing", "300").code == 0
    moved.unlink()
    with serving(store, given) as server:
        _, state = server.ask("GET", "/state")
        found = [state["area"]["terrain"], state["given"]]
        assert found == [None, ["photo.jpg"]]
        session = server.begin()
        record = server.ask("POST", f"{session}/given/0")[1]
        assert record["name"] == "photo.jpg"
        of_photo = f"{session}/photos/{record['id']}"
        given.unlink()
        status, said = server.ask("POST", f"{session}/given/0")
        assert (status, "photo.jpg cannot be copied" in said["error"]) == (400, True)
        Image.new("RGB", (30, 20)).save(given)
        assert server.ask("POST", f"{session}/given/1")[0] == 404
        relief = f"/relief/{state['area']['id']}/9/270/180.png"
        assert server.ask("GET", relief)[0] == 404
        with live(server, session) as socket_:
            socket_.send(look(of_photo))
            assert "DEM is not at hand" in received(socket_, "look")["error"]
            status, found = server.ask("POST", f"{of_photo}/match", TINY)
        assert status == 200
        assert found["candidates"][0]["pose"]["refined"] is False
        pose = json.dumps({"pose": POSE})
        status, said = server.ask("POST", f"{of_photo}/fit", pose)
        assert (status, "DEM is not at hand" in said["error"]) == (400, True)
        for kind in ("geojson", "kml", "kmz", "gpx", "photo", "report"):
            status, content = server.ask("POST", f"{of_photo}/save/{kind}", b"{}")
            assert status == 200, kind
            if kind == "photo":  # It is the photo that was opened, whatever its file is now.
                assert Image.open(io.BytesIO(content)).width == record["width_px"]


KNOWN = {
    "fov_deg": 58.37, "near": [10.3301234, 46.7491234, 1.7], "heading_deg": [141.37, 25],
    "eye_height_m": 2, "elevation_m": [-50, 900],
}  # fmt: skip
LIST = (
    "path,fov_deg,lon,lat,radius_km,heading_deg,heading_slack_deg,eye_height_m,lowest_m,highest_m\n"
    "photo.png,58.37,10.3301234,46.7491234,1.7,141.37,25,2,-50,900\n"
)
FILM = {Base.FocalLengthIn35mmFilm: 32}
FRAME = {Base.ExifImageWidth: 960, Base.ExifImageHeight: 640}
NARROWED = Narrowing(
    (10.3301234, 46.7491234, 1.7), heading_deg=(141.37, 25), elevation_m=(-50, 900), eye_height_m=2
)


def masked(photo, path):
    """Write the sky of a photo as a mask with a white border."""
    skyline = read_skyline(photo, 60.0)
    row = np.where(skyline.trusted, skyline.row_px, -1.0)
    sky = np.where(np.arange(skyline.height_px)[:, np.newaxis] < row, 255, 0).astype(np.uint8)
    sky[:, :60] = 255
    Image.fromarray(sky).save(path)
    return path


@dataclass(frozen=True)
class Question:
    """One question as the page, the command, perhaps with a list, and Python put it."""

    page: dict
    command: tuple = ()
    photos: str = ""
    fov_deg: float | None = None
    narrowing: Narrowing | None = None


ALL_KNOWN = Question(KNOWN, (), LIST, 58.37, NARROWED)


@pytest.mark.parametrize(
    ("made", "question"),
    [
        (lambda *to: noting(*to, {}), Question({})),
        (lambda *to: noting(*to, FILM), Question({})),
        (lambda *to: noting(*to, FILM | FRAME, size=(800, 640)), Question({})),
        (lambda *to: noting(*to, FILM), ALL_KNOWN),
        (masked, Question({"fov_deg": 60.25}, ("--fov-deg", "60.25"), fov_deg=60.25)),
    ],
    ids=["nothing", "lens", "cropped", "all", "mask"],
)
def test_one_question_has_one_answer_wherever_it_is_asked(
    run, served, store, photo, tmp_path, made, question
):
    path = made(photo, tmp_path / "photo.png")
    photos = path
    if question.photos:
        photos = tmp_path / "photos.csv"
        photos.write_text(question.photos)
    command = json.loads(run("match", store, photos, *question.command, "--json").out)
    with Matcher(store) as matcher:
        python = matcher.match(path, question.fov_deg, narrowing=question.narrowing)
    session = served.begin()
    _, uploaded = served.upload(session, path.name, path.read_bytes())
    asked = dict.fromkeys(("heading_deg", "near", "elevation_m", "eye_height_m")) | question.page
    of_photo = f"{session}/photos/{uploaded['id']}"
    with live(served, session):
        status, page = served.ask("POST", f"{of_photo}/match", json.dumps(asked))
    assert status == 200, page
    found = [one["pose"] for one in page["candidates"]]
    assert found
    assert found == command["candidates"]
    assert found == json.loads(json.dumps([one.to_dict() for one in python.candidates]))
    assert page["answered"] == (python.answer is not None) == (command["answer"] is not None)
    assert page["within_m"] == python.within_m == command["answer_within_m"]
    assert page["refusal"] == python.refusal == command.get("refusal")

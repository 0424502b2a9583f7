"""The server under honest and hostile requests: refusals, and files that are kept."""

import http.client
import json
import struct
import threading
import zipfile
import zlib
from contextlib import ExitStack, closing
from pathlib import Path

import pytest
from pages import POSE, TIMEOUT_S, TINY, live, look, ready, received
from websockets.exceptions import InvalidStatus

from skyline.web.server import Guard


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("Host", "127.0.0.1.evil.example:{port}"),
        ("Host", "127.0.0.1:1"),
        ("Origin", "http://evil.example"),
        ("Origin", "null"),
        ("Origin", "https://127.0.0.1:{port}"),
    ],
)
def test_foreign_hosts_and_origins_are_refused(served, name, value):
    foreign = value.format(port=served.address.split(":")[1])
    for method, path in (("GET", "/"), ("GET", "/state"), ("POST", "/session")):
        status, said = served.ask(method, path, headers={name: foreign})
        assert status == 403
        assert b"its own page only" in said
    origin = {"Origin": foreign if name == "Origin" else "http://x"}
    with pytest.raises(InvalidStatus, match="403"):
        live(served, served.begin(), additional_headers=origin)


@pytest.mark.parametrize(
    ("host", "allowed", "refused"),
    [
        ("127.0.0.1", ["127.0.0.1:80", "localhost:80", "[::1]:80"], ["192.0.2.7:80", "a.b:80"]),
        ("0.0.0.0", ["192.0.2.7:80", "localhost:80", "[2001:db8::1]:80"], ["a.b:80", "a.b"]),
        ("page.example", ["page.example:80"], ["other.example:80", "page.example:81"]),
    ],
)
def test_what_the_server_listens_on_says_which_hosts_are_its_own(host, allowed, refused):
    guard = Guard(None, host, 80)
    assert all(guard.allows([name], [f"http://{name}"]) for name in allowed)
    assert not any(guard.allows([name], []) for name in refused)
    assert not guard.allows([], [])
    assert not guard.allows(allowed[:1] * 2, [])


def test_it_listens_on_this_machine_alone(served):
    port = int(served.address.split(":")[1])
    lines = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    listening = [line[1] for line in lines if line[3] == "0A" and line[1].endswith(f":{port:04X}")]
    assert listening == [f"0100007F:{port:04X}"]


@pytest.mark.parametrize(
    "path",
    [
        "/page/../server.py", "/page/..%2fserver.py", "/page/%2e%2e/server.py", "//etc/passwd",
        "/page//etc/passwd", "/leaflet/../__init__.py", "/leaflet/..%2f__init__.py",
        "/page/....//server.py", "/page/%00index.html", "/page/", "/leaflet/", "/../../etc/passwd",
        "/session/../state", "/session/x/photos/../../../etc/passwd/picture",
    ],
)  # fmt: skip
def test_no_path_of_the_machine_is_readable(served, path):
    status, said = served.ask("GET", path)
    assert status in {404, 405, 400}
    assert "root:" not in str(said)
    assert "import" not in str(said)


def test_answers_tell_the_browser_to_run_nothing_else(served):
    with closing(http.client.HTTPConnection(served.address, timeout=TIMEOUT_S)) as connection:
        connection.request("GET", "/")
        headers = connection.getresponse().headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"


def huge_png(width, height):
    """Return a PNG of one colour, small as a file."""
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    rows, made = zlib.compress(bytes(width + 1) * 64, 9), b"\x89PNG\r\n\x1a\n"
    for kind, data in ((b"IHDR", header), (b"IDAT", rows), (b"IEND", b"")):
        made += struct.pack(">I", len(data)) + kind + data
        made += struct.pack(">I", zlib.crc32(kind + data))
    return made


SVG = b'<svg xmlns="http://www.w3.org/2000/svg" onload="alert(1)"><rect width="9"/></svg>'


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("letter.jpg", b"Dear Sir or Madam", "is not an image that can be read"),
        ("cut.jpg", None, "cut.jpg cannot be decoded"),
        ("drawing.svg", SVG, "is not an image that can be read"),
        ("huge.png", huge_png(60_000, 60_000), "has 3600 megapixels; expected at most 100"),
        ("sliver.png", huge_png(3000, 2), "expected a photo or a panorama"),
    ],
)
def test_bad_uploads_are_one_clear_line(served, photo, name, data, said):
    session = served.begin()
    status, answer = served.upload(session, name, data or photo.read_bytes()[:9000])
    assert status == 400
    assert answer["error"].startswith(name)
    assert said in answer["error"]
    assert "\n" not in answer["error"]
    assert "/tmp" not in answer["error"]
    assert served.ask("GET", session)[1] == {"photos": []}


def test_a_polyglot_is_shown_as_nothing_but_its_picture(served, photo, tmp_path):
    archive = tmp_path / "both.jpg"
    archive.write_bytes(photo.read_bytes() + b"<script>alert(1)</script>")
    with zipfile.ZipFile(archive, "a") as both:
        both.writestr("evil.html", "<script>alert(2)</script>")
    session = served.begin()
    status, record = served.upload(session, "<b>both.html", archive.read_bytes())
    assert status == 200
    assert record["name"] == "<b>both.html"
    status, shown = served.ask("GET", f"{session}/photos/{record['id']}/picture")
    assert shown.startswith(b"\xff\xd8")
    assert b"script" not in shown
    assert b"PK\x03\x04" not in shown


def test_500_megabytes_are_refused_before_they_are_sent(served):
    session = served.begin()
    headers = {"Content-Length": "500000000"}
    status, said = served.ask("POST", f"{session}/photos?name=film.jpg", b"", headers)
    assert status == 413
    assert said["error"].startswith("film.jpg has 500 MB or more; the page takes at most 100 MB")


@pytest.mark.parametrize(
    ("path", "body", "said"),
    [
        ("skyline", b"[1, 2", "not a JSON object"),
        ("skyline", b'{"strokes": [{"kind": "fire", "points": [[1, 2]], "radius": 3}]}', "none of"),
        ("skyline", b'{"strokes": [{"kind": "sky", "points": [[1, NaN]], "radius": 3}]}', "number"),
        ("skyline", b'{"strokes": [{"kind": ["sky"]}]}', "none of"),
        ("match", b'{"fov_deg": 1' + b"0" * 400 + b"}", "fov_deg is 1"),
        ("match", b'{"near": [900, 0, 1]}', "near is 900,0,1"),
        ("match", b'{"near": {"lon": 9}}', "expected the numbers longitude, latitude, km"),
        ("match", b'{"elevation_m": [900, 100]}', "two that increase"),
        ("match", b'{"fov_deg": "wide"}', "fov_deg is wide"),
        ("fit", b"{}", "the request has no pose"),
        ("fit", json.dumps({"pose": POSE | {"fov_deg": 181}}).encode(), "expected 1 to 179"),
        ("fit", json.dumps({"pose": POSE | {"distortion": -2}}).encode(), "expected -0.3 to 0.3"),
        ("fit", json.dumps({"pose": {**POSE, "lat": 10}}).encode(), "off the map"),
        ("save/kml", b"{}", "no place to save yet"),
        ("trace", b"no trace", "the trace starts with"),
        ("trace", b"# width=5 height=5\ncolumn_px,row_px\n1,2\n2,2\n", "expected the same image"),
    ],
)
def test_what_is_no_question_is_one_line(served, photo, path, body, said):
    _, of_photo = ready(served, photo)
    status, answer = served.ask("POST", f"{of_photo}/{path}", body)
    assert status == 400
    assert said in answer["error"]
    assert "/tmp" not in answer["error"]
    assert "\n" not in answer["error"]


def test_nobody_sees_what_others_have_uploaded(served, photo):
    _, of_photo = ready(served, photo)
    other = served.begin()
    stolen = f"{other}/photos/{of_photo.split('/')[-1]}/picture"
    assert served.ask("GET", stolen)[0] == 404
    assert served.ask("GET", "/session/none/photos/none/picture")[0] == 404
    assert served.ask("GET", other)[1] == {"photos": []}


def test_the_skyline_follows_a_pose_and_the_latest_alone(served, photo):
    session, of_photo = ready(served, photo)
    with live(served, session) as socket:
        for seq in range(200):
            socket.send(look(of_photo, {**POSE, "heading_deg": 100 + 0.2 * seq}, seq))
        seen = []
        while not seen or seen[-1]["seq"] != 199:
            seen.append(received(socket, "look"))
        assert len(seen) < 200
        assert [one["seq"] for one in seen] == sorted(one["seq"] for one in seen)
        assert len(seen[-1]["column_px"]) == len(seen[-1]["row_px"]) > 300
        socket.send(look(of_photo, {**POSE, "lat": 40.0}))
        assert "off the map" in received(socket, "look")["error"]
        for unread in ("no JSON", "[" * 100_000, '{"type": ["look"]}'):
            socket.send(unread)
        socket.send(json.dumps({"type": "height", "lon": 10.3327, "lat": 46.7478, "seq": 7}))
        assert received(socket, "height")["seq"] == 7


def test_three_people_match_at_once_and_look_meanwhile(served, photo):
    people = [ready(served, photo) for _ in range(3)]
    results, looks = {}, 0

    def match(of_photo):
        results[of_photo] = served.ask("POST", f"{of_photo}/match", TINY)

    threads = [threading.Thread(target=match, args=(of_photo,)) for _, of_photo in people]
    with ExitStack() as pages:
        socket, *_ = [pages.enter_context(live(served, session)) for session, _ in people]
        _, alone = served.ask("POST", f"{people[0][1]}/match", TINY)
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            socket.send(look(people[0][1]))
            received(socket, "look")
            looks += 1
        for thread in threads:
            thread.join()
    for status, found in results.values():
        assert status == 200
        assert found["candidates"] == alone["candidates"]
    assert looks > 5


def test_a_match_reports_its_progress_and_is_cancelled(served, photo):
    session, of_photo = ready(served, photo)
    answers = []
    with live(served, session) as socket:
        asking = threading.Thread(
            target=lambda: answers.append(served.ask("POST", f"{of_photo}/match", b"{}"))
        )
        asking.start()
        received(socket, "progress")
        assert served.ask("POST", f"{of_photo}/match", b"{}")[0] == 400
        assert served.ask("DELETE", f"{of_photo}/match")[0] == 200
        asking.join(TIMEOUT_S)
        assert answers == [(400, {"error": "cancelled"})]
        assert served.ask("POST", f"{of_photo}/match", TINY)[0] == 200


def test_matches_end_when_the_page_closes(served, photo):
    session, first = ready(served, photo)
    data = photo.read_bytes()
    others = [served.upload(session, "photo.jpg", data)[1]["id"] for _ in range(11)]
    answers = []

    def match(of_photo):
        answers.append(served.ask("POST", f"{of_photo}/match", b"{}"))

    paths = [first, *(f"{session}/photos/{other}" for other in others)]
    threads = [threading.Thread(target=match, args=(path,)) for path in paths]
    with live(served, session) as socket:
        for thread in threads:
            thread.start()
        received(socket, "progress")
    for thread in threads:
        thread.join(TIMEOUT_S)
    assert (400, {"error": "cancelled"}) in answers


def test_what_was_judged_with_another_skyline_is_not_saved_as_judged(served, photo):
    session, of_photo = ready(served, photo)
    strokes = {"strokes": [{"kind": "erase", "points": [[20, 100], [40, 100]], "radius": 2}]}

    def save(what, kind="geojson"):
        return served.ask("POST", f"{of_photo}/save/{kind}", json.dumps(what))

    with live(served, session):
        assert served.ask("POST", f"{of_photo}/match", TINY)[0] == 200
    assert served.ask("POST", f"{of_photo}/fit", json.dumps({"pose": POSE}))[0] == 200
    for what in ({"rank": 0}, {"fitted": True}):
        assert save(what)[0] == 200
    assert "rank is 9; expected" in save({"rank": 9})[1]["error"]
    assert "rank is x; expected" in save({"rank": "x"})[1]["error"]
    served.ask("POST", f"{of_photo}/skyline", json.dumps(strokes))
    for what in ({"rank": 0}, {"fitted": True}):
        status, said = save(what)
        assert (status, "the skyline has changed since" in said["error"]) == (400, True)
    features = json.loads(save({"pose": POSE})[1])["features"]
    assert features[0]["properties"]["origin"] == "set by hand"
    assert served.ask("GET", f"{of_photo}/trace")[1].startswith(b"# width=960 height=640")
    served.ask("POST", f"{of_photo}/skyline", b'{"strokes": []}')
    assert save({"rank": 0})[0] == 200

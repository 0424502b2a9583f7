"""``skyline peaks`` against a local server that serves, fails, lies and hangs."""

import json
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs

import pytest
from commands import assert_refused

from skyline import Frame, read_peaks


def node(name, lon, lat, **tags):
    return {"type": "node", "lon": lon, "lat": lat, "tags": {"name": name, **tags}}


ELEMENTS = [node("Piz Ela", 9.69, 46.61, ele="3339 m"), node("Tinzenhorn", 9.65, 46.62)]
GOOD = json.dumps({"elements": ELEMENTS}).encode()


@contextmanager
def overpass(answers):
    """Serve (status, body) one after another, the last for ever; yields address and queries."""
    queries, stopping = [], threading.Event()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"])).decode()
            queries.append(parse_qs(body)["data"][0])
            status, content = answers[min(len(queries), len(answers)) - 1]
            if status == "hangs":
                stopping.wait(30.0)
                return
            self.send_response(200 if isinstance(status, str) else status)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            if status == "drips":
                for byte in content:
                    self.wfile.write(bytes([byte]))
                    if stopping.wait(0.2):
                        return
            elif status == "breaks off":
                self.wfile.write(content[: len(content) // 2])
                self.close_connection = True
            else:
                self.wfile.write(content)

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/api/interpreter", queries
    finally:
        stopping.set()
        server.shutdown()
        server.server_close()
        thread.join()


def fetch(run, address, path, *more, bbox="9.6,46.5,9.8,46.7"):
    return run("peaks", "--bbox", bbox, "--server", address, "-o", path, *more)


def test_peaks_are_fetched_and_read(run, tmp_path):
    path = tmp_path / "peaks.geojson"
    with overpass([(200, GOOD)]) as (address, queries):
        done = fetch(run, address, path)
    assert done.code == 0, done.err
    assert "2 peaks" in done.out
    assert '"natural"~"^(peak|volcano)$"' in queries[0]
    assert "(46.5,9.6,46.7,9.8)" in queries[0]
    frame = Frame.local(lon=9.7, lat=46.6)
    peaks = read_peaks(path, frame)
    assert peaks.names == ("Piz Ela", "Tinzenhorn")
    lon, lat = frame.to_lonlat(peaks.easting_m, peaks.northing_m)
    assert lon.tolist() == pytest.approx([9.69, 9.65])
    assert lat.tolist() == pytest.approx([46.61, 46.62])
    assert peaks.height_m[0] == 3339.0
    assert str(peaks.height_m[1]) == "nan"


def test_a_box_across_the_antimeridian_is_two(run, tmp_path):
    body = json.dumps({"elements": [node("A", 179.9, 1.0), node("B", -179.9, 1.0)]}).encode()
    with overpass([(200, body)]) as (address, queries):
        done = fetch(run, address, tmp_path / "peaks.geojson", bbox="179.5,0,-179.5,2")
    assert done.code == 0, done.err
    assert "(0.0,179.5,2.0,180.0)" in queries[0]
    assert "(0.0,-180.0,2.0,-179.5)" in queries[0]


@pytest.mark.parametrize("first", [(429, b""), ("breaks off", GOOD)])
def test_a_failure_that_passes_is_tried_again(run, tmp_path, first):
    with overpass([first, (200, GOOD)]) as (address, queries):
        done = fetch(run, address, tmp_path / "peaks.geojson", "--retries", "1")
    assert done.code == 0, done.err
    assert len(queries) == 2


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ((500, b""), "the server answers HTTP 500, not tried again"),
        (("hangs", b""), "no whole answer (timed out)"),
        (("drips", GOOD), "incomplete after 1 s"),
        ((200, b"<html>Welcome</html>"), "not one of Overpass (it begins `<html>"),
        ((200, b"[" * 100_000), "not one of Overpass"),
        ((200, b'{"elements": []}'), "knows no named peak in the bounds"),
        (
            (200, b'{"elements": [], "remark": "runtime error: timed out"}'),
            "the server gave up (runtime error: timed out)",
        ),
        ((200, json.dumps({"elements": [node("Far", 12.0, 46.6)]}).encode()), "no named peak in"),
    ],
)
def test_a_server_that_fails_lies_or_hangs_is_one_line_and_nothing_is_lost(
    run, tmp_path, answer, message
):
    path = tmp_path / "peaks.geojson"
    path.write_text("as before")
    with overpass([answer]) as (address, _):
        done = fetch(run, address, path, "--retries", "0", "--timeout", "1")
    assert done.code == 1, done
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert [file.name for file in tmp_path.iterdir()] == ["peaks.geojson"]
    assert path.read_text() == "as before"


def test_an_address_that_is_none(run, tmp_path):
    done = fetch(run, "file:///etc/passwd", tmp_path / "peaks.geojson")
    assert_refused(done, "expected the address of an Overpass interpreter")

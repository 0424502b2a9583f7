"""``skyline peaks`` against a local server that serves, fails, lies and hangs."""

import json
from functools import partial
from urllib.parse import parse_qs

import numpy as np
import pytest
from range_server import Behaviour, serve

from skyline import Frame, read_peaks
from skyline.fetch.overpass import fetch_peaks
from skyline.fetch.remote import Patience


def node(name, lon, lat, **tags):
    return {"type": "node", "lon": lon, "lat": lat, "tags": {"name": name, **tags}}


ELEMENTS = [node("Piz Ela", 9.69, 46.61, ele="3339 m"), node("Tinzenhorn", 9.65, 46.62)]
GOOD = json.dumps({"elements": ELEMENTS}).encode()


def overpass(answer=GOOD, **behaviour):
    """Return a server's behaviour that gives one answer."""
    return Behaviour(files={"/api": answer}, **behaviour)


def fetch(run, behaviour, path, bbox="9.6,46.5,9.8,46.7"):
    with serve(behaviour) as address:
        return run("peaks", "--bounds", bbox, "--server", f"{address}/api", "-o", path)


def asked(behaviour):
    return [parse_qs(body)["data"][0] for body in behaviour.posted]


def test_peaks_are_fetched_and_read(run, tmp_path):
    path = tmp_path / "peaks.geojson"
    server = overpass()
    done = fetch(run, server, path).ok()
    assert "2 peaks" in done.out
    assert '"natural"~"^(peak|volcano)$"' in asked(server)[0]
    assert "(46.5,9.6,46.7,9.8)" in asked(server)[0]
    frame = Frame.local(lon=9.7, lat=46.6)
    peaks = read_peaks(path, frame)
    assert peaks.names == ("Piz Ela", "Tinzenhorn")
    lonlat = frame.to_lonlat(peaks.easting_m, peaks.northing_m)
    np.testing.assert_allclose(lonlat, [[9.69, 9.65], [46.61, 46.62]])
    np.testing.assert_array_equal(peaks.height_m, [3339.0, np.nan])


def test_a_box_across_the_antimeridian_is_two(run, tmp_path):
    body = json.dumps({"elements": [node("A", 179.9, 1.0), node("B", -179.9, 1.0)]}).encode()
    server = overpass(body)
    fetch(run, server, tmp_path / "peaks.geojson", bbox="179.5,0,-179.5,2").ok()
    assert "(0.0,179.5,2.0,180.0)" in asked(server)[0]
    assert "(0.0,-180.0,2.0,-179.5)" in asked(server)[0]


@pytest.mark.parametrize("trouble", [{"failures": 1, "failing": 429}, {"truncate": 1}])
def test_a_failure_that_passes_is_tried_again(run, tmp_path, trouble):
    server = overpass(**trouble)
    fetch(run, server, tmp_path / "peaks.geojson").ok()
    assert len(server.posted) == 2


@pytest.mark.parametrize(
    "server",
    [{"status": {"/api": 500}}, {"delay_s": 30.0}, {"drip_s": 0.2}, {"answer": b"[" * 100_000}],
    ids=["fails", "hangs", "drips", "lies"],
)
def test_a_server_that_gives_no_peaks_loses_nothing(run, tmp_path, monkeypatch, server):
    hasty = partial(fetch_peaks, patience=Patience(retries=0, timeout_s=1))
    monkeypatch.setattr("skyline.cli.peaks.fetch_peaks", hasty)
    path = tmp_path / "peaks.geojson"
    path.write_text("as before")
    assert fetch(run, overpass(**server), path).code == 1
    assert [file.name for file in tmp_path.iterdir()] == ["peaks.geojson"]
    assert path.read_text() == "as before"

"""``skyline orient``: photos and traces at a place, as a table, JSON and lines."""

import csv
import json
import shutil

from commands import assert_refused, lonlat_of
from PIL import Image


def test_a_camera_is_oriented_at_its_place(run, dem, photo, tmp_path):
    at = "{},{}".format(*lonlat_of(dem))
    table = tmp_path / "held.csv"
    asked = ("orient", photo, photo, "--at", at, "--dem", dem, "--fov-deg", "60")
    done = run(*asked, "-o", table).ok()
    assert "not trusted" not in done.out
    assert "heading" in done.out
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [row["trusted"] for row in rows] == ["1", "1"]
    assert rows[0]["heading_deg"] == rows[1]["heading_deg"]
    assert 0.0 < float(rows[0]["heading_sd_deg"]) < 1.0
    record = json.loads(run(*asked, "--json").out.splitlines()[0])
    assert record["wander"] == []
    assert abs(record["heading_deg"] - float(rows[0]["heading_deg"])) < 1e-6


def test_a_frame_in_fog_is_a_row_with_the_reason(run, dem, photo, tmp_path):
    frames, table = tmp_path / "frames", tmp_path / "held.csv"
    frames.mkdir()
    Image.new("RGB", (96, 64), (200, 205, 210)).save(frames / "9.jpg")
    shutil.copy(photo, frames / "10.jpg")
    at = "{},{}".format(*lonlat_of(dem))
    named = frames / "0.jpg", frames
    done = run("orient", *named, "--at", at, "--dem", dem, "--fov-deg", "60", "-o", table)
    assert (done.code, done.err.count("\n")) == (2, 2)
    absent, fog, clear = csv.DictReader(table.read_text().splitlines())
    assert "does not exist" in absent["refusal"]
    assert list(fog)[:2] == ["photo", "trusted"]
    assert (fog["trusted"], fog["heading_deg"], clear["trusted"]) == ("0", "", "1")
    assert "no skyline found" in fog["refusal"]


def test_what_is_missing_is_said_in_one_line(run, dem, photo, tmp_path):
    orient = "orient", photo, "--dem", dem
    assert_refused(run(*orient), "notes no GPS position; give the place: --at LON,LAT")
    assert_refused(run(*orient, "--at", "9"), "expected LON,LAT in degrees")
    assert_refused(run(*orient, "--at", "0,0"), "off the map")
    assert_refused(run(*orient, "--at", "9.2,46.7", "--within", "900"), "skyline match")
    at = "{},{}".format(*lonlat_of(dem))
    assert_refused(run(*orient, "--at", at, "--elevation", 30000), "is 30000 m; expected metres")
    assert_refused(
        run(*orient, "--at", at, "--elevation", -400), "is -400 m, and the ground of the DEM lies"
    )
    absent = run("orient", tmp_path / "no.jpg", "--dem", dem, "--at", "9,46")
    assert_refused(absent, "does not exist")

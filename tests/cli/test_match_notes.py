"""`skyline match`: lens, place and direction that photos note in their EXIF."""

import json
import math

import pytest
from commands import gps_of, lonlat_of, noting, off_m
from PIL.ExifTags import GPS, Base
from PIL.TiffImagePlugin import IFDRational

from skyline.match.search import FullMatcher, SearchEffort


def test_the_lens_in_the_exif_is_weighed(run, store, photo, tmp_path, monkeypatch):
    """The photo spans 60 degrees: 36 mm of film at 31 mm."""
    # A quick refinement may stop beside the best field of view, where none is known.
    monkeypatch.setattr(FullMatcher, "effort", SearchEffort(sure_margin=math.inf))
    size = {Base.ExifImageWidth: 4000, Base.ExifImageHeight: 3000}
    cropped = noting(photo, tmp_path / "cropped.jpg", size | {Base.FocalLengthIn35mmFilm: 24})
    lie = noting(photo, tmp_path / "lie.jpg", {Base.FocalLengthIn35mmFilm: 9999})
    found = run("match", store, cropped, lie, "--json").ok()
    records = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 60.0 for one in records)
    assert all(abs(one["answer"]["fov_deg"] - 60.0) < 1.5 for one in records)
    bounded, unknown = (one["lens"] for one in records)
    assert bounded["most_fov_deg"] > 60.0 > bounded["fov_deg"]
    assert "cropped" in bounded["reason"]
    assert unknown["fov_deg"] is None
    said = run("match", store, cropped, lie, "--matcher", "unrefined").out
    assert (
        "field of view: 53.7 degrees, give or take 10; only EXIF's 35 mm equivalent gives it,"
        in said
    )
    assert "field of view: not known; only EXIF's 35 mm equivalent gives it: 0.21 degrees" in said


def test_a_camera_s_height_that_may_be_an_elevation_is_asked_about(run, store, tmp_path):
    """The photo is missing, so nothing is searched."""
    for height_m, is_asked in ((120, False), (1500, True)):
        done = run("match", store, tmp_path / "none.jpg", "--eye-height", height_m)
        assert ("to be 1500 m above the ground, as in an aircraft" in done.err) == is_asked


def claiming(photo, path, lonlat, heading_deg, reference="T"):
    """Write a copy of a photo with a position and a direction in its EXIF; return it."""
    other = {
        GPS.GPSImgDirection: IFDRational(round(heading_deg * 100), 100),
        GPS.GPSImgDirectionRef: reference,
        GPS.GPSAltitude: IFDRational(99_999),
    }
    return noting(photo, path, gps=gps_of(*lonlat) | other)


def test_a_photo_s_own_claim_is_shown(run, store, dem, photo, tmp_path):
    claim = claiming(photo, tmp_path / "claim.jpg", lonlat_of(dem, 601_800.0, 5_178_240.0), 112.0)
    common = "--fov-deg", "60", "--json", "--report", tmp_path / "report"
    exif = json.loads(run("match", store, claim, *common).out)["exif"]
    assert exif["distance_m"] == pytest.approx(240.0, abs=40.0)
    assert exif["heading_off_deg"] == pytest.approx(29.0, abs=2.0)
    assert exif["heading_is_magnetic"] is False
    page = (tmp_path / "report" / "index.html").read_text()
    assert "m from the answer. Its compass says 112 degrees" in page
    assert "GPS altitude is left aside: 99999 m" in page
    assert f"{exif['lat']:.5f}" not in page


def test_a_wrong_claim_does_not_hide_the_right_place(run, store, dem, photo, tmp_path):
    right, beside = (601_800.0, 5_178_000.0), (601_000.0, 5_179_000.0)
    claims = [
        claiming(photo, tmp_path / "right.jpg", lonlat_of(dem, *right), 141.0),
        claiming(photo, tmp_path / "beside.jpg", lonlat_of(dem, *beside), 300.0, "M"),
        claiming(photo, tmp_path / "far.jpg", (-70.0, -33.0), 12.0),
    ]
    found = run("match", store, *claims, "--fov-deg", "60", "--use-gps", "--json").ok()
    records = [json.loads(line) for line in found.out.splitlines()]
    assert all(off_m(one["answer"]) < 30.0 for one in records)
    assert off_m(records[0]["answer"]) < 10.0
    assert records[1]["exif"]["distance_m"] == pytest.approx(math.hypot(800.0, 1000.0), abs=40.0)
    assert records[2]["exif"]["distance_m"] > 1e7

"""A pose is written as a record by `Pose.to_dict` and read by `NotedPose.from_dict`."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scenes import candidate_at, fractal, write_dem

from skyline import InputError, Narrowing, NotedPose, OffMapError, Projection, Viewer, read_dem
from skyline.pose.pose_files import read_posed

LENS = Projection.PERSPECTIVE
LEAST = {"lon": 9, "lat": 46, "heading_deg": 1, "fov_deg": 60}


def test_a_pose_is_read_as_it_was_written():
    pose = candidate_at(602_000.0, 5_177_900.0, 141.4)
    noted = NotedPose.from_dict(json.loads(json.dumps(pose.to_dict())), LENS)
    for name in ("lon", "lat", "heading_deg", "pitch_deg", "fov_deg", "eye_elevation_m", "wander"):
        assert getattr(noted, name) == getattr(pose, name)
    assert noted.eye_height_m is None


@pytest.mark.parametrize("cost", [math.nan, math.inf])
def test_the_record_of_a_pose_without_a_finite_cost_is_json(cost):
    pose = replace(
        candidate_at(602_000.0, 5_177_900.0, 141.4, cost=cost),
        eye_elevation_m=math.nan,
        wander=(0.1, math.nan, 0.0, 0.0),
    )
    record = json.loads(json.dumps(pose.to_dict(), allow_nan=False))
    assert (record["cost"], record["eye_elevation_m"], record["wander"]) == (None, None, None)
    noted = NotedPose.from_dict(record, LENS)
    assert (noted.heading_deg, noted.eye_elevation_m, noted.wander) == (pose.heading_deg, None, ())


def test_what_a_record_does_not_have_is_level_and_undistorted():
    assert NotedPose.from_dict(LEAST, LENS) == NotedPose(
        lon=9.0, lat=46.0, heading_deg=1.0, fov_deg=60.0
    )


def test_other_names_beside_those_that_are_read_are_ignored():
    record = LEAST | {"pitch": 4, "pitch_deg": 4, "elevation_m": 2400, "eye_height_m": 2, "f": 1}
    noted = NotedPose.from_dict(record, LENS)
    assert (noted.pitch_deg, noted.eye_height_m, noted.eye_elevation_m) == (4.0, 2.0, None)


def test_a_heading_beyond_a_turn_is_refused():
    """A spreadsheet made 123.456 so."""
    with pytest.raises(InputError, match="heading_deg is 123456; expected -360 to 360"):
        NotedPose.from_dict(LEAST | {"heading_deg": 123456}, LENS)
    with pytest.raises(InputError, match="and a heading from -360 to 360"):
        Narrowing(heading_deg=(123456.0, 10.0))


def test_a_record_of_another_projection_is_refused():
    fisheye = LEAST | {"projection": "fisheye"}
    assert NotedPose.from_dict(fisheye, Projection.FISHEYE).fov_deg == 60.0
    for record in (fisheye, LEAST | {"projection": "round"}):
        with pytest.raises(InputError):
            NotedPose.from_dict(record, LENS)


def test_a_pose_is_of_photos_of_one_shape_whatever_their_size(tmp_path):
    pose, photo = tmp_path / "pose.json", tmp_path / "photo.png"
    pose.write_text(json.dumps(LEAST | {"width_px": 400, "height_px": 300}))
    for size in ((400, 300), (800, 600), (133, 100)):
        Image.new("RGB", size).save(photo)
        assert read_posed(photo, pose)[1].fov_deg == 60.0
    for size in ((400, 225), (300, 400)):
        Image.new("RGB", size).save(photo)
        with pytest.raises(InputError, match=r"of 400 x 300 px.* it was cropped or turned"):
            read_posed(photo, pose)


def test_a_height_counts_from_the_ground_and_an_elevation_from_the_datum(tmp_path):
    terrain = read_dem([write_dem(tmp_path / "dem.tif", fractal(60, 60) + 2000.0)])
    west, south, east, north = terrain.box_deg
    place = {"lon": (west + east) / 2, "lat": (south + north) / 2}
    viewer = Viewer(terrain)

    def eye_m(**eye):
        return viewer.pose_of(NotedPose(**LEAST | place | eye))[0].eye_elevation_m

    ground_m = eye_m(eye_height_m=0.0)
    assert eye_m() == ground_m + 2.0
    assert eye_m(eye_height_m=30.0) == ground_m + 30.0
    assert eye_m(eye_elevation_m=ground_m + 30.0) == ground_m + 30.0
    with pytest.raises(OffMapError):
        eye_m(eye_height_m=-1.0)
    with pytest.raises(InputError):
        eye_m(eye_height_m=1e6)


def test_a_covariance_is_read_as_it_is_written():
    covariance = tuple(map(tuple, np.diag(np.arange(1.0, 9.0)).tolist()))
    pose = replace(candidate_at(0.0, 0.0), covariance=covariance)
    record = json.loads(json.dumps(pose.to_dict()))
    assert NotedPose.from_dict(record, LENS).covariance == covariance
    assert NotedPose.from_dict(record | {"covariance": None}, LENS).covariance is None


@pytest.mark.parametrize("covariance", [[[1.0]], [[1.0] * 8] * 7, "wide", [["a"] * 8] * 8])
def test_a_covariance_of_other_unknowns_is_refused(covariance):
    record = candidate_at(0.0, 0.0).to_dict() | {"covariance": covariance}
    with pytest.raises(InputError):
        NotedPose.from_dict(record, LENS)

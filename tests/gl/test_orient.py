"""Orientation: heading, pitch, roll and field of view of a camera at a known place."""

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from photo_scenes import in_haze
from ray_scenes import poses
from scenes import NORTH_M, WEST_M, at_deg, field_of, fractal
from test_matcher import MIDDLE, SHARP

from skyline import Orienter, orient
from skyline.angles import angle_between_deg, wrapped_deg
from skyline.errors import InputError
from skyline.orientation.result import Orientation
from skyline.photo.noted_place import NotedPlace
from skyline.photo.read import read_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline_bench.queries.synthetic import make_queries


@pytest.fixture(scope="module")
def queries(terrain):
    return make_queries(terrain, MIDDLE, 5, seed=3, config=SHARP)


def beside(terrain, truth, away_m=30.0):
    """Return the longitude and latitude of a place so far east of a query's."""
    return at_deg(map(float, terrain.frame.to_lonlat(truth.easting_m + away_m, truth.northing_m)))


def off_deg(found, truth):
    """Return the errors of heading, pitch, roll and field of view."""
    pose = found.pose
    names = ("pitch_deg", "roll_deg", "fov_deg")
    heading_deg = float(wrapped_deg(pose.grid_heading_deg - truth.grid_heading_deg))
    return np.array([heading_deg, *(getattr(pose, one) - getattr(truth, one) for one in names)])


def test_angles_are_found_from_a_place_beside_the_true_one(terrain, queries):
    found = [orient(one.skyline, terrain, **beside(terrain, one.truth)) for one in queries]
    assert not any(one.refusal for one in found)
    off = np.array([off_deg(one, query.truth) for one, query in zip(found, queries, strict=True)])
    assert np.median(np.abs(off)) < 0.1
    names = [f"{angle}_sd_deg" for angle in ("heading", "pitch", "roll", "fov")]
    shares = np.abs(off) / [[getattr(one, name) for name in names] for one in found]
    assert np.median(shares) < 1.0
    assert shares.max() < 4.0


def test_a_skyline_in_haze_gives_the_heading_where_the_rocks_before_it_do_not(terrain, queries):
    query = queries[2]
    skyline = read_skyline(in_haze(query.skyline), query.skyline.fov_deg)
    with Orienter(terrain, **beside(terrain, query.truth)) as orienter:
        found = orienter.orient(skyline)
        drawn = orienter.orient(replace(skyline, is_drawn=True))
    assert drawn.answer is None
    assert found.refusal is None
    assert abs(off_deg(found, query.truth)[0]) < 1.0


def test_an_unknown_field_of_view_is_found(terrain, queries):
    query = queries[3]
    unknown = replace(query.skyline, fov_deg=None)
    found = orient(unknown, terrain, **beside(terrain, query.truth))
    assert found.refusal is None
    assert np.abs(off_deg(found, query.truth)).max() < 0.6


@pytest.mark.parametrize("eye_height_m", [1.6, 200.0])
def test_one_orienter_takes_many_photos_and_a_known_elevation(terrain, eye_height_m):
    config = replace(SHARP, eye_height_m=eye_height_m)
    query = make_queries(terrain, MIDDLE, 2, seed=3, config=config)[1]
    place = beside(terrain, query.truth, 0.0)
    with Orienter(terrain, **place, elevation_m=query.truth.eye_elevation_m) as orienter:
        first, again = (orienter.orient(query.skyline, name=name) for name in "ab")
    assert (first.name, again.name) == ("a", "b")
    assert first.pose == again.pose
    assert first.refusal is None
    assert np.abs(off_deg(first, query.truth)).max() < 0.3
    assert abs(first.pose.eye_elevation_m - query.truth.eye_elevation_m) < 10.0


def test_a_photo_of_another_place_is_refused(terrain, queries):
    for query, other in pairwise(queries):
        found = orient(query.skyline, terrain, **beside(terrain, other.truth))
        assert found.answer is None
        assert found.pose is not None
        # The first two are taken near each other, so that the pose walks to the right place.
        assert "is needed" in found.refusal or "check the place" in found.refusal


def test_the_place_that_a_photo_notes_is_used(terrain, queries):
    query = queries[2]
    place = beside(terrain, query.truth)
    noted = NotedPlace((place["lon"], place["lat"]), accuracy_m=20.0)
    found = orient(replace(query.skyline, noted=noted), terrain)
    assert abs(off_deg(found, query.truth)[0]) < 0.6
    with pytest.raises(InputError, match="one of lon and lat is given"):
        orient(replace(query.skyline, noted=noted), terrain, lon=9.0)
    with pytest.raises(InputError, match="position is 900 m"):
        orient(replace(query.skyline, noted=replace(noted, accuracy_m=900.0)), terrain)
    with pytest.raises(InputError, match="notes no GPS position; give the place: --at"):
        orient(query.skyline, terrain)


def test_a_heading_that_is_given_is_kept_to(terrain, queries):
    query = queries[1]
    place = beside(terrain, query.truth)
    true_deg = orient(query.skyline, terrain, **place).pose.heading_deg
    near = orient(query.skyline, terrain, **place, heading_deg=(true_deg + 15.0, 20.0))
    assert near.pose.heading_deg == pytest.approx(true_deg, abs=0.2)
    far = orient(query.skyline, terrain, **place, heading_deg=(true_deg + 180.0, 20.0))
    assert far.answer is None
    if far.pose is not None:
        assert angle_between_deg(far.pose.heading_deg, true_deg) >= 160.0


def test_a_heading_s_greatest_error_is_above_zero(terrain, queries):
    query = queries[1]
    with pytest.raises(InputError, match="expected a slack above 0"):
        orient(query.skyline, terrain, **beside(terrain, query.truth), heading_deg=(90.0, 0.0))


@pytest.mark.parametrize(("off_deg", "is_said"), [(8.0, False), (22.0, True)])
def test_a_compass_is_named_where_it_is_far_off(terrain, queries, off_deg, is_said):
    query = queries[1]
    place = beside(terrain, query.truth)
    true_deg = orient(query.skyline, terrain, **place).pose.heading_deg
    compass_deg = (true_deg + off_deg) % 360.0
    noted = NotedPlace((place["lon"], place["lat"]), heading_deg=compass_deg, is_magnetic=False)
    found = orient(replace(query.skyline, noted=noted), terrain, **place)
    assert found.heading_off_deg == pytest.approx(-off_deg, abs=0.2)
    said = f"EXIF's compass says {compass_deg:.0f} degrees, which is 22 degrees off"
    assert (said in found.to_text()) is is_said


def test_a_compass_counts_with_the_photo_s_position_and_without(terrain, queries):
    """A right compass lowers the cost of the right heading, as it does beside a position."""
    query = queries[1]
    place = beside(terrain, query.truth)
    alone = orient(query.skyline, terrain, **place)

    def cost_of(lonlat):
        noted = NotedPlace(lonlat, heading_deg=alone.pose.heading_deg, is_magnetic=False)
        return orient(replace(query.skyline, noted=noted), terrain, **place).pose.cost

    without = cost_of(None)
    assert without == pytest.approx(cost_of((place["lon"], place["lat"])), abs=1e-3)
    assert without < alone.pose.cost - 1.0


def test_a_pose_that_lacks_confidence_alone_is_likely_from_one_half_on(terrain, queries):
    pose = next(iter(poses().on_map(terrain.frame)))
    unsure = Orientation(
        queries[0].skyline, pose, confidence=0.6, refusal="unsure", lacks_confidence_only=True
    )
    assert (unsure.answer, unsure.likely) == (None, pose)
    assert replace(unsure, confidence=0.4).likely is None
    assert replace(unsure, lacks_confidence_only=False).likely is None


def test_a_flat_horizon_has_no_heading():
    plain = field_of(np.zeros((200, 200)), 30.0, west_m=WEST_M, north_m=NORTH_M)
    place = at_deg(map(float, plain.frame.to_lonlat(WEST_M + 3000.0, NORTH_M - 3000.0)))
    level = PhotoSkyline(np.full(640, 240.0), np.ones(640), 640, 480, 60.0)
    found = orient(level, plain, **place)
    assert found.answer is None


def ground_at(terrain, pose):
    return float(terrain.height_at(easting_m=pose.easting_m, northing_m=pose.northing_m))


def noting(terrain, query, **heights):
    """Return a query's skyline with its place, 30 m off, and heights that its photo notes."""
    place = beside(terrain, query.truth)
    return replace(query.skyline, noted=NotedPlace((place["lon"], place["lat"]), **heights))


@pytest.mark.parametrize("height_m", [60.0, 120.0, 350.0])
@pytest.mark.parametrize("kind", ["altitude", "take-off", "a drone's in low pressure"])
def test_an_eye_far_above_the_ground_is_found_from_a_noted_height(terrain, height_m, kind):
    # A field of view is believed to 2 %, which is what even errors of up to 3.5 % deviate by.
    config = replace(SHARP, eye_height_m=height_m, fov_error=0.035)
    query = make_queries(terrain, MIDDLE, 2, seed=3, config=config)[1]
    eye_m = query.truth.eye_elevation_m
    heights = {
        "altitude": {"elevation_m": eye_m + 10.0},
        "take-off": {"takeoff_height_m": height_m - 15.0},
        "a drone's in low pressure": {
            "elevation_m": eye_m + 150.0, "takeoff_height_m": height_m - 15.0,
        },
    }[kind]  # fmt: skip
    found = orient(noting(terrain, query, **heights), terrain)
    assert found.refusal is None
    assert np.abs(off_deg(found, query.truth)[:3]).max() < 0.3
    assert abs(found.pose.eye_elevation_m - eye_m) < 15.0
    above_m = found.pose.eye_elevation_m - ground_at(terrain, found.pose)
    assert found.to_row()["eye_height_m"] == pytest.approx(above_m, abs=0.01)
    assert f"and {above_m:.0f} m above the ground" in found.to_text()


@pytest.mark.parametrize("off_m", [-50.0, 50.0, 90.0])
def test_a_wrong_altitude_lifts_no_eye_from_the_ground(terrain, queries, off_m):
    """Many devices note heights above the ellipsoid, 50 m above the sea's in the Alps."""
    for query in queries:
        altitude_m = query.truth.eye_elevation_m + off_m
        found = orient(noting(terrain, query, elevation_m=altitude_m), terrain)
        assert found.refusal is None
        assert abs(off_deg(found, query.truth)[0]) < 0.6
        assert abs(found.pose.eye_elevation_m - query.truth.eye_elevation_m) < 15.0


def test_a_skyline_that_says_nothing_of_a_noted_height_is_refused():
    """Ridges 45 km away, all round a plain, look the same from 150 m above it."""
    north, east = np.mgrid[:200, :200] - 99.5
    is_far = 0.5 * np.hypot(north, east) > 45.0
    heights_m = is_far * (1000.0 + fractal(200, 200, 900.0, seed=2))
    ring = field_of(heights_m, 500.0, west_m=WEST_M, north_m=NORTH_M)
    middle = (WEST_M + 49_500.0, NORTH_M - 49_700.0, WEST_M + 49_700.0, NORTH_M - 49_500.0)
    (query,) = make_queries(ring, middle, 1, seed=3, config=SHARP)
    eye_m = query.truth.eye_elevation_m
    found = orient(noting(ring, query, elevation_m=eye_m + 150.0), ring)
    # Fits of this ring differ by a metre or two of height.
    assert re.search(r"above the ground, or 14[789] m, as the photo notes", found.refusal)
    assert "give its elevation with --elevation" in found.refusal
    assert orient(noting(ring, query, elevation_m=eye_m), ring).refusal is None


def test_no_eye_is_lower_than_a_camera_is_held(terrain):
    config = replace(SHARP, eye_height_m=0.0)
    for query in make_queries(terrain, MIDDLE, 6, seed=3, config=config):
        pose = orient(query.skyline, terrain, **beside(terrain, query.truth, 0.0)).pose
        assert pose.eye_elevation_m - ground_at(terrain, pose) > 0.299

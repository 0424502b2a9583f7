"""Orientation: heading, pitch, roll and field of view of a camera at a known place."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import NORTH_M, WEST_M, at_deg, field_of
from test_matcher import MIDDLE, SHARP

from skyline import Orienter, orient
from skyline.errors import InputError
from skyline.geodesy import in_turn
from skyline.photo.exif import NotedPlace
from skyline.photo.query import QuerySkyline
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
    heading_deg = float(in_turn(pose.grid_heading_deg - truth.heading_deg))
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
    with pytest.raises(InputError, match="known to 900 m"):
        orient(replace(query.skyline, noted=replace(noted, accuracy_m=900.0)), terrain)
    with pytest.raises(InputError, match="notes no GPS position; give the place: --at"):
        orient(query.skyline, terrain)


def test_a_flat_horizon_has_no_heading():
    plain = field_of(np.zeros((200, 200)), 30.0, west_m=WEST_M, north_m=NORTH_M)
    place = at_deg(map(float, plain.frame.to_lonlat(WEST_M + 3000.0, NORTH_M - 3000.0)))
    level = QuerySkyline(np.full(640, 240.0), np.ones(640), 640, 480, 60.0)
    found = orient(level, plain, **place)
    assert found.answer is None

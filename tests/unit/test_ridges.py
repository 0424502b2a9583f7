"""Ridges that hide ground behind them, on walls of known places and heights."""

import numpy as np
import pytest
from scenes import field_from

from skyline.geodesy.earth import Curvature
from skyline.terrain.ridges import ridges_around

FLAT = Curvature(enabled=False)
NORTH, EAST = 0.0, np.pi / 2.0


def a_wall_before_a_plateau(east, north):
    """A wall 100 m high 1 km north of the origin, and ground 500 m high from 2 km on."""
    del east
    wall = 100.0 * np.maximum(0.0, 1.0 - np.abs(north - 1000.0) / 50.0)
    return wall + 500.0 * np.clip((north - 1900.0) / 100.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def field():
    return field_from(a_wall_before_a_plateau, 121, 50.0)


def test_the_wall_is_a_ridge_and_the_skyline_behind_it_is_none(field):
    found = ridges_around(field, FLAT, (0.0, 0.0, 50.0), np.array([EAST, NORTH]))
    np.testing.assert_array_equal(found.azimuth, [1])
    np.testing.assert_allclose(found.distance_m, [1000.0])
    np.testing.assert_allclose(found.elevation_tan, [0.05])


def test_an_eye_above_the_wall_sees_it_hide_less(field):
    # From 200 m the line of sight over the wall meets the plain at 2 km, the foot of the plateau.
    found = ridges_around(field, FLAT, (0.0, 0.0, 200.0), np.array([NORTH]))
    np.testing.assert_allclose(found.elevation_tan, [-0.1])


def test_the_wall_drops_with_the_curvature(field):
    curvature = Curvature(refraction_k=0.0)
    found = ridges_around(field, curvature, (0.0, 0.0, 50.0), np.array([NORTH]))
    assert found.elevation_tan[0] == pytest.approx(0.05 - 1000.0 / (2.0 * curvature.radius_m))


def test_ground_that_lies_no_farther_behind_is_no_ridge():
    # Each step of the stairs hides a little of the next, 10 % farther at most.
    field = field_from(lambda east, north: 20.0 * np.floor(north / 100.0) + 0.0 * east, 121, 50.0)
    found = ridges_around(field, FLAT, (0.0, 0.0, 5.0), np.array([NORTH]))
    assert (found.distance_m < 1000.0).all()

"""Points of a lattice near stored eyes, and the ground between them."""

import numpy as np
import pytest

from skyline.matching.lattice import ground_between, ground_slope, lattice_m

EYES = np.array([[0.0, 0.0], [300.0, 0.0], [0.0, 300.0], [300.0, 300.0]])


def test_points_are_near_eyes_and_not_where_one_stands():
    place = lattice_m(EYES, 50.0, 120.0, (-1000.0, -1000.0, 1000.0, 1000.0))
    apart_m = np.linalg.norm(place[:, np.newaxis] - EYES, axis=2).min(axis=1)
    assert apart_m.max() <= 120.0
    assert apart_m.min() == 50.0
    # Every point of the lattice in reach, 50 m apart: 21 to an eye, less the eye's own.
    assert len(place) == 4 * 20
    np.testing.assert_array_equal(place % 50.0, 0.0)


def test_an_area_is_cut_to_what_eyes_can_reach():
    # Points of the whole Earth every 50 m would take a terabyte.
    place = lattice_m(EYES, 50.0, 120.0, (-2e7, -2e7, 2e7, 2e7))
    np.testing.assert_array_equal(place, lattice_m(EYES, 50.0, 120.0, (-500, -500, 800, 800)))
    assert not len(lattice_m(EYES, 50.0, 120.0, (5000.0, 5000.0, 6000.0, 6000.0)))


def test_without_an_area_points_go_half_a_spacing_beyond_the_eyes():
    place = lattice_m(EYES, 50.0, 1000.0)
    assert place.min() == -150.0
    assert place.max() == 450.0
    assert not len(lattice_m(EYES, np.inf, 1000.0))


def test_the_slope_is_a_planes_and_nothing_beside_a_hole():
    def plane(east, north):
        return np.where(east < 0.0, np.nan, 0.3 * east - 0.2 * north)

    slope = ground_slope(np.array([[100.0, 50.0], [5.0, 50.0]]), plane)
    np.testing.assert_allclose(slope, [[0.3, -0.2], [0.0, -0.2]], atol=1e-6)


def test_ground_between_eyes_is_linear_inside_and_the_nearest_outside():
    known = np.array([[0, 0, 10], [100, 0, 20], [0, 100, 30], [100, 100, 40]], dtype=np.float64)
    ground = ground_between(known)
    np.testing.assert_allclose(ground(np.array([50.0, 25.0]), np.array([50.0, 75.0])), [25.0, 27.5])
    np.testing.assert_allclose(ground(np.array([900.0]), np.array([900.0])), [40.0])


@pytest.mark.parametrize("count", [1, 2, 5])
def test_ground_between_eyes_on_a_line_is_the_nearest(count):
    known = np.stack([np.arange(count) * 10.0] * 3, axis=1)
    np.testing.assert_allclose(ground_between(known)(np.array([1.0]), np.array([-2.0])), [0.0])

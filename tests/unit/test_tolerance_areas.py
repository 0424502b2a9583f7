"""Reprojection errors, tolerance areas and true errors after the best warp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import field_from

from skyline.paper import tolerance_areas
from skyline.paper.plan_check import true_errors_px
from skyline.skylines import Views, columns_u
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

WIDTH = 320
U = columns_u(WIDTH)
PX = 2.0 / WIDTH


def views_of(tan, depth_m, heading=0, east=0.0, north=0.0, eye=0.0):
    """Make views (N, W) of skylines; eyes and headings broadcast to the rows."""
    tan, depth_m = np.broadcast_arrays(np.atleast_2d(tan), np.atleast_2d(depth_m))
    headings, *place = (np.full(len(tan), one) for one in (np.uint8(heading), east, north, eye))
    flags = np.zeros(tan.shape, dtype=np.uint8)
    return Views(*place, headings, tan.astype(np.float32), depth_m.astype(np.float32), flags)


def mountains(u, seed=0, height=0.1):
    """Return a smooth skyline over abscissas u, in units of the image plane."""
    generator = np.random.default_rng(seed)
    waves = generator.uniform(2.0, 9.0, 5)
    phases = generator.uniform(0.0, 6.0, 5)
    return height * (1.5 + np.sin(np.multiply.outer(u, waves) + phases).sum(axis=-1) / 3.0)


def errors(name, view, *displacements):
    there = np.array(displacements, dtype=np.float64)
    there = np.broadcast_to(there, (len(view), *there.shape))
    return tolerance_areas.errors_px(
        tolerance_areas.skyline_points_m(view), there, view.width, tolerance_areas.WARPS[name]
    )


RIGHT_M, UP_M, FORWARD_M = (st.floats(-most, most) for most in (300.0, 100.0, 500.0))


@pytest.mark.parametrize("name", ["affine-mean", "affine-median", "affine-least-squares"])
@given(right=RIGHT_M, up=UP_M, forward=FORWARD_M)
def test_equation_4_is_exact_for_a_skyline_of_one_depth(name, right, up, forward):
    view = views_of(mountains(U), 2000.0)
    assert errors(name, view, (right, up, forward))[0, 0] < 0.01


@pytest.mark.parametrize("name", tolerance_areas.WARPS)
def test_an_empty_skyline_and_an_eye_that_is_nowhere_are_outside(name):
    empty = views_of(np.full(WIDTH, np.nan), np.nan)
    assert np.isinf(errors(name, empty, (0.0, 0.0, 0.0), (10.0, 0.0, 0.0))).all()
    view = views_of(mountains(U), 2000.0)
    assert np.isinf(errors(name, view, (0.0, np.nan, 0.0), (np.nan, np.nan, np.nan))).all()


def test_least_squares_is_exact_where_the_images_are_affine():
    # Points of a plane across the view have affine images.
    generator = np.random.default_rng(6)
    points = np.full((2, 30, 3), 900.0)
    points[..., :2] = generator.uniform(-300.0, 300.0, (2, 30, 2))
    points[generator.random((2, 30)) < 0.3] = np.nan
    there = generator.uniform(-100.0, 100.0, (2, 4, 3))
    expected = tolerance_areas.equation_4(np.full(2, 900.0), there)
    np.testing.assert_allclose(
        tolerance_areas.affine_least_squares(points, there), expected, atol=1e-6
    )


@pytest.mark.parametrize("move", [(200.0, 0.0), (0.0, 250.0), (-150.0, -150.0)])
def test_moved_points_lie_on_the_skyline_that_the_oracle_sees(move):
    field = field_from(peaks, 181, 100.0)
    here = stand_on(field, easting_m=130.0, northing_m=-70.0)
    there = stand_on(field, easting_m=130.0 + move[0], northing_m=-70.0 + move[1])
    stored, truth = (oracle.skyline(field, eye, WIDTH) for eye in (here, there))
    eye = there.easting_m[:, None], there.northing_m[:, None], there.eye_elevation_m[:, None]
    move_m = tolerance_areas.displacements_m(stored, stored.heading, *eye)
    points = tolerance_areas.moved(tolerance_areas.skyline_points_m(stored, WIDTH), move_m)[:, 0]
    for image, skyline in zip(tolerance_areas.projected(points), truth.v, strict=True):
        seen = np.isfinite(image[:, 0]) & (np.abs(image[:, 0]) < U[-1])
        off_px = np.abs(np.interp(image[seen, 0], U, skyline) - image[seen, 1]) / PX
        assert np.quantile(off_px, 0.95) < 0.3
        assert seen.mean() > 0.9


def peaks(east, north):
    """Return a ring of mountains 6 km off around a gentle basin."""
    distance, bearing = np.hypot(east, north), np.arctan2(east, north)
    ring = 900.0 * np.exp(-(((distance - 6000.0) / 900.0) ** 2))
    return ring * (1.2 + np.sin(5.0 * bearing) + 0.4 * np.cos(13.0 * bearing)) + 0.002 * distance


def plateau(easting, northing):
    """Level ground, a hole to the east of 1000 m, a step up north of 2000 m."""
    return np.where(easting > 1000.0, np.nan, np.where(northing > 2000.0, 50.0, 0.0))


@pytest.mark.parametrize("heading", range(4))
def test_ground_is_looked_up_on_the_map_whatever_the_heading(heading):
    depth_m = np.where(U < 0.0, 1000.0, 3000.0)
    view = views_of(mountains(U), depth_m, heading, east=999.0, north=1999.0, eye=2.0)
    points = tolerance_areas.skyline_points_m(view)
    options = {"size": 5, "spacing_m": 2.0, "width": view.width}
    errors = tolerance_areas.tolerance_errors_px(points, view, view.heading, plateau, **options)[0]
    assert np.isinf(errors[:, 3:]).all()
    assert np.isfinite(errors[:, :3]).all()
    # 50 m up, Equation 4 at the mean depth misses both halves.
    missed = 50.0 * (1 / 1000 - 1 / 3000) / 2.0 * WIDTH / 2.0
    np.testing.assert_allclose(errors[:2, :3], missed, rtol=0.1)
    assert (errors[2:, :3] < 0.3).all()
    assert errors[2, 2] == 0.0
    assert errors.dtype == np.float32


def warped(affine, seed=0):
    """Return the skyline of `mountains` after a warp."""
    finer = np.linspace(-2.0, 2.0, 8001)
    x, y = np.array(affine) @ np.stack([finer, mountains(finer, seed), np.ones_like(finer)])
    return np.interp(U, x, y)


def test_a_skyline_is_like_itself_and_like_its_warps():
    stored = views_of(np.tile(mountains(U), (3, 1)), 5000.0)
    moved_on = warped([[1.0, 0.0, 0.2], [0.0, 1.0, -0.1]])
    turned = warped([[1.15, 0.05, -0.1], [-0.05, 0.9, 0.05]])
    rendered = views_of(np.stack([mountains(U), moved_on, turned]), 5000.0)
    assert (true_errors_px(stored, rendered) < 0.1).all()
    beyond_the_bounds = views_of(0.2 * mountains(U), 5000.0)
    assert true_errors_px(stored[:1], beyond_the_bounds)[0] > 3.0


def test_the_error_of_another_skyline_is_its_distance():
    stored = views_of(np.zeros(WIDTH), 5000.0)
    waves = 8.0 * PX * np.sin(40.0 * U)
    error = true_errors_px(stored, views_of(waves, 5000.0))
    # The mean of |sine| is 2 / pi; a straight line is straight however it is warped.
    assert error[0] == pytest.approx(8.0 * 2.0 / np.pi, rel=0.05)


@pytest.mark.parametrize("name", tolerance_areas.WARPS)
def test_many_views_and_eyes_at_once_are_as_one_by_one(name):
    generator = np.random.default_rng(5)
    field = field_from(lambda e, n: 300.0 * np.sin(e / 310.0) * np.cos(n / 270.0), 61, 40.0)
    eyes = stand_on(field, easting_m=[0.0, 150.0], northing_m=[30.0, -90.0])
    stored = oracle.skyline(field, eyes, 96)
    there = generator.uniform(-150.0, 150.0, (len(stored), 7, 3)) * [1.0, 0.2, 1.0]
    points = tolerance_areas.skyline_points_m(stored)
    together = tolerance_areas.errors_px(points, there, stored.width, tolerance_areas.WARPS[name])
    assert together.shape == (len(stored), 7)
    assert together.dtype == np.float32
    for candidate in range(7):
        alone = tolerance_areas.errors_px(
            points, there[:, [candidate]], stored.width, tolerance_areas.WARPS[name]
        )[:, 0]
        np.testing.assert_allclose(together[:, candidate], alone, rtol=1e-3, atol=1e-3)

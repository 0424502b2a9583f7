"""Reprojection errors: closed forms, degenerate skylines, and the warps behind them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prediction_scenes import WIDTH, U, mountains, views_of
from scenes import field_from

from skyline.errors import InputError
from skyline.paper.reprojection import IDENTITY, PREDICTORS, equation_4, least_squares
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

PX = 2.0 / WIDTH
AFFINE = ("affine-mean", "affine-median", "affine-least-squares")


def errors(name, view, *displacements):
    moved = np.array(displacements, dtype=np.float64)
    return PREDICTORS[name].errors_px(view, np.broadcast_to(moved, (len(view), *moved.shape)))


@pytest.mark.parametrize("name", PREDICTORS)
def test_an_eye_that_has_not_moved_makes_no_error(name):
    view = views_of(mountains(U), np.where(U < 0.1, 500.0, 3000.0))
    assert errors(name, view, (0.0, 0.0, 0.0))[0, 0] < 0.01


@pytest.mark.parametrize("name", AFFINE)
@given(
    right=st.floats(-300.0, 300.0), up=st.floats(-100.0, 100.0), forward=st.floats(-500.0, 500.0)
)
def test_equation_4_is_exact_for_a_skyline_of_one_depth(name, right, up, forward):
    view = views_of(mountains(U), 2000.0)
    assert errors(name, view, (right, up, forward))[0, 0] < 0.01


def test_without_a_warp_the_error_is_how_far_the_points_move():
    view = views_of(mountains(U), 2000.0)
    error = errors("non-affine", view, (30.0, 0.0, 0.0), (0.0, 40.0, 0.0))
    np.testing.assert_allclose(error, [[0.015 / PX, 0.02 / PX]], rtol=1e-5)


def test_equation_4_has_the_signs_of_the_design():
    affine = equation_4(np.array([1000.0]), np.array([[[50.0, 20.0, 200.0]]]))[0, 0]
    np.testing.assert_allclose(affine, [[1.25, 0.0, -0.0625], [0.0, 1.25, -0.025]])


def test_there_is_no_warp_where_the_skyline_is_reached_or_passed():
    view = views_of(mountains(U), 300.0)
    for name in AFFINE[:2]:
        reached = errors(name, view, (0.0, 0.0, 290.0), (0.0, 0.0, 300.0), (0.0, 0.0, 400.0))
        assert np.isinf(reached).all()


def test_mean_and_median_depth_answer_for_different_skylines():
    depth = np.where(U < 0.5, 1000.0, 9000.0)
    view = views_of(mountains(U), depth)
    mean, median = (errors(name, view, (0.0, 60.0, 0.0))[0, 0] for name in AFFINE[:2])
    # Three quarters of the points are at the median depth and are predicted exactly.
    np.testing.assert_allclose(median, 0.25 * 60.0 * (1 / 1000 - 1 / 9000) / PX, rtol=0.02)
    assert mean > 2.0 * median


def test_unknown_columns_do_not_count():
    tan, depth = mountains(U), np.full(WIDTH, 2000.0)
    hollow = tan.copy()
    hollow[40:90] = np.nan
    moved = (60.0, 10.0, 100.0)
    for name in AFFINE:
        assert errors(name, views_of(hollow, depth), moved)[0, 0] == pytest.approx(
            errors(name, views_of(tan, depth), moved)[0, 0], abs=0.25
        )


@pytest.mark.parametrize("name", PREDICTORS)
def test_an_empty_skyline_and_an_eye_that_is_nowhere_are_outside(name):
    empty = views_of(np.full(WIDTH, np.nan), np.nan)
    assert np.isinf(errors(name, empty, (0.0, 0.0, 0.0), (10.0, 0.0, 0.0))).all()
    view = views_of(mountains(U), 2000.0)
    assert np.isinf(errors(name, view, (0.0, np.nan, 0.0), (np.nan, np.nan, np.nan))).all()


@pytest.mark.parametrize("name", PREDICTORS)
def test_fewer_than_three_points_are_outside(name):
    tan = np.full(WIDTH, np.nan)
    tan[[100, 200]] = 0.1
    assert np.isinf(errors(name, views_of(tan, 2000.0), (1.0, 0.0, 0.0))).all()


@pytest.mark.parametrize("name", PREDICTORS)
def test_a_skyline_that_has_left_the_frame_is_outside(name):
    view = views_of(mountains(U), 100.0)
    assert np.isinf(errors(name, view, (2000.0, 0.0, 0.0))).all()


@pytest.mark.parametrize("name", PREDICTORS)
@pytest.mark.parametrize("tan", [np.zeros(WIDTH), 0.1 + 0.2 * U])
def test_a_straight_skyline_has_an_answer(name, tan):
    view = views_of(tan, 2000.0)
    error = errors(name, view, (50.0, 20.0, 100.0), (-50.0, 5.0, -100.0))
    assert np.isfinite(error).all()
    if name != "non-affine":
        assert (error < 0.05).all()


@pytest.mark.parametrize("name", PREDICTORS)
def test_many_views_and_eyes_at_once_are_as_one_by_one(name):
    generator = np.random.default_rng(5)
    field = field_from(lambda e, n: 300.0 * np.sin(e / 310.0) * np.cos(n / 270.0), 61, 40.0)
    stored = oracle.skyline(
        field, stand_on(field, easting_m=[0.0, 150.0], northing_m=[30.0, -90.0]), 96
    )
    moved = generator.uniform(-150.0, 150.0, (len(stored), 7, 3)) * [1.0, 0.2, 1.0]
    together = PREDICTORS[name].errors_px(stored, moved)
    assert together.shape == (len(stored), 7)
    assert together.dtype == np.float32
    for candidate in range(7):
        alone = PREDICTORS[name].errors_px(stored, moved[:, [candidate]])[:, 0]
        np.testing.assert_allclose(together[:, candidate], alone, rtol=1e-3, atol=1e-3)


def test_least_squares_is_exact_where_the_images_are_affine():
    generator = np.random.default_rng(6)
    points = generator.uniform(-1.0, 1.0, (2, 30, 2))
    true = generator.uniform(-0.2, 0.2, (2, 4, 2, 3)) + IDENTITY
    images = np.einsum("ncij,npj->ncpi", true[..., :2], points) + true[:, :, np.newaxis, :, 2]
    usable = generator.random((2, 4, 30)) < 0.7
    np.testing.assert_allclose(least_squares(points, images, usable), true, atol=1e-6)


def test_bad_requests_say_what_is_wrong():
    view = views_of(mountains(U), 900.0)
    for name in PREDICTORS:
        with pytest.raises(InputError, match=r"shape \(4, 3\); expected \(1, C, 3\)"):
            PREDICTORS[name].errors_px(view, np.zeros((4, 3)))

"""True errors between skylines after the best warp, and the fit of that warp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prediction_scenes import WIDTH, U, mountains, views_of

from skyline.camera import columns_u
from skyline.errors import InputError
from skyline.paper.reprojection import IDENTITY
from skyline.paper.verify import MAX_CHANGE, block_means, fitted_warps, true_errors_px

PX = 2.0 / WIDTH


def warped(affine, seed=0):
    """Return the skyline of `mountains` after a warp."""
    finer = np.linspace(-2.0, 2.0, 8001)
    x, y = np.array(affine) @ np.stack([finer, mountains(finer, seed), np.ones_like(finer)])
    return np.interp(U, x, y)


def test_a_skyline_is_like_itself_and_like_its_warps():
    stored = views_of(np.tile(mountains(U), (3, 1)), 5000.0)
    rendered = views_of(
        np.stack(
            [
                mountains(U),
                warped([[1.0, 0.0, 0.2], [0.0, 1.0, -0.1]]),
                warped([[1.15, 0.05, -0.1], [-0.05, 0.9, 0.05]]),
            ]
        ),
        5000.0,
    )
    assert (true_errors_px(stored, rendered) < 0.1).all()


def test_a_warp_is_found_past_the_valleys_of_a_rough_skyline():
    generator = np.random.default_rng(8)
    rough = np.cumsum(generator.normal(0.0, 2.0 * PX, WIDTH + 12))
    error = true_errors_px(views_of(rough[12:], 5000.0), views_of(rough[:-12], 5000.0))
    assert error[0] < 0.5


def test_another_skyline_is_told_by_how_far_it_is():
    stored = views_of(np.zeros(WIDTH), 5000.0)
    waves = 8.0 * PX * np.sin(40.0 * U)
    error = true_errors_px(stored, views_of(waves, 5000.0))
    # The mean of |sine| is 2 / pi; a straight line is straight however it is warped.
    assert error[0] == pytest.approx(8.0 * 2.0 / np.pi, rel=0.05)


def test_a_warp_beyond_the_bounds_is_no_likeness():
    flattened = views_of(0.2 * mountains(U), 5000.0)
    assert true_errors_px(views_of(mountains(U), 5000.0), flattened)[0] > 3.0


def test_skylines_that_hardly_meet_are_not_alike():
    half = np.where(U < 0.1, np.nan, mountains(U))
    error = true_errors_px(views_of(mountains(U), 5000.0), views_of(half, 5000.0))
    assert np.isinf(error[0])


def test_views_that_do_not_belong_together_are_refused():
    views = views_of(np.tile(mountains(U), (2, 1)), 900.0, [0, 1])
    with pytest.raises(InputError, match="2 stored views of 320 columns"):
        true_errors_px(views, views[:1])
    with pytest.raises(InputError, match="different headings"):
        true_errors_px(views, views[::-1])


def test_the_fit_finds_the_warp_that_made_a_curve():
    u = columns_u(80)
    true = np.array([[1.08, 0.05, 0.04], [-0.06, 0.93, 0.02]])
    finer = np.linspace(-1.5, 1.5, 3001)
    curve = mountains(u)
    x, y = true @ np.stack([finer, mountains(finer), np.ones_like(finer)])
    target = np.interp(u, x, y)
    distance, found = fitted_warps(
        curve[np.newaxis], target[np.newaxis], IDENTITY[np.newaxis], WIDTH, rounds=20
    )
    assert distance[0] < 0.1
    np.testing.assert_allclose(found[0], true, atol=0.01)


def test_the_fit_stays_within_its_bounds():
    u = columns_u(80)
    curve, flattened = mountains(u)[np.newaxis], 0.1 * mountains(u)[np.newaxis]
    distance, found = fitted_warps(curve, flattened, IDENTITY[np.newaxis], WIDTH, rounds=20)
    assert (np.abs(found[0, :, :2] - np.eye(2)) <= MAX_CHANGE + 1e-9).all()
    assert distance[0] > 3.0


def test_the_fit_begins_with_its_start_and_within_the_bounds_without_one():
    u = columns_u(80)
    curves, targets = np.tile(mountains(u), (2, 1)), np.tile(mountains(u + 0.3), (2, 1))
    shifted = IDENTITY + np.array([[0.0, 0.0, -0.3], [0.0, 0.0, 0.0]])
    starts = np.stack([shifted, np.full((2, 3), np.nan)])
    distance, found = fitted_warps(curves, targets, starts, WIDTH, rounds=0)
    assert distance[0] < 0.2
    assert np.isfinite(found).all()
    assert (np.abs(found[1, :, :2] - np.eye(2)) <= MAX_CHANGE).all()


@given(width=st.integers(1, 50), blocks=st.integers(1, 50), seed=st.integers(0, 1000))
def test_block_means_leave_unknown_columns_out(width, blocks, seed):
    generator = np.random.default_rng(seed)
    rows = generator.normal(size=(2, 3, width))
    rows[generator.random(rows.shape) < 0.3] = np.nan
    means = block_means(rows, blocks)
    parts = np.split(rows, [b * width // blocks for b in range(1, blocks)], axis=-1)
    if width <= blocks:
        parts = np.split(rows, width, axis=-1)
    for index, part in enumerate(parts):
        known = ~np.isnan(part)
        total = np.where(known, part, 0.0).sum(axis=-1)
        expected = np.where(known.any(axis=-1), total / np.maximum(known.sum(axis=-1), 1), np.nan)
        np.testing.assert_allclose(means[..., index], expected, rtol=1e-5, atol=1e-6)

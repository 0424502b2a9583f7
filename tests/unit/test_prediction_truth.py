"""True errors between skylines after the best warp, and the fit of that warp."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prediction_scenes import WIDTH, U, mountains, views_of

from skyline.errors import InputError
from skyline.paper.verify import block_means, true_errors_px

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


def test_views_that_do_not_belong_together_are_refused():
    views = views_of(np.tile(mountains(U), (2, 1)), 900.0, [0, 1])
    with pytest.raises(InputError, match="2 stored views of 320 columns"):
        true_errors_px(views, views[:1])
    with pytest.raises(InputError, match="different headings"):
        true_errors_px(views, views[::-1])


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

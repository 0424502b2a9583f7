"""True errors between skylines after the best warp, and the fit of that warp."""

import numpy as np
import pytest
from prediction_scenes import WIDTH, U, mountains, views_of

from skyline.errors import InputError
from skyline.paper.verify import true_errors_px

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

"""What is known of a lens beforehand."""

import math

import numpy as np
import pytest

from skyline.match.lens_prior import CROP_SD, LensPrior

CROPPED = LensPrior(sd=0.03, crop_share=0.2)


def test_a_lens_without_crops_is_normally_distributed():
    known = LensPrior(sd=0.03)
    np.testing.assert_allclose(known.cost([-0.06, 0.0, 0.03]), [2.0, 0.0, 0.5])
    np.testing.assert_allclose(known.precision([-0.06, 0.0, 0.03]), 0.03**-2.0)


def test_every_scale_of_an_unknown_lens_is_as_likely():
    np.testing.assert_array_equal(LensPrior().cost([-1.0, 0.0, 1.0]), 0.0)
    np.testing.assert_array_equal(LensPrior().precision([-1.0, 0.0, 1.0]), 0.0)


def test_a_crop_only_narrows():
    assert CROPPED.cost(0.12) == pytest.approx(8.0)
    assert CROPPED.cost(-0.12) < 4.0


def test_cost_is_the_logarithm_of_both_parts():
    # At -t the core is gone, and the tail has fallen by exp(-1 / 2).
    core = 0.8 / 0.03
    tail = 2.0 * 0.2 / (0.03 + CROP_SD)
    expected = 0.5 + np.log((core + tail) / tail)
    assert CROPPED.cost(-CROP_SD) == pytest.approx(expected)


@pytest.mark.parametrize("at", [-0.5, -0.1, -0.07, -0.01, 0.01, 0.2])
def test_precision_is_the_slope_of_the_cost_over_the_scale(at):
    slope = (CROPPED.cost(at + 1e-6) - CROPPED.cost(at - 1e-6)) / 2e-6
    assert CROPPED.precision(at) * at == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("at", [-0.5, -0.1, -0.07, -0.01])
def test_a_step_to_the_noted_scale_does_not_raise_the_cost(at):
    shares = np.linspace(0.0, 1.0, 11)
    parabola = CROPPED.cost(at) - 0.5 * CROPPED.precision(at) * at**2 * (1.0 - shares**2)
    assert np.all(CROPPED.cost(at * shares) <= parabola + 1e-9)


def test_cost_and_slope_are_continuous_where_the_tail_begins():
    before, after = CROPPED.cost([-1e-9, 1e-9])
    assert before == pytest.approx(after, abs=1e-9)
    assert CROPPED.precision(-1e-9) * 1e-9 == pytest.approx(0.0, abs=1e-5)


def test_a_core_as_wide_as_crops_has_no_tail():
    assert LensPrior(sd=0.5, crop_share=0.3).cost(-0.5) == pytest.approx(0.5)


def test_rms_is_the_root_mean_square_of_the_density():
    scales = np.linspace(-3.0, 3.0, 60_001)
    density = np.exp(-CROPPED.cost(scales))
    assert CROPPED.rms == pytest.approx(math.sqrt(np.average(scales**2, weights=density)), rel=1e-3)

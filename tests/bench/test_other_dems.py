"""Elevation models that differ from a given one."""

import numpy as np
import pytest
from scenes import at_m, field_from, field_of, fractal

from skyline.errors import InputError
from skyline_bench.queries.other_dems import perturbed, resampled


def test_errors_have_the_size_and_the_reach_asked_for():
    terrain = field_of(np.zeros((400, 600)), 30.0, 20.0)
    error = perturbed(terrain, 10.0, 300.0, seed=5).heights_m.astype(float)
    assert np.sqrt(np.mean(error**2)) == pytest.approx(10.0, abs=1e-3)
    east = np.mean(error[:, :-10] * error[:, 10:]) / 100.0
    north = np.mean(error[:-15] * error[15:]) / 100.0
    assert east == pytest.approx(np.exp(-1.0), abs=0.08)
    assert north == pytest.approx(np.exp(-1.0), abs=0.08)
    assert np.mean(error[:, :-25] * error[:, 25:]) / 100.0 < 0.1


def test_a_seed_decides_and_holes_stay():
    heights = fractal(40, 50, seed=1)
    heights[3, 4] = np.nan
    terrain = field_of(heights)
    first, again, other = (perturbed(terrain, seed=seed) for seed in (1, 1, 2))
    assert first.digest == again.digest != other.digest
    assert np.flatnonzero(np.isnan(first.heights_m)).tolist() == [3 * 50 + 4]
    np.testing.assert_array_equal(perturbed(terrain, 0.0).heights_m, heights)


def test_resampling_samples_the_same_surface():
    terrain = field_from(lambda east, north: 2.0 * east - 3.0 * north, 60, 30.0)
    other = resampled(terrain, 41.0, (0.25, 0.75))
    assert other.west_m == pytest.approx(terrain.west_m + 0.25 * 41.0)
    assert other.north_m == pytest.approx(terrain.north_m - 0.75 * 41.0)
    _, south, east, _ = terrain.bounds_m
    assert other.bounds_m[2] <= east < other.bounds_m[2] + 41.0
    assert other.bounds_m[1] >= south > other.bounds_m[1] - 41.0
    places = np.random.default_rng(0).uniform(-700.0, 700.0, (2, 50))
    np.testing.assert_allclose(
        other.height_at(**at_m(places)), terrain.height_at(**at_m(places)), atol=1e-6
    )


@pytest.mark.parametrize("arguments", [(-1.0,), (1.0, 0.0), (1.0, 300.0, -1)])
def test_bad_errors_are_refused(arguments):
    with pytest.raises(InputError, match="expected"):
        perturbed(field_of(np.zeros((4, 4))), *arguments)


@pytest.mark.parametrize("arguments", [(0.0,), (30.0, (1.0, 0.0)), (80.0,)])
def test_bad_grids_are_refused(arguments):
    with pytest.raises(InputError, match="expected"):
        resampled(field_of(np.zeros((4, 4))), *arguments)

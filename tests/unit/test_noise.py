"""Likelihood of residuals, against closed forms and against matrices written out."""

from dataclasses import replace

import numpy as np
import pytest

from skyline.match.likelihood import HeightErrors, cost_of_share, likelihood
from skyline.terrain.height_errors import HEIGHT_REACH_M


def _setting(nodes=6, columns=40):
    generator = np.random.default_rng(0)
    azimuth = np.linspace(-0.5, 0.5, columns)[np.newaxis]
    distance = 1000.0 + 3000.0 * generator.random((1, columns))
    return HeightErrors.of(azimuth, distance, 0.0 * distance, nodes), azimuth, distance


ANGLE_DEG, HEIGHT_M = np.array([0.1]), np.array([5.0])


def test_without_height_errors_the_cost_is_the_mixture_s():
    errors, _, _ = _setting()
    none = replace(errors, factor=0.0 * errors.factor, rough=0.0 * errors.rough)
    residual = np.random.default_rng(1).normal(0.0, 0.004, (1, 40))
    found = likelihood(residual, np.ones(40), none, ANGLE_DEG, HEIGHT_M, np.ones((1, 40)))
    sigma = np.radians(0.1)
    terrain = 0.83 * np.exp(-0.5 * (residual / sigma) ** 2) / np.sqrt(2.0 * np.pi) / sigma
    other = np.where(residual >= 0.0, 0.15, 0.02) / np.radians(15.0)
    np.testing.assert_allclose(found.cost[0], -np.log(terrain + other).sum(), rtol=1e-9)
    np.testing.assert_allclose(found.terrain_probability, terrain / (terrain + other), atol=1e-9)


def test_height_errors_have_the_stated_covariance_at_their_nodes():
    errors, azimuth, distance = _setting(nodes=40)
    point = (distance * np.exp(1j * azimuth))[0]

    def correlation(d):
        x = d * 2.1461932 / HEIGHT_REACH_M
        return (1.0 + x) * np.exp(-x)

    eye = correlation(np.abs(point))
    expected = correlation(np.abs(point[:, None] - point)) + 1.0 - eye[:, None] - eye
    expected /= distance[0][:, None] * distance[0]
    np.testing.assert_allclose(errors.factor[0] @ errors.factor[0].T, expected, atol=1e-11)
    assert correlation(HEIGHT_REACH_M) == pytest.approx(np.exp(-1.0))


def _converged(residual, errors, magnified=1.0, scale=1.0):
    probability, trust = np.ones((1, 40)), np.ones(40)
    deviations = scale * ANGLE_DEG, scale * HEIGHT_M
    for _ in range(12):
        found = likelihood(residual, trust, errors, *deviations, probability, magnified)
        probability = found.terrain_probability
    return found


@pytest.mark.parametrize("sd_rad", [0.0001, 0.0009, 0.0022])
def test_the_scale_of_all_errors_is_the_likeliest(sd_rad):
    errors, azimuth, distance = _setting()
    errors = HeightErrors.of(azimuth, distance, np.full_like(distance, 5e-4), 6)
    residual = np.random.default_rng(4).normal(0.0, sd_rad, (1, 40))
    costs = [
        _converged(residual, replace(errors, blur_rad=scale * errors.blur_rad), scale=scale).cost[0]
        for scale in np.geomspace(0.1, 1.3, 121)
    ]
    found = _converged(residual, errors)
    assert found.terrain_probability.min() > 0.95
    # They are of the errors before these are scaled; the cost is a bound for any probability.
    assert -1e-3 < found.scaled().cost[0] - min(costs) < 0.2
    assert found.scaled().cost[0] <= found.cost[0]
    held = found.scaled()
    covariance = held.factor[0] @ held.factor[0].T + np.diag(1.0 / held.weight[0])
    half_chi2 = 0.5 * residual[0] @ np.linalg.solve(covariance, residual[0])
    assert held.half_chi2[0] == pytest.approx(half_chi2, rel=1e-6)


@pytest.mark.parametrize(("off_deg", "is_cheaper"), [(1.0, True), (3.0, False), (-1.0, False)])
def test_terrain_past_the_edge_explains_what_stands_up_to_its_bound(off_deg, is_cheaper):
    _, azimuth, distance = _setting()
    errors = HeightErrors.of(azimuth, np.full_like(distance, 5e4), 0.0 * distance, 6)
    residual = np.random.default_rng(6).normal(0.0, 0.0005, (1, 40))
    residual[0, 10:20] = np.radians(off_deg)
    beyond_rad = np.radians(np.where(np.arange(40) // 10 == 1, 2.0, 0.0))[np.newaxis]
    with_beyond = replace(errors, beyond_rad=beyond_rad)
    without, there = (_converged(residual, some) for some in (errors, with_beyond))
    assert there.terrain_probability[0, 10:20].max() < 0.01
    np.testing.assert_allclose(
        there.terrain_probability[0, 20:], without.terrain_probability[0, 20:], atol=0.02
    )
    # Ten columns at a density of 0.3 in 2 degrees, where 0.15 in 15 was expected otherwise.
    gained = without.cost[0] - there.cost[0]
    expected = 10.0 * np.log((0.7 * 0.01 + 0.15) / 0.01) if is_cheaper else 0.0
    assert gained == pytest.approx(expected, rel=0.1, abs=0.1)


def test_a_skyline_in_front_of_all_terrain_past_the_edge_pays_nothing_for_it():
    """If each column had its prior by itself, forty of them would cost 40 log(1 / 0.7) = 14.3."""
    _, azimuth, distance = _setting()
    errors = HeightErrors.of(azimuth, np.full_like(distance, 5e4), 0.0 * distance, 6)
    residual = np.random.default_rng(6).normal(0.0, 0.0005, (1, 40))
    everywhere = replace(errors, beyond_rad=np.full((1, 40), np.radians(2.0)))
    without, there = (_converged(residual, some) for some in (errors, everywhere))
    assert 0.0 < there.cost[0] - without.cost[0] < 0.1


def test_the_choice_of_a_share_costs_about_what_the_mean_over_all_shares_lacks():
    """Of (1 - s)^(120 / 8) over shares s up to 0.3 the mean is (1 - 0.7^16) / (16 x 0.3)."""
    cost = cost_of_share(np.array([0.0, 120.0]), 8.0)
    assert cost[0] == 0.0
    assert cost[1] == pytest.approx(8.0 * np.log(4.8), rel=0.1)


@pytest.mark.parametrize("assumed", [0.5, 1.0, 1.7])
def test_the_log_scale_pull_is_the_slope_of_the_cost(assumed):
    errors, _, _ = _setting()
    residual = np.random.default_rng(5).normal(0.0, 0.003, (1, 40))
    residual[0, 5] = np.nan
    residual[0, 20] = np.radians(4.0)
    scales = assumed * np.exp([-1e-4, 1e-4])
    more, less = (_converged(residual, errors, scale).cost[0] for scale in scales)
    pull = _converged(residual, errors, assumed).log_scale_pull(np.nan_to_num(residual))
    assert pull[0] == pytest.approx((more - less) / 2e-4, rel=1e-4)


def test_an_error_of_the_eye_s_height_shows_in_full_far_away_and_not_at_all_near_by():
    """Near by the terrain errs as the ground under the eye does."""
    distance = np.geomspace(1.0, 1e6, 60)[np.newaxis]
    errors = HeightErrors.of(0.0 * distance, distance, 0.0 * distance, 0)
    # Of a metre's error, what is left of the angle it would have without that.
    left = errors.factor[0, :, 0] * distance[0]
    assert (np.diff(left) > 0.0).all()
    assert 0.0 < left[0] < 1e-4
    assert left[-1] == pytest.approx(1.0, abs=1e-6)
    assert (errors.rough[0] * distance[0] <= 1.0).all()


def test_products_are_those_of_the_whole_covariance():
    errors, _, _ = _setting()
    residual = np.random.default_rng(2).normal(0.0, 0.001, (1, 40))
    found = likelihood(residual, np.ones(40), errors, ANGLE_DEG, HEIGHT_M, np.ones((1, 40)))
    covariance = found.factor[0] @ found.factor[0].T + np.diag(1.0 / found.weight[0])
    left, right = np.random.default_rng(3).normal(size=(2, 1, 3, 40))
    expected = left[0] @ np.linalg.solve(covariance, right[0].T)
    np.testing.assert_allclose(found.product(left, right)[0], expected, rtol=1e-6)
    assert found.effective_columns[0] < found.terrain_probability.sum() - 2.0


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_column_far_below_the_skyline_is_as_unlikely_under_a_surface_in_any_lens(scale):
    """Its density is 0.02 in 15 degrees, whether or not a surface bounds what may rise above."""
    bare, _, _ = _setting()
    errors = replace(bare, rise_rad=np.full((1, 40), np.radians(1.0)))
    residual = np.full((1, 40), np.radians(-5.0))
    found = likelihood(residual, np.ones(40), errors, ANGLE_DEG, HEIGHT_M, np.zeros((1, 40)), scale)
    assert found.cost[0] == pytest.approx(-40.0 * np.log(0.02 / np.radians(15.0)), rel=1e-6)

"""Sky view factors where they are known in closed form."""

import numpy as np
import pytest

from skyline import InputError, sky_view_factor

AZIMUTH_DEG = np.arange(720) * 0.5


@pytest.mark.parametrize("wall_deg", [5.0, 30.0, 60.0, 70.0])
def test_the_bottom_of_a_cone_and_of_an_endless_valley(wall_deg):
    expected = np.cos(np.radians(wall_deg)) ** 2
    assert sky_view_factor(AZIMUTH_DEG, np.full(720, wall_deg)) == pytest.approx(expected)
    # The mean of 1 / (1 + t^2 cos^2 a) over a turn is 1 / sqrt(1 + t^2).
    across = np.abs(np.cos(np.radians(AZIMUTH_DEG)))
    elevation = np.degrees(np.arctan(np.tan(np.radians(wall_deg)) * across))
    valley = sky_view_factor(AZIMUTH_DEG, elevation)
    assert valley == pytest.approx(np.cos(np.radians(wall_deg)))


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 60.0, 90.0, 100.0, 120.0, 150.0, 180.0])
@pytest.mark.parametrize("facing_deg", [0.0, 180.0, 251.0])
def test_a_module_on_a_plain_sees_half_of_one_plus_its_cosine(tilt_deg, facing_deg):
    expected = 0.5 * (1.0 + np.cos(np.radians(tilt_deg)))
    factor = sky_view_factor(AZIMUTH_DEG, np.zeros(720), tilt_deg, facing_deg)
    assert factor == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize(("tilt_deg", "wall_deg"), [(10.0, 30.0), (40.0, 40.0), (60.0, 75.0)])
def test_a_module_that_sees_a_cap_round_the_zenith_whole(tilt_deg, wall_deg):
    factor = sky_view_factor(AZIMUTH_DEG, np.full(720, wall_deg), tilt_deg, 251.0)
    expected = np.cos(np.radians(tilt_deg)) * np.cos(np.radians(wall_deg)) ** 2
    assert factor == pytest.approx(expected)


def test_a_module_is_shaded_by_what_it_faces_and_not_by_what_is_behind():
    south = np.where(np.abs(AZIMUTH_DEG - 180.0) < 45.0, 30.0, 0.0)
    faced, behind = (sky_view_factor(AZIMUTH_DEG, south, 60.0, to) for to in (180.0, 0.0))
    assert faced < 0.65
    assert behind == pytest.approx(0.75, abs=2e-5)


def test_many_horizons_at_once_and_one_that_is_not_known():
    elevation = np.full((2, 720), 30.0)
    elevation[1, 5] = np.nan
    factors = sky_view_factor(AZIMUTH_DEG, elevation)
    assert factors[0] == pytest.approx(0.75)
    assert np.isnan(factors[1])


@pytest.mark.parametrize("seed", range(20))
def test_the_factor_is_the_integral_over_the_hemisphere(seed):
    """The variation of the integrand along an azimuth is at most 1, and 1 more at the horizon."""
    generator = np.random.default_rng(seed)
    tilt_deg, facing_deg = generator.uniform(0.0, (180.0, 360.0))
    azimuth, elevation = np.arange(72) * 5.0, generator.uniform(-20.0, 80.0, 72)
    step = 0.5 * np.pi / 4000
    zenith = (np.arange(4000) + 0.5)[:, np.newaxis] * step
    tilt, away = np.radians(tilt_deg), np.radians(azimuth - facing_deg)
    falls = np.cos(tilt) * np.cos(zenith) + np.sin(tilt) * np.sin(zenith) * np.cos(away)
    light = np.maximum(falls, 0.0) * np.sin(zenith) * (90.0 - np.degrees(zenith) > elevation)
    factor = sky_view_factor(azimuth, elevation, tilt_deg, facing_deg)
    assert factor >= 0.0
    # The midpoint rule errs by at most half a step times the variation; light is counted twice.
    assert factor == pytest.approx(2.0 * step * light.sum(axis=0).mean(), abs=2.0 * step)


@pytest.mark.parametrize("given", [(-1, 0), (180.1, 0), (np.nan, 0), (None, 0), (9, np.inf)])
def test_a_tilt_beyond_a_half_turn_is_refused(given):
    with pytest.raises(InputError, match="a tilt from 0"):
        sky_view_factor(AZIMUTH_DEG, np.zeros(720), *given)

"""Sky view factors against integrals, and where they are known in closed form."""

import numpy as np
import pytest

from skyline import InputError, sky_view_factor

AZIMUTH_DEG = np.arange(720) * 0.5


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 60.0, 90.0, 100.0, 120.0, 150.0, 180.0])
@pytest.mark.parametrize("facing_deg", [0.0, 180.0, 251.0])
def test_a_module_on_a_plain_sees_half_of_one_plus_its_cosine(tilt_deg, facing_deg):
    expected = 0.5 * (1.0 + np.cos(np.radians(tilt_deg)))
    factor = sky_view_factor(AZIMUTH_DEG, np.zeros(720), tilt_deg, facing_deg)
    assert factor == pytest.approx(expected, abs=2e-5)


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
    with pytest.raises(InputError):
        sky_view_factor(AZIMUTH_DEG, np.zeros(720), *given)

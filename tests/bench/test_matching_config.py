"""What a comparison of matchers is asked for, and what of it does not fit."""

import numpy as np
import pytest
from scenes import field_of

from skyline.build.grid import map_bounds
from skyline.errors import InputError
from skyline.paper.planning.plan import PlanConfig
from skyline_bench.runs.matching import MatchingConfig, check, middle_deg

PLAIN = field_of(np.zeros((300, 300), dtype=np.float32), 30.0, north_m=9000.0)


def planned(*thresholds_px):
    return tuple(PlanConfig("lpov", threshold_px=pixels) for pixels in thresholds_px)


def side_m(bounds_deg):
    west, south, east, north = map_bounds(PLAIN, bounds_deg)
    return east - west, north - south


def test_quick_is_the_middle_with_renderings_to_match():
    config = MatchingConfig(plans=planned(6.0, 3.0), bounds_deg=middle_deg(PLAIN, (6000.0, 6000.0)))
    quick = config.quick(PLAIN)
    assert side_m(quick.bounds_deg) == pytest.approx((3000.0, 3000.0), rel=0.02)
    assert (quick.spacings_m, quick.place_spacings_m) == ((1024.0, 512.0), (None,))
    assert quick.plans[0].threshold_px == 6.0
    assert len(quick.plans) == 1
    assert quick.queries < 20
    assert check(PLAIN, quick) == quick.bounds_deg


def test_what_is_asked_for_twice_is_measured_once():
    config = MatchingConfig(spacings_m=(512.0, 256.0, 512.0), plans=planned(6.0, 6.0))
    assert config.spacings_m == (512.0, 256.0)
    assert config.plans == planned(6.0)


def test_what_does_not_fit_is_refused():
    small = middle_deg(PLAIN, (900.0, 900.0))
    for config, said in (
        (MatchingConfig(bounds_deg=small), "too small for a grid of 1024 m"),
        (MatchingConfig(bounds_deg=(40.0, 10.0, 41.0, 11.0)), "do not meet the DEM"),
    ):
        with pytest.raises(InputError, match=said):
            check(PLAIN, config)
    for options, said in (
        ({"spacings_m": (), "place_spacings_m": ()}, "no store to match"),
        ({"matchers": ()}, "no store to match"),
        ({"queries": 2, "grouped": True}, "queries is 2; expected 3"),
        ({"workers": 0}, "workers is 0"),
    ):
        with pytest.raises(InputError, match=said):
            MatchingConfig(**options)

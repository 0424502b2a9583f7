"""What uniform against adaptive is asked to compare."""

import numpy as np
import pytest
from scenes import field_of

from skyline.errors import InputError
from skyline.planning.uniform import map_bounds
from skyline_bench.runs.matching import middle_deg
from skyline_bench.runs.uniform_adaptive import AdaptiveConfig, check

PLAIN = field_of(np.zeros((300, 300), dtype=np.float32), 30.0, north_m=9000.0)


def side_m(bounds_deg):
    west, south, east, north = map_bounds(PLAIN, bounds_deg)
    return east - west, north - south


def test_plans_are_by_strategy_then_budget():
    plans = AdaptiveConfig(strategies=("sov", "lpov"), budgets=(900, 300), seed=4).plans()
    assert [(one.strategy, one.budget, one.seed) for one in plans] == [
        ("sov", 300, 4), ("sov", 900, 4), ("lpov", 300, 4), ("lpov", 900, 4),
    ]  # fmt: skip


def test_quick_is_the_middle_with_renderings_to_match():
    config = AdaptiveConfig(budgets=(1600, 800), bounds_deg=middle_deg(PLAIN, (6000.0, 6000.0)))
    quick = config.quick(PLAIN)
    assert side_m(quick.bounds_deg) == pytest.approx((3000.0, 3000.0), rel=0.02)
    assert quick.spacings_m == (1024.0, 512.0)
    assert quick.budgets[0] == pytest.approx(200, abs=6)
    assert quick.queries < 20
    assert check(PLAIN, quick) == quick.bounds_deg


def test_what_is_asked_for_twice_is_measured_once():
    config = AdaptiveConfig(spacings_m=(512.0, 256.0, 512.0), budgets=(800, 800))
    assert config.spacings_m == (512.0, 256.0)
    assert config.budgets == (800,)


def test_what_does_not_fit_is_refused():
    small = middle_deg(PLAIN, (900.0, 900.0))
    for config, said in (
        (AdaptiveConfig(bounds_deg=small), "too small for a grid of 1024 m"),
        (AdaptiveConfig(bounds_deg=(40.0, 10.0, 41.0, 11.0)), "do not meet the DEM"),
        (AdaptiveConfig(budgets=(2,)), "budget is 2"),
    ):
        with pytest.raises(InputError, match=said):
            check(PLAIN, config)
    for options in ({"strategies": ()}, {"budgets": ()}, {"spacings_m": ()}, {"matchers": ()}):
        with pytest.raises(InputError, match="nothing to compare"):
            AdaptiveConfig(**options)

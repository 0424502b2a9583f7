"""Planned builds that are given a number of renderings instead of a threshold."""

import json

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.paper.planning.candidates import Spacing
from skyline.paper.planning.plan import PlanConfig
from skyline.pipeline.config import RenderConfig
from skyline.pipeline.planned import build_planned
from skyline.store import amend_config, check_store, open_store

BUDGET = 240
NARROW = RenderConfig(width=64)


def planned(strategy, budget=BUDGET):
    spacing = Spacing(coarse_m=600.0, candidate_m=50.0, reach_m=150.0)
    return PlanConfig(strategy, spacing, threshold_px=0.2, coverage=0.9, budget=budget)


@pytest.fixture(scope="module")
def valley():
    return field_of(fractal(50, 50, relief_m=300.0, seed=6), 40.0)


def rows_of(path):
    with open_store(path) as store:
        views, header = store.views(), store.header
    return list(zip(views.easting_m, views.northing_m, views.heading, strict=True)), header


@pytest.mark.parametrize("strategy", ["lpov", "rov"])
def test_renders_as_much_as_it_was_given_and_says_what_for(valley, tmp_path, strategy):
    done = build_planned(valley, tmp_path / "s.h5", planned(strategy), config=NARROW)
    assert 0.9 * BUDGET <= done.built.rows <= BUDGET
    assert done.plan.threshold_px > 0.2
    assert done.plan.coverage >= 0.9
    _, header = rows_of(tmp_path / "s.h5")
    assert header.config["reached_px"] == done.plan.threshold_px
    assert header.config["plan"]["budget"] == BUDGET
    assert not check_store(tmp_path / "s.h5").damage


@pytest.mark.slow
@pytest.mark.parametrize("batches", [1, 3])
def test_a_stopped_build_goes_on_to_the_same_store(valley, tmp_path, batches):
    whole, broken = tmp_path / "whole.h5", tmp_path / "broken.h5"
    build_planned(valley, whole, planned("lpov"), config=NARROW)

    def stop(now):
        if now.batches == batches:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_planned(valley, broken, planned("lpov"), config=NARROW, progress=stop)
    assert "reached_px" not in rows_of(broken)[1].config
    build_planned(valley, broken, planned("lpov"), config=NARROW)
    assert rows_of(broken) == rows_of(whole)
    again = build_planned(valley, broken, planned("lpov"), config=NARROW)
    assert again.built.rendered == 0
    assert rows_of(broken) == rows_of(whole)


def test_command_line(dem, run, tmp_path):
    store = tmp_path / "s.h5"
    told = run(
        *("build", dem, "-o", store, "--planner", "lpov", "--budget", 120),
        *("--threshold-px", 0.1, "--width", 64),
    )
    assert told.code == 0, told.err
    facts = json.loads(run("info", store, "--json").out)
    assert 108 <= facts["renderings"] <= 120
    assert f"to {facts['config']['reached_px']:.3g} px" in told.out


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--budget", 100], "--budget 100 is for a store of renderings; give --planner too"),
        (["--planner", "uniform", "--budget", 100], "--budget 100 is for a planner that chooses"),
        (["--planner", "lpov", "--budget", 2], "budget is 2 renderings"),
    ],
)
def test_bad_budgets_are_refused(dem, run, tmp_path, options, said):
    told = run("build", dem, "-o", tmp_path / "s.h5", *options)
    assert told.code == 2
    assert said in told.err
    assert not (tmp_path / "s.h5").exists()


def test_settings_are_amended_and_rows_kept(valley, tmp_path):
    path = tmp_path / "s.h5"
    build_planned(valley, path, planned("lpov"), config=NARROW)
    with open_store(path) as store:
        before, header = store.stored(slice(0, len(store))), store.header
    amend_config(path, {"reached_px": 1.5, "remark": "by hand"})
    with open_store(path) as store:
        after = store.stored(slice(0, len(store)))
        assert store.header.config == {**header.config, "reached_px": 1.5, "remark": "by hand"}
    for name, values in before.items():
        np.testing.assert_array_equal(values, after[name])
    assert not check_store(path).damage

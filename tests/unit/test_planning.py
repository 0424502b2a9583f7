"""Strategies and the loop on made-up areas: no terrain is seen, no view is rendered."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.paper import plan as planning
from skyline.paper.plan import PlanConfig, plan
from skyline.paper.planners import PLANNERS, arov
from skyline.plugins import names_of
from skyline.skylines import Views
from skyline_bench.paper import TABLE_1, Simulation, simulate

SPACING = {"coarse_m": 300.0, "site_spacing_m": 30.0}


@pytest.mark.parametrize("name", names_of(PLANNERS))
def test_the_same_seed_plans_the_same(terrain, name):
    first, again = (run_plan(terrain, views_at, name).views for _ in range(2))
    np.testing.assert_array_equal(first.easting_m, again.easting_m)
    np.testing.assert_array_equal(first.heading, again.heading)


def test_areas_of_table_1_are_as_large_as_the_papers():
    """Its mean tolerance areas follow from its (A) and (B): 44, about 195 and 82 cells."""
    for row, size in zip(TABLE_1, (44.0, 195.0, 82.0), strict=True):
        areas = simulate(Simulation(row), arov, seed=0).areas
        assert np.count_nonzero(areas) / len(areas) == pytest.approx(size, rel=0.2)


def views_at(viewpoints, heading):
    """Views whose skylines depend on where they are."""
    tan = np.tile((viewpoints.easting_m % 7.0)[:, None], 8).astype(np.float32)
    eyes = viewpoints.easting_m, viewpoints.northing_m, viewpoints.eye_elevation_m
    return Views(*eyes, heading, tan, np.full_like(tan, 100.0), np.zeros(tan.shape, np.uint8))


@pytest.fixture(scope="module")
def terrain():
    heights = fractal(60, 60, relief_m=50.0, seed=1)
    heights[20:25, 20:40] = np.nan
    return field_of(heights, 30.0)


@pytest.fixture(autouse=True)
def discs(monkeypatch):
    """Every view's tolerance area is a disc of three sites."""

    def errors(points, *_, size, **__):
        step = np.arange(size) - size // 2
        disc = np.where(np.hypot(step[:, None], step) <= 3.0, 0.0, 9.0)
        return np.broadcast_to(disc, (len(points), size, size))

    monkeypatch.setattr(planning, "tolerance_errors_px", errors)


def run_plan(terrain, render, name="lpov"):
    return plan(terrain, render, PlanConfig(name, **SPACING, coverage=0.9))


@pytest.mark.parametrize("name", names_of(PLANNERS))
def test_holes_and_the_border_are_never_chosen(terrain, name):
    done = run_plan(terrain, views_at, name)
    assert done.coverage >= 0.9
    for one in done.coverages:
        eyes = done.viewpoints(one.viewpoints)
        row, col = terrain.to_grid(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
        assert ((row >= 1) & (row <= 58) & (col >= 1) & (col <= 58)).all()
        assert not ((row > 19) & (row < 25) & (col > 19) & (col < 40)).any()

"""Stores of a comparison: built once, found again, and places where a planner stood."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.build.plans import PlacePlan
from skyline.render.horizon import RenderConfig
from skyline.store import open_store
from skyline.store.format import PLACES
from skyline_bench.stores.reference import laid_out_store, planned_places, uniform_renderings

pytestmark = pytest.mark.usefixtures("no_gl_error")


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(60, 60, relief_m=400.0, seed=6), 30.0, north_m=1800.0)


def test_a_store_of_places_is_built_once(terrain, tmp_path):
    first = laid_out_store(terrain, tmp_path, PlacePlan(300.0))
    again = laid_out_store(terrain, tmp_path, PlacePlan(300.0))
    assert first == again
    assert first.holds == PLACES
    assert first.places == first.rows == first.renderings / 4
    assert min(first.build_s, first.build_cpu_s) > 0.0


def test_places_stand_where_a_planner_did(terrain, tmp_path):
    planned = uniform_renderings(terrain, tmp_path, 400.0, None, RenderConfig(width=160))
    store = planned_places(terrain, tmp_path, planned)
    assert store.rows == store.places == planned.places == planned.rows / 4
    assert store.build_s > planned.build_s
    with open_store(planned.path) as opened:
        there = opened.eyes()
    with open_store(store.path) as opened:
        places = opened.places().take(np.arange(store.rows))
    at = set(zip(there.easting_m, there.northing_m, strict=True))
    assert at == set(zip(places.easting_m, places.northing_m, strict=True))
    np.testing.assert_allclose(places.tolerance_m, 200.0)
    # Its own cost is noted, so that the planning is not counted twice.
    assert planned_places(terrain, tmp_path, planned) == store

"""Cost against size: the areas, the fit, and what is said of a larger one."""

import dataclasses

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.experiments import scale
from skyline.experiments.area_cost import (
    MATCHING,
    Area,
    AreaCost,
    BuildCost,
    MatchCost,
    extent_km2,
    opening_bytes,
    predicted_places,
)
from skyline.experiments.extrapolation import Line, extrapolate
from skyline.experiments.memory import available_bytes, peak_bytes, reset_peak
from skyline.experiments.scale import ScaleConfig, measure


@pytest.fixture(scope="module")
def terrain():
    """Return rough terrain, 3.6 x 2.4 km."""
    return field_of(fractal(81, 121, 250.0, seed=5), west_m=1000.0, north_m=5000.0)


def test_an_area_lies_in_the_middle_in_the_proportions_of_the_dem(terrain):
    west, south, east, north = Area(2.16, 300.0, 0).bounds_m(terrain)
    assert (west, south, east, north) == pytest.approx((1900.0, 3200.0, 3700.0, 4400.0))
    assert extent_km2(terrain) == pytest.approx(8.64)
    places = Area(2.16, 300.0, 0).viewpoints(terrain)
    assert len(places) == 6 * 4
    assert np.all((places.easting_m >= west) & (places.northing_m <= north))


def test_a_line_is_found_and_small_costs_count_as_much():
    n = np.array([100.0, 1000.0, 50_000.0])
    line = Line.fit(n, 3.0 + 0.002 * n)
    assert (line.fixed, line.each) == pytest.approx((3.0, 0.002))
    # Both ends are a tenth off; by absolute errors the small one would not count at all.
    bent = Line.fit([100.0, 10_000.0], [1.1, 90.0])
    assert bent.at(100.0) == pytest.approx(1.1)
    assert bent.at(10_000.0) == pytest.approx(90.0)


def test_no_cost_is_below_nothing():
    assert Line.fit([100.0, 1000.0], [0.5, 10.0]).fixed == 0.0
    assert Line.fit([200.0], [5.0]) == Line(0.0, 0.025)


def test_costs_that_noise_hides_are_not_taken_for_nothing():
    assert Line.fit([4.0, 100.0, 1000.0], [5.0, 7.0, 4.0]) == Line(0.0, 0.004)


def cost_of(area, renderings, fixed_s=2.0, match="not asked"):
    """Make a cost of 2 ms and 600 bytes a rendering, but for what is fixed."""
    seconds = fixed_s + 0.002 * renderings
    build = BuildCost(renderings, seconds, 1.5 * seconds, 5000 + 600 * renderings)
    return AreaCost(area, build, match, None)


ONE = cost_of(Area(1.0, 500.0, 12), 4).build


def test_a_larger_area_is_extrapolated_and_its_assumptions_are_said():
    matched = [MatchCost(20_000, 4.0, 5, 1200.0, 900.0, 0.6, 40.0)]
    matched += [dataclasses.replace(matched[0], places=80_000, query_ms=1800.0)]
    measured = [
        cost_of(Area(50.0, 500.0, 12), 800, match=matched[0]),
        cost_of(Area(200.0, 500.0, 12), 3200, match=matched[1]),
    ]
    probe = cost_of(Area(4.0, 50.0, 12), 6400, fixed_s=6.4)
    row = extrapolate(ONE, measured, probe, 10_000.0)
    assert row["renderings"] == 4 * 10_000 * 400
    assert row["build_s"] == pytest.approx(2.0 + 0.002 * 16e6)
    assert row["bytes"] == pytest.approx(5000 + 600 * 16e6)
    assert row["build_cpu_s"] == pytest.approx(1.5 * row["build_s"])
    assert row["build_cpu_s_at_probe_rate"] == pytest.approx(0.0045 * 16e6)
    assert row["build_s_at_probe_rate"] == pytest.approx(0.003 * 16e6)
    places = predicted_places(10_000.0, 4_000_000)
    assert row["places"] == places >= 4_000_000
    assert row["query_ms"] == pytest.approx(1000.0 + 0.01 * places)
    assert row["opening_bytes"] == opening_bytes(places, 4_000_000, 12) > 2e11
    assert row.keys() >= {"area_km2", "spacing_m", "shells"}
    said = " ".join(row["assumptions"])
    for figure in ("2.000 ms", "600 bytes", "50, 200 km2", "50 m apart", "3.000 ms", "20,000"):
        assert figure in said


def test_query_time_is_not_extrapolated_from_one_area():
    alone = cost_of(Area(50.0, 500.0, 0), 800, match=MatchCost(1, 1.0, 1, 1.0, 1.0, 1.0, 1.0))
    row = extrapolate(ONE, [alone], cost_of(Area(4.0, 50.0, 0), 6400), 10_000.0)
    assert row["query_ms"] is None
    assert "query time is not extrapolated" in row["assumptions"][-1]


def test_places_are_the_store_s_and_a_lattice_s():
    lattice = 1e6 / MATCHING.densify.pitch_m**2
    assert predicted_places(1.0, 4) == pytest.approx(4 + lattice, abs=1.0)
    assert predicted_places(1.0, 10_000) == pytest.approx(10_000 + lattice, abs=1.0)


CONFIG = ScaleConfig(
    areas_km2=(6.0, 1.0), spacing_m=400.0, shells=(0,), queries=1, probe_km2=0.04,
    target_km2=100.0,
)  # fmt: skip


def test_stores_that_take_too_long_to_open_are_not_matched_and_the_row_says_so(terrain, tmp_path):
    seen = []
    rows = measure(
        terrain,
        dataclasses.replace(CONFIG, open_limit_s=1e-9),
        tmp_path,
        lambda done, total: seen.append((done, total)),
    )
    small, large, probe, beyond = rows
    assert [row["kind"] for row in rows] == ["measured", "measured", "probe", "extrapolated"]
    assert (small["area_km2"], large["area_km2"]) == (1.0, 6.0)
    assert small["query_ms"] > 0.0
    assert small["not_matched"] is None
    assert large["query_ms"] is None
    assert "would take" in large["not_matched"]
    assert large["renderings"] > small["renderings"] > 0
    assert probe["spacing_m"] == 50.0
    assert beyond["renderings"] == 4 * 100 * 400
    assert seen == [(1, 3), (2, 3), (3, 3)]
    assert not list(tmp_path.iterdir())


def test_stores_that_memory_cannot_hold_are_not_matched(terrain, tmp_path, monkeypatch):
    monkeypatch.setattr(scale, "available_bytes", lambda: 1e6)
    rows = measure(terrain, dataclasses.replace(CONFIG, areas_km2=(1.0,)), tmp_path)
    assert rows[0]["query_ms"] is None
    assert "of memory are at hand" in rows[0]["not_matched"]


def test_the_same_seed_finds_the_same(terrain, tmp_path):
    config = dataclasses.replace(CONFIG, areas_km2=(1.0,))
    first, again = (measure(terrain, config, tmp_path)[0] for _ in range(2))
    for key in ("renderings", "bytes", "within_200m", "median_m", "places"):
        assert first[key] == again[key]


def test_areas_that_do_not_fit_are_left_out_aloud(terrain, tmp_path, caplog):
    rows = measure(terrain, dataclasses.replace(CONFIG, areas_km2=(1.0, 9.0, 70.0)), tmp_path)
    assert [row["area_km2"] for row in rows if row["kind"] == "measured"] == [1.0]
    assert "the DEM covers 9 km2: 9, 70 km2" in caplog.text
    with pytest.raises(InputError, match="no area fits"):
        measure(terrain, dataclasses.replace(CONFIG, areas_km2=(9.0,)), tmp_path)


def test_memory_is_measured():
    reset_peak()
    before = peak_bytes()
    if before is None:
        pytest.skip("this system does not say")
    taken = np.ones(30_000_000)
    assert peak_bytes() >= before + 0.9 * taken.nbytes
    assert available_bytes() > 0

"""Stores x queries: built, searched, kept and counted."""

from collections import Counter
from functools import partial

import numpy as np
import pytest
from commands import assert_refused
from scenes import candidate_at, field_of, fractal

from skyline import MatchResult, Narrowing, read_dem
from skyline.errors import InputError
from skyline.photo.skyline import PhotoSkyline
from skyline.survey.plans import map_bounds
from skyline_bench.measuring import middle_of, shown
from skyline_bench.queries.kinds import make_kind
from skyline_bench.queries.synthetic import SyntheticQuery, Truth
from skyline_bench.search.stages import stage_of_loss
from skyline_bench.search.trials import (
    Trial,
    against_equal,
    as_large,
    gain_points,
    open_matcher,
    summarize,
    trial_of,
)


@pytest.fixture
def run(recorded):
    """Return a function that runs a command and gives its record."""

    def run_command(command, *arguments):
        record, printed = recorded(command, *arguments)
        assert record["bench"] == command
        assert record["rows"][0]["store"] in printed
        return record

    return run_command


@pytest.fixture(scope="module")
def compared(recorded, dem, tmp_path_factory):
    """The command that compares stores and matchers, its folder, and its rows."""
    kept = tmp_path_factory.mktemp("kept")
    asked = (
        "matching", dem, "--spacing", 600, "--spacing", 300, "--places", 400, "--queries", 3,
        "--matcher", "correlation", "--matcher", "unrefined", "--folder", kept,
    )  # fmt: skip
    record, _ = recorded(*asked)
    return asked, kept, record["rows"]


def test_stores_matchers_and_kinds_are_compared(compared):
    _, _, rows = compared
    every = [row for row in rows if row["group"] == "all"]
    assert [(row["store"], row["matcher"], row["queries"]) for row in every] == [
        (store, matcher, kind)
        for store, matcher in (
            ("uniform-600", "correlation"),
            ("uniform-300", "correlation"),
            ("places-600", "unrefined"),
            ("places-300", "unrefined"),
            ("planned-400", "unrefined"),
        )
        for kind in ("plain", "white", "other-dem", "occluded", "bent", "aligned")
    ]
    assert every[0]["places"] < every[6]["places"] == every[18]["places"]


def test_a_comparison_has_shares_and_means_within_their_intervals(compared):
    _, _, rows = compared
    for row in (row for row in rows if row["group"] == "all"):
        assert row["n"] == 3
        assert row["within_200m_low"] <= row["within_200m"] <= row["within_200m_high"]
        assert row["mean_m_low"] <= row["mean_m"] <= row["mean_m_high"] < 5000.0
        assert row["within_200m"] <= row["within_1km"]
        assert row["build_s"] > 0.0


def test_a_comparison_drops_no_query(compared):
    """The groups make up the whole, so that each query counts twice."""
    counted = Counter()
    for row in compared[2]:
        counted[row["store"], row["matcher"], row["queries"]] += row["n"]
    assert set(counted.values()) == {6}


def test_stores_that_are_there_are_not_built_again(run, compared):
    asked, kept, _ = compared
    before = {path: path.stat().st_mtime_ns for path in kept.glob("*.h5")}
    searched = run(*asked, "--kind", "plain", "--area", 1)["rows"]
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert {row["matcher"] for row in searched if row["search"] != "all"} == {"unrefined"}


def test_stores_of_other_bounds_are_not_searched(run_bench, compared):
    asked, _, _ = compared
    elsewhere = run_bench(*asked, "--bounds", "10.32,46.74,10.34,46.76")
    assert_refused(elsewhere, "has other bounds or another DEM")


@pytest.mark.slow
@pytest.mark.usefixtures("refined_quickly")
def test_uniform_and_adaptive_stores_are_compared(run, dem):
    record = run(
        "uniform-adaptive", dem, "--spacing", 600, "--threshold-px", 40, "--places", 400,
        "--queries", 3, "--matcher", "paper", "--matcher", "unrefined",
    )  # fmt: skip
    rows = [(row["store"], row["matcher"], row["group"]) for row in record["rows"]]
    held = record["summary"]["against_equal"]
    assert [row["store"] for row in held] == ["lpov-40px", "planned-400"]
    assert rows == [
        (store, matcher, group)
        for store, matcher in (
            ("uniform-600", "paper"),
            ("lpov-40px", "paper"),
            (held[0]["uniform"], "paper"),
            ("places-600", "unrefined"),
            ("planned-400", "unrefined"),
            (held[1]["uniform"], "unrefined"),
        )
        for group in ("close", "medium", "far", "all")
    ]
    places = {row["store"]: row["places"] for row in record["rows"]}
    for row in held:
        assert places[row["uniform"]] == pytest.approx(places[row["store"]], rel=0.1)


@pytest.mark.slow
@pytest.mark.usefixtures("refined_quickly")
def test_placing_shows_what_is_claimed_and_what_is_lost(run, dem, tmp_path):
    record = run("placing", dem, "--places", 600, "--queries", 2, "--folder", tmp_path)
    planned, grid = (row for row in record["rows"] if row["group"] == "all")
    assert (planned["store"], grid["planner"]) == ("planned-600", "uniform")
    # The number is of the lattices that suit viewpoints spread over the area.
    assert planned["places"] == pytest.approx(600, rel=0.2)
    for row in (grid, planned):
        assert 0.0 < row["claimed_loss"] < 1.0
        assert row["lost"] == pytest.approx(1.0 - row["within_1km"])


@pytest.mark.slow
@pytest.mark.usefixtures("refined_quickly")
def test_growing_areas_are_searched(run, dem, store):
    asked = ["matching", dem, "--store", store, "--matcher", "full", "--kind", "plain"]
    asked += ["--area", 4, "--area", 2]
    rows = [row for row in run(*asked, "--queries", 2)["rows"] if row["group"] == "all"]
    assert [row["search"] for row in rows] == ["2 km2", "4 km2", "all"]
    assert all(row["query_cpu_s"] > 0.0 for row in rows)


@pytest.mark.slow
@pytest.mark.usefixtures("refined_quickly")
def test_photos_of_one_place_and_strangers(run, dem, store):
    rows = run("same-place", dem, "--store", store, "--queries", 3)["rows"]
    every = {row["queries"]: row for row in rows if row["group"] == "all"}
    count = {name: row["n"] for name, row in every.items()}
    assert count == {"alone": 9, "together": 3, "with a stranger": 3}
    assert every["together"]["within_200m"] >= every["alone"]["within_200m"]
    asked = ("strangers", dem, "--store", store, "--strange", dem, "--queries", 1)
    row = run(*asked)["rows"][-1]
    # Nothing is right of a stranger, wherever it is found.
    assert (row["n"], row["within_1km"]) == (1, 0.0)
    assert row["strange"] == ["dem.tif"]


@pytest.mark.parametrize(
    ("command", "arguments", "message"),
    [
        ("matching", ["--queries", "0"], "Invalid value for '--queries'"),
        ("matching", ["--bounds", "40,10,41,11"], "do not meet the DEM"),
        ("matching", ["--spacing", "3400"], "too small for a grid of 3400 m"),
        ("matching", ["--store", "RENDERINGS", "--matcher", "full"], "which none of full searches"),
        ("matching", ["--places", "400", "--matcher", "paper"], "planned-400 holds places"),
        (
            "matching",
            ["--places", "400", "--matcher", "paper", "--matcher", "full"],
            "matcher paper searches renderings, and no store holds them",
        ),
        ("placing", ["--threshold-px", "3", "--places", "400"], "lpov-3px holds renderings"),
        ("matching", ["--places", "400", "--area", "900"], "not less than the"),
        ("matching", ["--spacing", "600", "--matcher", "paper", "--area", "1"], "store of places"),
        (
            "same-place",
            ["--places", "400", "--area", "1"],
            "together, with a stranger are searched",
        ),
        ("matching", ["--places", "400", "--strange", "DEM"], "--strange is of --kind strangers"),
        ("matching", ["--matcher", "best"], "matcher is 'best'"),
        ("uniform-adaptive", ["--spacing", "600", "--threshold-px", "0"], "threshold is 0"),
        ("placing", ["--json", "/none/record.json"], "no folder"),
    ],
)
def test_bad_options_are_one_line_and_write_nothing(
    run_bench, dem, renderings, tmp_path, command, arguments, message
):
    given = [{"DEM": dem, "RENDERINGS": renderings}.get(word, word) for word in arguments]
    assert_refused(run_bench(command, dem, "--folder", tmp_path / "kept", *given), message)
    assert not list(tmp_path.iterdir())


SKYLINE = PhotoSkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)


def query_at(easting_m, heading_deg=0.0):
    truth = Truth(easting_m, 0.0, 1000.0, heading_deg, 0.0, 0.0, 60.0)
    return SyntheticQuery(SKYLINE, 60.0, 0.03, truth, SKYLINE.row_px, 4000.0, ())


def found(*places, within_m=None):
    return MatchResult(SKYLINE, places, 0.5, None if within_m else "unsure", within_m)


BEST = candidate_at(0.0, 0.0, 5.0, confidence=0.8, covariance_m2=((1.0, 0.0), (0.0, 2.0)))
FAR = candidate_at(900.0, 0.0)


def test_a_trial_is_of_the_best_candidate():
    right = trial_of((query_at(30.0, 355.0),), found(BEST, FAR, within_m=200.0))
    assert (right.error_m, right.distance_m, right.within_m) == (30.0, 4000.0, 200.0)
    assert right.heading_error_deg == pytest.approx(10.0)
    assert right.radius_m == BEST.radius_m
    assert trial_of((query_at(30.0),), found(FAR, BEST)).within_m is None
    for nothing in (None, found()):
        lost = trial_of((query_at(0.0),), nothing)
        assert (lost.error_m, lost.within_m) == (np.inf, None)
    assert trial_of((query_at(0.0),), found(BEST, within_m=200.0), strange=True).error_m == np.inf


def test_kinds_of_one_place_share_their_photos():
    terrain = field_of(fractal(120, 120, 600.0, seed=4))
    alone, together, mixed = (
        make_kind(name, terrain, map_bounds(terrain, None), 2, 1)
        for name in ("alone", "together", "with a stranger")
    )
    assert [len(some) for some in (alone, together, mixed)] == [6, 2, 2]
    assert len({photo.truth.easting_m for photo in together[0]}) == 1
    assert len({photo.truth.grid_heading_deg for photo in together[0]}) == 3
    assert [photo.truth for photo in mixed[0][:2]] == [one[0].truth for one in alone[:2]]
    assert mixed[0][2].truth == together[1][2].truth
    with pytest.raises(InputError, match="give --strange"):
        make_kind("strangers", terrain, terrain.bounds_m, 1, 0)


@pytest.mark.usefixtures("refined_quickly")
def test_a_search_loses_a_query_where_nothing_near_its_truth_is_kept(dem, store):
    terrain = read_dem([dem])
    ((query,),) = make_kind("plain", terrain, middle_of(terrain.bounds_m, (1e3, 1e3)), 1, seed=2)
    truth = query.truth
    lon, lat = map(float, terrain.frame.to_lonlat(truth.easting_m, truth.northing_m))
    behind_deg = (truth.grid_heading_deg + 180.0) % 360.0
    with open_matcher("full", store, terrain) as matcher:
        lost_in = partial(stage_of_loss, matcher, store, query)
        assert lost_in() == "ranking", "all stages before keep it"
        # 0.02 degrees of latitude are 2.2 km.
        assert lost_in(Narrowing(near=(lon, lat - 0.02, 0.5))) == "coarse screen"
        # The skyline behind the camera is another one.
        assert lost_in(Narrowing(heading_deg=(behind_deg, 20.0))) == "turns"


TRIALS = [
    Trial(100.0, 30.0, 10.0, 0.9, 40.0, 200.0),
    Trial(200.0, 900.0, 5.0, 0.9, 40.0, 1000.0),
    Trial(300.0, 800.0, 5.0, 0.5, 40.0, 200.0),
    Trial(400.0),
]


def test_a_summary_counts_every_query():
    row = summarize(TRIALS, 5000.0, seed=0)
    assert (row["n"], row["within_200m"], row["within_1km"]) == (4, 0.25, 0.75)
    assert (row["answered"], row["answered_200m"]) == (0.75, 0.5)
    assert row["precision"] == pytest.approx(2 / 3)
    assert row["mean_m"] == pytest.approx(np.mean([30.0, 900.0, 800.0, 5000.0]))
    assert row["median_m"] == 850.0
    assert (row["heading_median_deg"], row["radius_holds"]) == (10.0, 1.0)
    # Wilson's interval of one in four.
    assert row["within_200m_low"] == pytest.approx(0.0456, abs=5e-5)
    assert row["within_200m_high"] == pytest.approx(0.6994, abs=5e-5)
    nothing = summarize(TRIALS[3:], 150.0, seed=0)
    assert (nothing["within_200m"], nothing["mean_m"]) == (0.0, 150.0)
    assert (nothing["precision"], nothing["heading_median_deg"]) == (None, None)


def test_a_summary_counts_lost_queries_by_their_stages_in_the_stages_order():
    lost = ("short list", "fine screen", None, "short list")
    row = summarize([Trial(100.0, truth_ahead=4.0, lost_in=one) for one in lost], 5000.0, seed=0)
    assert list(row["lost_in"].items()) == [("fine screen", 1), ("short list", 2)]
    assert shown(row["lost_in"]) == "1 fine screen, 2 short list"
    assert summarize(TRIALS, 5000.0, seed=0)["lost_in"] == {}


def test_posteriors_are_held_to_the_true_places():
    shares = (0.3, 0.7, 0.9, 0.99, None)
    some = [Trial(100.0, share=share, gain_bits=share and 10.0 * share) for share in shares]
    row = summarize(some, 5000.0, seed=0)
    assert (row["n"], row["posteriors"]) == (5, 4)
    assert (row["in_50"], row["in_80"], row["in_95"]) == (0.25, 0.5, 0.75)
    assert row["gain_bits"] == pytest.approx(7.225)
    assert "in_50" not in summarize(TRIALS, 5000.0, seed=0)


@pytest.mark.slow
@pytest.mark.usefixtures("refined_quickly")
def test_a_probability_is_measured(run, dem, store):
    asked = ("probability", dem, "--store", store, "--kind", "plain", "--queries", 2)
    row = run(*asked)["rows"][-1]
    assert row["posteriors"] == 2
    assert 0.0 <= row["in_50"] <= row["in_80"] <= row["in_95"] <= 1.0
    assert row["gain_bits"] > 0.0


def test_a_plan_is_held_to_the_grid_of_as_many_places():
    about = {"group": "all", "matcher": "full", "queries": "plain", "search": "all"}
    alike = {**about, "km2": 50.0, "n": 4}
    grids = [
        {**alike, "store": f"grid {number}", "planner": "uniform", "renderings": number}
        for number in (50, 108, 400)
    ]
    found = {"each_within_200m": "1100", "mean_m": 30.0}
    plan = {**alike, "store": "plan", "planner": "planned", "renderings": 100, **found}
    assert as_large(plan, grids) == grids[1]
    assert as_large({**plan, "renderings": 200}, grids) is None
    assert as_large({**plan, "queries": "bent"}, grids) is None
    grids[1].update(each_within_200m="1000", mean_m=40.0)
    (held,) = against_equal([*grids, plan])
    assert (held["store"], held["uniform"], held["gain_points"]) == ("plan", "grid 108", 25.0)
    assert held["error_ratio"] == 0.75


def test_only_queries_that_one_store_finds_alone_tell_two_stores_apart():
    plan = {"each_within_200m": "11110000"}
    grid = {"each_within_200m": "11100000"}
    # One of eight: the deviation of 0, ..., 0, 1 is the root of 7 over 8.
    gain, half = gain_points(plan, grid)
    assert gain == 12.5
    assert half == pytest.approx(196.0 * 7.0**0.5 / 8.0 / 8.0**0.5)
    assert gain_points(plan, plan) == (0.0, 0.0)

"""``skyline-bench matching`` as a user meets it."""

import json

import cv2
import pytest
from commands import assert_refused

from skyline import build_uniform, read_dem

KEYS = {
    "store", "matcher", "queries", "n", "within_200m", "mean_m", "median_m", "p90_m",
    "heading_median_deg", "answered", "query_ms", "places", "bytes", "build_s",
    "build_cpu_s",
}  # fmt: skip
TIMES = ("query_ms", "build_s", "build_cpu_s")


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """A folder in which stores are kept."""
    return tmp_path_factory.mktemp("stores")


@pytest.fixture(scope="module")
def renderings(dem, tmp_path_factory):
    """A store of renderings over the DEM."""
    path = tmp_path_factory.mktemp("given") / "renderings.h5"
    build_uniform(read_dem([dem]), path, 600.0)
    return path


@pytest.fixture
def measure(run_bench, dem, stores, tmp_path):
    """Return a function that runs the command and gives its record and what it printed."""

    def run(*arguments):
        record = tmp_path / "record.json"
        done = run_bench(
            "matching", dem, "--spacing", 600, "--spacing", 300, "--folder", stores,
            "--place-spacing", 300, "--matcher", "correlation", "--matcher", "retrieved",
            "--queries", 5, "--json", record, *arguments,
        )  # fmt: skip
        assert done.code == 0, done.err
        return json.loads(record.read_text()), done.out

    return run


def test_stores_matchers_and_queries_are_compared(measure, tmp_path):
    plot = tmp_path / "plot.png"
    record, printed = measure("--plot", plot)
    assert record["bench"] == "matching"
    rows = record["rows"]
    assert [(row["store"], row["matcher"], row["queries"]) for row in rows] == [
        (store, matcher, kind)
        for store, matcher in (
            ("uniform-600", "correlation"),
            ("uniform-300", "correlation"),
            ("places-300", "retrieved"),
        )
        for kind in ("plain", "white", "other-dem", "occluded", "aligned")
    ]
    for row in rows:
        assert row.keys() >= KEYS
        assert row["n"] == 5
        assert 0.0 <= row["within_200m_low"] <= row["within_200m"] <= row["within_200m_high"] <= 1.0
        assert row["median_m"] <= row["p90_m"] < 5000.0
        assert row["build_s"] > 0.0
        assert row["store"] in printed
    assert rows[0]["places"] < rows[5]["places"] == rows[10]["places"]
    assert rows[0]["bytes"] < rows[5]["bytes"]
    assert cv2.imread(str(plot)) is not None


def test_the_same_seed_gives_the_same_table(measure):
    first, again, other = (
        measure("--kind", "plain", "--seed", seed)[0]["rows"] for seed in (7, 7, 8)
    )
    for rows in (first, again, other):
        for row in rows:
            # A store that is found again took what it took.
            assert min(row["build_s"], row["build_cpu_s"]) > 0.0
            for time in TIMES:
                del row[time]
    assert first == again != other


def test_stores_that_are_there_are_measured(run_bench, dem, renderings, tmp_path):
    record = tmp_path / "record.json"
    done = run_bench(
        "matching", dem, "--store", renderings, "--queries", 3, "--kind", "plain", "--json", record,
    )  # fmt: skip
    assert done.code == 0, done.err
    rows = json.loads(record.read_text())["rows"]
    assert {row["store"] for row in rows} == {"renderings"}
    # Ours searches places, which it does not hold.
    assert {row["matcher"] for row in rows} == {"paper", "correlation"}
    assert all(row["build_s"] is None for row in rows)


def test_bad_options_are_one_line_and_write_nothing(run_bench, dem, renderings, tmp_path):
    record = tmp_path / "record.json"
    for arguments, message in [
        (["--queries", "0"], "queries is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--bounds", "40,10,41,11"], "do not meet the DEM"),
        (["--bounds", "40,10,41"], "W,S,E,N"),
        (["--spacing", "3400"], "too small for a grid"),
        (["--spacing", "0"], "spacing is 0"),
        (["--store", renderings, "--matcher", "full"], "holds renderings, which none of full"),
        (["--matcher", "best"], "matcher is 'best'"),
        (["--kind", "easy"], "kind of queries is 'easy'"),
        (["--store", tmp_path / "no.h5"], "does not exist"),
        (["--store", dem], "dem.tif"),
    ]:
        assert_refused(run_bench("matching", dem, "--quick", "--json", record, *arguments), message)
    assert not list(tmp_path.iterdir())

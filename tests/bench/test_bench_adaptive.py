"""``skyline-bench uniform-adaptive`` as a user meets it."""

import json

import cv2
import numpy as np
import pytest
from commands import assert_refused

pytestmark = pytest.mark.usefixtures("refined_once")

KEYS = {
    "store", "matcher", "group", "renderings", "mean_m", "median_m", "p90_m", "within_200m",
    "build_s", "bytes", "query_ms", "mean_m_low", "mean_m_high", "within_200m_low",
    "within_200m_high", "median_m_low", "median_m_high", "group_from_m", "group_to_m", "n",
}  # fmt: skip
TIMES = ("query_ms", "build_s", "build_cpu_s")
COARSE = (
    "--spacing", 600, "--strategy", "lpov", "--threshold-px", 40, "--candidate-spacing", 250,
    "--queries", 3, "--workers", 1,
)  # fmt: skip


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A folder in which stores and trials are kept."""
    return tmp_path_factory.mktemp("kept")


@pytest.fixture
def compare(run_bench, dem, tmp_path):
    """Return a function that runs the command and gives its record and what it printed."""

    def run(*arguments):
        record = tmp_path / "record.json"
        done = run_bench("uniform-adaptive", dem, *COARSE, "--json", record, *arguments)
        assert done.code == 0, done.err
        return json.loads(record.read_text()), done.out

    return run


def without_times(record):
    return [
        {key: value for key, value in row.items() if key not in TIMES} for row in record["rows"]
    ]


def pixels(data):
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR).astype(int)


@pytest.fixture(scope="module")
def made(kept):
    """What the first run made, for the tests after it."""
    return {}


@pytest.mark.slow
def test_stores_matchers_and_groups_are_compared(compare, kept, made, tmp_path):
    plot = tmp_path / "plot.png"
    matchers = ("paper", "retrieved", "full")
    record, printed = compare(
        "--folder", kept, "--plot", plot,
        *(word for name in matchers for word in ("--matcher", name)),
    )  # fmt: skip
    made["rows"] = without_times(record)
    assert record["bench"] == "uniform-adaptive"
    rows = record["rows"]
    assert [(row["store"], row["matcher"], row["group"]) for row in rows] == [
        (store, matcher, group)
        for store, matcher in (
            ("uniform-600", "paper"),
            ("places-600", "retrieved"),
            ("places-600", "full"),
            ("lpov-40px", "paper"),
            ("lpov-40px", "retrieved"),
            ("lpov-40px", "full"),
        )
        for group in ("close", "medium", "far", "all")
    ]
    for row in rows:
        assert row.keys() >= KEYS
        assert row["mean_m_low"] <= row["mean_m"] <= row["mean_m_high"] < 5000.0
        assert row["group_from_m"] <= row["group_to_m"]
        assert row["build_s"] > 0.0
        assert row["store"] in printed
        assert (
            row["planner"] == "uniform" or row["matcher"] == "paper" or row["renderings"] % 4 == 0
        )
    # No query is dropped, and the groups make up the whole.
    for begin in range(0, len(rows), 4):
        *parts, every = rows[begin : begin + 4]
        assert every["n"] == sum(row["n"] for row in parts) == 3
        mean_m = sum(row["n"] * row["mean_m"] for row in parts) / 3.0
        assert every["mean_m"] == pytest.approx(mean_m)
    assert {one["planner"] for one in record["summary"]["as_accurate"]} == {"lpov"}
    assert len(record["summary"]["as_many_renderings"]) == len(matchers)
    assert "median over its columns" in printed
    assert pixels(plot.read_bytes()).std() > 20.0


@pytest.mark.slow
def test_what_is_there_is_not_done_again(compare, kept, made):
    assert made
    trials = sorted((kept / "trials").iterdir())
    before = {path: path.stat().st_mtime_ns for path in trials}
    stores = {path: path.read_bytes() for path in kept.glob("*.h5")}
    matchers = ("--matcher", "paper", "--matcher", "full")
    record, _ = compare("--folder", kept, *matchers)
    asked = [row for row in made["rows"] if row["matcher"] in ("paper", "full")]
    assert without_times(record) == asked
    assert {path: path.stat().st_mtime_ns for path in trials} == before
    assert {path: path.read_bytes() for path in kept.glob("*.h5")} == stores
    # One was cut short, one is gone: what is missing is measured again, and comes out the same.
    cut, gone = (
        next((kept / "trials").glob(f"{store}.paper.plain-*"))
        for store in ("lpov-40px", "uniform-600")
    )
    cut.write_text(cut.read_text()[:-20])
    gone.unlink()
    record, _ = compare("--folder", kept, *matchers)
    assert without_times(record) == asked
    assert {path for path in trials if path.stat().st_mtime_ns != before[path]} == {cut, gone}
    assert len(cut.read_text().splitlines()) == 4
    assert len(gone.read_text().splitlines()) == 3


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table(compare, made):
    first, again = (
        without_times(compare("--matcher", "retrieved", "--workers", workers, "--seed", 7)[0])
        for workers in (2, 1)
    )
    assert first == again
    assert first != [row for row in made["rows"] if row["matcher"] == "retrieved"]


def test_bad_options_are_one_line_and_write_nothing(run_bench, dem, tmp_path):
    record = tmp_path / "record.json"
    for arguments, message in [
        (["--queries", "0"], "queries is 0"),
        (["--seed", "-1"], "seed is -1"),
        (["--workers", "0"], "workers is 0"),
        (["--bounds", "40,10,41,11"], "do not meet the DEM"),
        (["--bounds", "40,10,41"], "W,S,E,N"),
        (["--bounds", "10.32,46.75,10.325,46.755"], "too small for a grid of 1024 m"),
        (["--strategy", "best"], "strategy is 'best'"),
        (["--matcher", "best"], "matcher is 'best'"),
        (["--spacing", "600", "--threshold-px", "0"], "threshold is 0"),
        (["--spacing", "0"], "spacing is 0"),
        (["--json", tmp_path / "no" / "record.json"], "no folder"),
        (["--plot", tmp_path / "plot.doc"], ".doc"),
    ]:
        assert_refused(
            run_bench(
                "uniform-adaptive", dem, "--json", record, "--folder", tmp_path / "kept", *arguments
            ),
            message,
        )
    assert not list(tmp_path.iterdir())

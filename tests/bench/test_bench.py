"""``skyline-bench`` as a user meets it."""

import json

import cv2
import pytest
from commands import assert_refused

from skyline_bench.truth import stability
from skyline_bench.commands import skylines
from skyline_bench.peers.embree import is_installed
from skyline_bench.runs import speed_error

KEYS = {"path", "width", "tolerance_px", "ms_per_viewpoint", "rms_px", "max_px"}


@pytest.fixture
def measured(run_bench, dem, tmp_path):
    """Return what ``speed-error`` printed and wrote."""
    record, plot = tmp_path / "record.json", tmp_path / "plot.png"
    done = run_bench(
        "speed-error", dem, "--quick", "--viewpoints", 6, "--width", 64, "--seed", 3,
        "--json", record, "--plot", plot,
    )  # fmt: skip
    assert done.code == 0, done.err
    return done, json.loads(record.read_text()), plot


def test_version_and_help(run_bench):
    assert run_bench("--version").out.startswith("skyline 0.")
    assert "speed-error" in run_bench("--help").out
    assert "--quick" in run_bench("speed-error", "--help").out


def test_speed_error_measures_every_path(measured):
    done, record, plot = measured
    assert record["bench"] == "speed-error"
    assert record["machine"]["renderer"]
    rows = record["rows"]
    assert all(row.keys() >= KEYS for row in rows)
    paths = {row["path"] for row in rows}
    assert paths >= {"depth", "horizon", "oracle"}
    assert ("embree" in paths) == is_installed()
    for row in rows:
        assert row["path"] in done.out
        assert row["missing"] == 0
        compared = 2 if row["path"] in {"depth", "oracle"} else 4
        assert row["compared_viewpoints"] == compared
        assert row["columns"] > 0.3 * compared * 4 * row["width"]
        assert 0.0 < row["viewpoints_per_s"] == pytest.approx(1000.0 / row["ms_per_viewpoint"])
    assert cv2.imread(str(plot)) is not None


def test_speed_error_finds_the_errors_there_are(measured):
    _, record, _ = measured
    for row in record["rows"]:
        if row["path"] == "oracle":
            assert (row["rms_px"], row["max_px"]) == (0.0, 0.0)
        elif row["path"] == "depth":
            # Half a pixel of its own width, in px of W = 640.
            assert 0.2 < row["max_px"] * row["width"] / 640.0 < 0.51
        elif row["path"] == "horizon":
            assert row["rms_px"] <= row["max_px"] <= row["tolerance_px"] + 0.01
        elif row["path"] == "embree":
            assert row["rms_px"] < row["max_px"] < 320.0 / 2.0 ** row["bisections"] + 0.01


def test_without_embree_the_rest_is_measured(run_bench, dem, tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(speed_error, "is_installed", lambda: False)
    record = tmp_path / "record.json"
    done = run_bench(
        "speed-error", dem, "--quick", "--viewpoints", 2, "--width", 16, "--json", record
    )
    assert done.code == 0, done.err
    assert "skyline-bench[peers]" in caplog.text
    rows = json.loads(record.read_text())["rows"]
    assert {row["path"] for row in rows} == {"depth", "horizon", "oracle"}


@pytest.fixture
def three_cases(monkeypatch):
    """Only three hard cases, since all of them are tested one by one elsewhere."""
    cases = stability.HARD_CASES[:3]
    monkeypatch.setattr(stability, "HARD_CASES", cases)
    return cases


def test_stability_says_what_holds(run_bench, three_cases, tmp_path):
    record, plot = tmp_path / "record.json", tmp_path / "plot.png"
    done = run_bench("stability", "--quick", "--json", record, "--plot", plot)
    assert done.code == 0, done.err
    written = json.loads(record.read_text())
    assert written["bench"] == "stability"
    assert {row["case"] for row in written["rows"]} == {case.name for case in three_cases}
    assert {row["path"] for row in written["rows"]} == {"horizon", "depth"}
    for row in written["rows"]:
        assert row["case"] in done.out
        assert row["ok"]
        assert 0.0 <= row["error_px"] <= row["bound_px"]
    assert cv2.imread(str(plot)) is not None


def test_a_case_that_fails_ends_in_exit_code_1(run_bench, three_cases, tmp_path, monkeypatch):
    measured = stability.measure

    def spoiled(*arguments):
        rows = measured(*arguments)
        return [{**row, "ok": row["path"] == "depth", "error_px": float("inf")} for row in rows]

    monkeypatch.setattr(stability, "measure", spoiled)
    record, plot = tmp_path / "record.json", tmp_path / "plot.png"
    done = run_bench("stability", "--quick", "--json", record, "--plot", plot)
    assert done.code == 1
    assert done.err.startswith("error: 3 of ")
    assert f"{three_cases[0].name} (horizon)" in done.err
    assert done.err.count("\n") == 1
    assert "FAILS" in done.out
    assert all(row["error_px"] is None for row in json.loads(record.read_text())["rows"])
    assert cv2.imread(str(plot)) is not None


def test_bad_options_are_one_line_and_write_nothing(run_bench, dem, tmp_path):
    record = tmp_path / "record.json"
    for arguments, message in [
        ([tmp_path / "none.tif"], "none.tif"),
        ([dem, "--viewpoints", "0"], "viewpoints is 0"),
        ([dem, "--width", "0"], "width is 0"),
        ([dem, "--seed", "-1"], "seed is -1"),
        ([dem, "--plot", tmp_path / "plot.doc"], ".doc"),
        ([dem, "--plot", tmp_path / "no" / "plot.png"], "no folder"),
        ([dem, "--json", tmp_path / "no" / "record.json"], "no folder"),
        ([], "DEM"),
    ]:
        assert_refused(run_bench("speed-error", "--quick", "--json", record, *arguments), message)
    assert not list(tmp_path.iterdir())


def test_ctrl_c_ends_in_one_line(run_bench, dem, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(skylines, "measure", interrupted)
    done = run_bench("speed-error", dem, "--quick")
    assert done.code == 130
    assert done.err == "error: stopped\n"


@pytest.mark.slow
def test_table1_compares_the_strategies(run_bench, tmp_path):
    done = run_bench("table1", "--seeds", 1, "--json", tmp_path / "record.json")
    assert done.code == 0, done.err
    rows = json.loads((tmp_path / "record.json").read_text())["rows"]
    keys = {"row", "strategy", "A", "B", "mean_area", "seconds"}
    assert len(rows) == 15
    assert all(row.keys() >= keys for row in rows)
    assert run_bench("table1", "--seeds", 0).code == 2

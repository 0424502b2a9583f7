"""Speed against error: fair times, errors in one unit, and what the commands write."""

import dataclasses

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline import stand_on
from skyline.skylines import FLAG_HOLE
from skyline_bench import peers
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import compare


@pytest.fixture(scope="module")
def measured(recorded, dem):
    """The record of a quick run, and what it printed."""
    return recorded("speed-error", dem, "--quick", "--seed", 3)


@pytest.fixture(scope="module")
def rows(measured):
    record, _ = measured
    return record["rows"]


def test_speed_error_measures_the_paths_there_are(measured):
    record, printed = measured
    assert record["bench"] == "speed-error"
    assert record["machine"]["renderer"]
    paths = {row["path"] for row in record["rows"]}
    assert paths >= {"depth", "horizon", "all round", "oracle"}
    assert ("embree" in paths, "grass" in paths) == (peers.has_embree(), peers.has_grass())
    assert all(path in printed for path in paths)


def test_speed_error_counts_the_columns_and_the_viewpoints_a_second(rows):
    for row in rows:
        assert 0.0 < row["viewpoints_per_s"] == pytest.approx(1000.0 / row["ms_per_viewpoint"])
        assert row["missing"] == 0
        if row["path"] in ("all round", "grass"):
            assert row["columns"] == row["compared_viewpoints"] * row["width"]
        else:
            assert row["columns"] > 0.3 * row["compared_viewpoints"] * 4 * row["width"]


def test_speed_error_finds_the_errors_there_are(rows):
    for row in rows:
        if row["path"] == "oracle":
            assert (row["rms_px"], row["max_px"]) == (0.0, 0.0)
        elif row["path"] == "depth":
            # Half a pixel of its own width, in px of W = 640.
            assert 0.2 < row["max_px"] * row["width"] / 640.0 < 0.51
        elif row["path"] in ("horizon", "all round"):
            assert row["rms_px"] <= row["max_px"] < 0.01
        elif row["path"] == "grass":
            assert row["max_px"] > 0.1
        elif row["path"] == "embree":
            assert row["rms_px"] < row["max_px"] < 320.0 / 2.0 ** row["bisections"] + 0.01


@pytest.fixture(scope="module")
def truth():
    terrain = field_of(fractal(60, 60, 300.0, seed=4))
    views = oracle.skyline(terrain, stand_on(terrain, easting_m=[900.0], northing_m=[-900.0]), 16)
    return dataclasses.replace(views, flags=np.zeros_like(views.flags))


def test_errors_are_in_pixels_of_width_640_whatever_the_width(truth):
    same = compare(truth, truth)
    assert (same["rms_px"], same["max_px"], same["columns"], same["missing"]) == (0.0, 0.0, 64, 0)
    v = truth.v.copy()
    v[2, 5] -= 3.0 / 320.0
    found = compare(dataclasses.replace(truth, v=v), truth)
    assert found["max_px"] == pytest.approx(3.0)
    assert found["rms_px"] == pytest.approx(3.0 / np.sqrt(64))


def test_a_column_without_a_value_is_missing_and_cannot_hide_behind_a_flag(truth):
    v = truth.v.copy()
    flags = truth.flags.copy()
    v[0, :3] = np.nan
    flags[0, 0] = FLAG_HOLE
    found = compare(dataclasses.replace(truth, v=v, flags=flags), truth)
    assert (found["missing"], found["max_px"], found["columns"]) == (3, 0.0, 61)

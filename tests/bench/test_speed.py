"""Speed against error: fair times, errors in one unit, and what the commands write."""

import dataclasses
import json

import numpy as np
import pytest
from scenes import FRAME, at_m, field_of, fractal

from skyline import Curvature, HeightField, horizon, stand_on
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED
from skyline_bench.peers import embree, grass
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import compare

needs_grass = pytest.mark.skipif(not grass.is_installed(), reason="grass is not installed")


@pytest.fixture
def measured(run_bench, dem, tmp_path):
    """Return what ``speed-error`` printed and wrote."""
    record = tmp_path / "record.json"
    done = run_bench("speed-error", dem, "--quick", "--seed", 3, "--json", record)
    assert done.code == 0, done.err
    return done.out, json.loads(record.read_text())


def test_speed_error_finds_the_errors_there_are(measured):
    printed, record = measured
    assert record["bench"] == "speed-error"
    assert record["machine"]["renderer"]
    paths = {row["path"] for row in record["rows"]}
    assert paths >= {"depth", "horizon", "all round", "oracle"}
    assert ("embree" in paths, "grass" in paths) == (embree.is_installed(), grass.is_installed())
    for row in record["rows"]:
        assert row["path"] in printed
        assert 0.0 < row["viewpoints_per_s"] == pytest.approx(1000.0 / row["ms_per_viewpoint"])
        assert row["missing"] == 0
        if row["path"] in ("all round", "grass"):
            assert row["columns"] == row["compared_viewpoints"] * row["width"]
        else:
            assert row["columns"] > 0.3 * row["compared_viewpoints"] * 4 * row["width"]
        if row["path"] == "oracle":
            assert (row["rms_px"], row["max_px"]) == (0.0, 0.0)
        elif row["path"] == "depth":
            # Half a pixel of its own width, in px of W = 640.
            assert 0.2 < row["max_px"] * row["width"] / 640.0 < 0.51
        elif row["path"] == "horizon":
            assert row["rms_px"] <= row["max_px"] <= row["tolerance_px"] + 0.01
        elif row["path"] == "all round":
            tolerance_px = float(row["setting"].split()[2]) / 0.179
            assert row["rms_px"] <= row["max_px"] <= 1.001 * tolerance_px + 0.01
        elif row["path"] == "grass":
            assert row["max_px"] > 0.1
        elif row["path"] == "embree":
            assert row["rms_px"] < row["max_px"] < 320.0 / 2.0 ** row["bisections"] + 0.01


# --- GRASS ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def field():
    heights = 1500.0 + fractal(160, 150, 700.0, seed=2)
    return HeightField(heights.astype(np.float32), 0.0, 0.0, 30.0, 30.0, FRAME)


@needs_grass
def test_grass_answers_by_azimuth_from_true_north(field):
    eyes = stand_on(field, **at_m(field.to_map([80.0, 60.0], [70.0, 90.0])), eye_height_m=0.0)
    angles, seconds = grass.horizons(field, eyes, 2.0)
    assert angles.shape == (2, 180)
    assert seconds.shape == (1,)
    lon, lat = field.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    flat = Curvature(enabled=False)
    seen = horizon(field, lon=lon, lat=lat, eye_height_m=0.0, step_deg=2.0, curvature=flat)
    found = np.maximum(seen.elevation_deg, 0.0)
    off = [np.abs(np.roll(angles, turn, axis=1) - found).mean() for turn in range(180)]
    assert min(off[0], off[1], off[-1]) == min(off)


# --- errors against the oracle: which columns count, and in which unit ----------------------


@pytest.fixture(scope="module")
def truth():
    terrain = field_of(fractal(60, 60, 300.0, seed=4))
    views = oracle.skyline(terrain, stand_on(terrain, easting_m=[900.0], northing_m=[-900.0]), 16)
    return dataclasses.replace(views, flags=np.zeros_like(views.flags))


def test_errors_are_in_pixels_of_width_640_whatever_the_width(truth):
    same = compare(truth, truth)
    assert (same["rms_px"], same["max_px"], same["columns"], same["missing"]) == (0.0, 0.0, 64, 0)
    tan = truth.elevation_tan.copy()
    tan[2, 5] -= 3.0 / 320.0
    found = compare(dataclasses.replace(truth, elevation_tan=tan), truth)
    assert found["max_px"] == pytest.approx(3.0)
    assert found["rms_px"] == pytest.approx(3.0 / np.sqrt(64))


def test_columns_that_either_side_flags_do_not_count(truth):
    tan, here, there = truth.elevation_tan + 1.0, truth.flags.copy(), truth.flags.copy()
    here[:2], there[2:, 4:] = FLAG_HOLE, FLAG_TRUNCATED
    found = compare(
        dataclasses.replace(truth, elevation_tan=tan, flags=here),
        dataclasses.replace(truth, flags=there),
    )
    assert (found["columns"], found["flagged_share"]) == (8, 56 / 64)
    assert found["max_px"] == pytest.approx(320.0)
    nothing = compare(truth, dataclasses.replace(truth, flags=truth.flags + FLAG_HOLE))
    assert (nothing["rms_px"], nothing["max_px"], nothing["columns"]) == (None, None, 0)


def test_a_column_without_a_value_is_missing_and_cannot_hide_behind_a_flag(truth):
    tan, flags = truth.elevation_tan.copy(), truth.flags.copy()
    tan[0, :3] = np.nan
    flags[0, 0] = FLAG_HOLE
    found = compare(dataclasses.replace(truth, elevation_tan=tan, flags=flags), truth)
    assert (found["missing"], found["max_px"], found["columns"]) == (3, 0.0, 61)

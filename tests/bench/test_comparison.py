"""Errors against the oracle: which columns count, and in which unit."""

import dataclasses

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.terrain.viewpoints import stand_on
from skyline.views import FLAG_HOLE, FLAG_TRUNCATED
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import compare


@pytest.fixture(scope="module")
def truth():
    field = field_of(fractal(60, 60, 300.0, seed=4))
    views = oracle.skyline(field, stand_on(field, easting_m=[900.0], northing_m=[-900.0]), 16)
    return dataclasses.replace(views, flags=np.zeros_like(views.flags))


def changed(views, **rows):
    return dataclasses.replace(views, **rows)


def test_equal_views_have_no_error(truth):
    found = compare(truth, truth)
    assert (found["rms_px"], found["max_px"], found["columns"]) == (0.0, 0.0, 64)
    assert (found["flagged_share"], found["missing"]) == (0.0, 0)


def test_errors_are_in_pixels_of_width_640_whatever_the_width(truth):
    tan = truth.elevation_tan.copy()
    tan[2, 5] -= 3.0 / 320.0
    found = compare(changed(truth, elevation_tan=tan), truth)
    assert found["max_px"] == pytest.approx(3.0)
    assert found["rms_px"] == pytest.approx(3.0 / np.sqrt(64))


def test_columns_that_either_side_flags_do_not_count(truth):
    tan, here, there = truth.elevation_tan + 1.0, truth.flags.copy(), truth.flags.copy()
    here[:2], there[2:, 4:] = FLAG_HOLE, FLAG_TRUNCATED
    found = compare(changed(truth, elevation_tan=tan, flags=here), changed(truth, flags=there))
    assert found["columns"] == 8
    assert found["flagged_share"] == 56 / 64
    assert found["max_px"] == pytest.approx(320.0)


def test_a_column_without_a_value_is_missing_and_cannot_hide_behind_a_flag(truth):
    tan, flags = truth.elevation_tan.copy(), truth.flags.copy()
    tan[0, :3] = np.nan
    flags[0, 0] = FLAG_HOLE
    found = compare(changed(truth, elevation_tan=tan, flags=flags), truth)
    assert found["missing"] == 3
    assert found["max_px"] == 0.0
    assert found["columns"] == 61


def test_nothing_to_compare_is_none(truth):
    found = compare(truth, changed(truth, flags=truth.flags + FLAG_HOLE))
    assert (found["rms_px"], found["max_px"], found["columns"]) == (None, None, 0)

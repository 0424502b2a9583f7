"""Predictors held to renderings of rough terrain, in small."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.paper.planning.reprojection import PREDICTORS
from skyline_bench.runs.prediction_quality import (
    QualitySetup,
    prediction_quality,
    quality_pairs,
)

pytestmark = pytest.mark.usefixtures("no_gl_error")

SETUP = QualitySetup(viewpoints=8, displacements=6, margin_m=1500.0, seed=3)


@pytest.fixture(scope="module")
def field():
    return field_of(fractal(180, 180, 1200.0, seed=7), 60.0)


@pytest.fixture(scope="module")
def rows(field):
    return {row["predictor"]: row for row in prediction_quality(field, SETUP)}


def test_a_warp_tells_more_views_alike_than_none(rows):
    assert rows["affine-mean"]["recall"] > rows["non-affine"]["recall"]


def test_rows_hold_shares_and_their_intervals(rows):
    assert rows.keys() == PREDICTORS.keys()
    for row in rows.values():
        for share, (low, high) in (
            (row["precision"], row["precision_interval"]),
            (row["recall"], row["recall_interval"]),
        ):
            assert 0.0 <= low <= share <= high <= 1.0
        assert 0.0 < row["answered"] <= 1.0


def test_pairs_do_not_depend_on_anything_but_the_seed(field):
    first, again = quality_pairs(field, SETUP), quality_pairs(field, SETUP)
    np.testing.assert_array_equal(first.true_px, again.true_px)
    lengths = np.hypot(first.displacements_m[..., 0], first.displacements_m[..., 2])
    assert lengths.max() <= SETUP.reach_m
    # All four headings of an eye are displaced alike, each in its own axes.
    by_eye = lengths.reshape(SETUP.viewpoints, 4, -1)
    np.testing.assert_allclose(by_eye, by_eye[:, :1].repeat(4, axis=1))


def test_a_map_too_small_says_so(field):
    with pytest.raises(InputError, match=r"10\.7 x 10\.7 km; expected more than 12\.6"):
        quality_pairs(field, QualitySetup(margin_m=6000.0))

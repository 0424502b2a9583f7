"""Predictors held to renderings of rough terrain, in small."""

import numpy as np
import pytest
from scenes import field_of, fractal
from skyline.prediction import predict

from skyline.errors import InputError
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.viewpoints import stand_on
from skyline_bench.runs.prediction_quality import (
    QualitySetup,
    prediction_quality,
    quality_pairs,
    shell_edges_m,
)

pytestmark = pytest.mark.usefixtures("no_gl_error")

SETUP = QualitySetup(viewpoints=8, displacements=6, margin_m=1500.0, shells=(16,), seed=3)


@pytest.fixture(scope="module")
def field():
    return field_of(fractal(180, 180, 1200.0, seed=7), 60.0)


@pytest.fixture(scope="module")
def rows(field):
    return {(row.predictor, row.flanks): row for row in prediction_quality(field, SETUP)}


def test_the_better_a_predictor_knows_the_terrain_the_better_it_ranks(rows):
    ranks = [
        rows[key].rank_correlation
        for key in (("affine-mean", False), ("shells", False), ("shells", True))
    ]
    assert ranks[0] + 0.1 < ranks[1] < ranks[2]
    assert rows["shells", True].recall > rows["affine-mean", False].recall + 0.2


def test_rows_hold_shares_and_their_intervals(rows):
    assert len(rows) == 8
    for row in rows.values():
        for share, (low, high) in (
            (row.precision, row.precision_interval),
            (row.recall, row.recall_interval),
        ):
            assert 0.0 <= low <= share <= high <= 1.0
        assert 0.0 < row.answered <= 1.0


def test_pairs_do_not_depend_on_anything_but_the_seed(field):
    first, again = quality_pairs(field, SETUP), quality_pairs(field, SETUP)
    np.testing.assert_array_equal(first.true_px, again.true_px)
    lengths = np.hypot(first.displacements_m[..., 0], first.displacements_m[..., 2])
    assert lengths.max() <= SETUP.reach_m
    # All four headings of an eye are displaced alike, each in its own axes.
    by_eye = lengths.reshape(SETUP.viewpoints, 4, -1)
    np.testing.assert_allclose(by_eye, by_eye[:, :1].repeat(4, axis=1))


def test_predictions_from_rendered_shells_come_near_the_rendering(field):
    here, there = (stand_on(field, 5400.0 + e, -5200.0) for e in (0.0, 90.0))
    with HorizonRenderer(field, 160, shell_edges_m=shell_edges_m(24)) as renderer:
        stored, rendered = renderer.render(here), renderer.render(there)
    targets = stand_on(field, np.full(4, 5490.0), -5200.0)
    predicted = predict(stored, np.arange(4), targets)
    off_px = np.abs(predicted.elevation_tan - rendered.elevation_tan) * 80.0
    still_px = np.abs(stored.elevation_tan - rendered.elevation_tan) * 80.0
    assert np.isfinite(off_px).all()
    assert np.median(off_px) < 0.1 * np.median(still_px)


def test_a_map_too_small_says_so(field):
    with pytest.raises(InputError, match=r"10\.7 x 10\.7 km; expected more than 12\.6"):
        quality_pairs(field, QualitySetup(margin_m=6000.0))

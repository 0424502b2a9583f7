"""How good reprojection errors are on real terrain, held to renderings.

Views are rendered at random viewpoints, and again at random displacements from them. What a
predictor says of a displacement is compared with `true_errors_px`: the stored skyline against the
rendered one after the best affine warp.
"""

import logging
import time
from dataclasses import dataclass

import numpy as np
from scipy.stats import spearmanr

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError
from skyline.paper.planning.reprojection import PREDICTORS, Reprojection, displacements_m
from skyline.paper.planning.truth import true_errors_px
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import Views
from skyline_bench.measuring.record import Row

_log = logging.getLogger(__name__)

_RESAMPLES = 1000
_TIMED = 100


@dataclass(frozen=True, slots=True)
class QualitySetup:
    """What is measured."""

    viewpoints: int = 200  # Random viewpoints; each has four views
    displacements: int = 12  # Other eyes around each, uniform in a disc
    reach_m: float = 300.0  # Radius of the disc
    threshold_px: float = 3.0  # Two skylines are alike within this
    margin_m: float = 3000.0  # Least distance of a viewpoint from the map's border
    seed: int = 41


@dataclass(frozen=True, slots=True, eq=False)
class QualityPairs:
    """N views, M displaced eyes of each, and how far apart the skylines truly are."""

    views: Views  # The four headings of an eye follow one another
    displacements_m: Float64Array  # (N, M, 3)
    true_px: Float32Array  # (N, M)


def quality_pairs(field: HeightField, setup: QualitySetup) -> QualityPairs:
    """Choose eyes and displacements, render both ends and measure the true errors."""
    eyes, others = _choose_eyes(field, setup)
    with HorizonRenderer(field) as renderer:
        stored, rendered = renderer.render(eyes), renderer.render(others)
    count, moves = len(eyes), setup.displacements
    # Rows of `rendered` run over eyes, moves, headings; pairs over eyes, headings, moves.
    order = np.arange(len(rendered)).reshape(count, moves, 4).swapaxes(1, 2).ravel()
    there = rendered[order]
    true_px = true_errors_px(stored[np.repeat(np.arange(len(stored)), moves)], there)
    shape = (len(stored), moves)
    eyes_m = (there.easting_m, there.northing_m, there.eye_elevation_m)
    moved = displacements_m(stored, *(part.reshape(shape) for part in eyes_m))
    return QualityPairs(stored, moved, true_px.reshape(shape))


def prediction_quality(field: HeightField, setup: QualitySetup) -> list[Row]:
    """Measure every predictor on one terrain.

    Return ``precision`` and ``recall`` of "alike within the threshold", with 95 % intervals over
    viewpoints (precision is NaN where nothing was predicted alike); Spearman's
    ``rank_correlation`` of predicted and true errors; ``answered``, the share of displacements the
    predictor had a finite error for; ``ms_per_area``, processor time for a view and 100
    displacements.
    """
    pairs = quality_pairs(field, setup)
    _log.info("alike within the threshold: %.3f", (pairs.true_px <= setup.threshold_px).mean())
    return [_row(name, pairs, setup) for name in PREDICTORS]


def _row(name: str, pairs: QualityPairs, setup: QualitySetup) -> Row:
    errors = PREDICTORS[name].errors_px(pairs.views, pairs.displacements_m)
    claimed, alike = errors <= setup.threshold_px, pairs.true_px <= setup.threshold_px
    right = claimed & alike
    precision, precision_interval = _share(right, claimed, setup.seed)
    recall, recall_interval = _share(right, alike, setup.seed)
    return {
        "predictor": name,
        "precision": precision,
        "precision_interval": precision_interval,
        "recall": recall,
        "recall_interval": recall_interval,
        "rank_correlation": float(spearmanr(errors.ravel(), pairs.true_px.ravel()).statistic),
        "answered": float(np.isfinite(errors).mean()),
        "ms_per_area": _ms_per_area(PREDICTORS[name], pairs),
    }


def _ms_per_area(predictor: Reprojection, pairs: QualityPairs) -> float:
    """Return the processor time of one area of 100 candidates, all of a batch of views."""
    some = slice(0, _TIMED)
    candidates = np.resize(np.arange(pairs.displacements_m.shape[1]), 100)
    moved = pairs.displacements_m[some][:, candidates]
    started = time.process_time()
    predictor.errors_px(pairs.views[some], moved)
    return 1e3 * (time.process_time() - started) / len(moved)


def _choose_eyes(field: HeightField, setup: QualitySetup) -> tuple[Viewpoints, Viewpoints]:
    """Return the viewpoints, and all displaced ones in rows of `setup.displacements`."""
    generator = np.random.default_rng(setup.seed)
    west, south, east, north = field.bounds_m
    margin = setup.margin_m + setup.reach_m
    if not (east - west > 2.0 * margin and north - south > 2.0 * margin):
        raise InputError(
            f"the map is {(east - west) / 1e3:.1f} x {(north - south) / 1e3:.1f} km; expected more "
            f"than {2e-3 * margin:.1f} km either way, or a smaller margin and reach"
        )
    tried = 10 * setup.viewpoints
    easting = generator.uniform(west + margin, east - margin, tried)[:, np.newaxis]
    northing = generator.uniform(south + margin, north - margin, tried)[:, np.newaxis]
    radius = setup.reach_m * np.sqrt(generator.random((tried, setup.displacements)))
    bearing = generator.uniform(0.0, 2.0 * np.pi, radius.shape)
    there = easting + radius * np.sin(bearing), northing + radius * np.cos(bearing)
    on_ground = ~np.isnan(field.height_at(easting_m=there[0], northing_m=there[1])).any(axis=1)
    on_ground &= ~np.isnan(field.height_at(easting_m=easting, northing_m=northing))[:, 0]
    chosen = np.flatnonzero(on_ground)[: setup.viewpoints]
    if len(chosen) < setup.viewpoints:
        raise InputError(
            f"only {len(chosen)} of {tried} random viewpoints have ground all around; the map is "
            "mostly holes: choose another"
        )
    eyes = stand_on(field, easting_m=easting[chosen, 0], northing_m=northing[chosen, 0])
    return eyes, stand_on(
        field, easting_m=there[0][chosen].ravel(), northing_m=there[1][chosen].ravel()
    )


def _share(right: BoolArray, among: BoolArray, seed: int) -> tuple[float, tuple[float, float]]:
    """Return the share of some pairs that are right, and its 95 % interval over viewpoints."""
    eyes = len(right) // 4
    hits, all_ = (np.count_nonzero(part.reshape(eyes, -1), axis=1) for part in (right, among))
    drawn = np.random.default_rng(seed).integers(0, eyes, (_RESAMPLES, eyes))
    shares = hits[drawn].sum(axis=1) / np.maximum(all_[drawn].sum(axis=1), 1)
    low, high = np.quantile(shares, [0.025, 0.975])
    return hits.sum() / all_.sum() if all_.any() else np.nan, (float(low), float(high))

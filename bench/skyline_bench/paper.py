"""The paper's tables: its simulation (Table 1), and its predictors compared with renderings.

The simulation (section 5.1) compares the strategies by (A), the viewpoints rendered, corners
included, and (B), the overlap: all inclusions in tolerance areas less the locations covered. A
strategy needs at least as many viewpoints as there are locations to cover over the mean area of its
views; ``bound`` is that number.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from scipy.stats import spearmanr
from typer import Option

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError
from skyline.paper.reprojection import WARPS, displacements_m, errors_px, skyline_points_m
from skyline.paper.strategies import STRATEGIES
from skyline.paper.verify import true_errors_px
from skyline.render.horizon import HorizonRenderer
from skyline.skylines import Views
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench import options
from skyline_bench.measuring.record import Row
from skyline_bench.truth.simulation import PAPERS_FIGURES, TABLE_1, Run, Simulation, simulate

_log = logging.getLogger(__name__)

_RESAMPLES = 1000


def table1(
    seeds: Annotated[int, Option(min=1, help="How many seeds, from 0 on.")] = 10,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """The paper's Table 1: viewpoints (A) and overlap (B) of each strategy, there and here."""
    rows = measure_table1(min(seeds, 1) if quick else seeds)
    columns = "row strategy paper_A A A_std paper_B B mean_area bound seconds"
    options.report(json_file, "table1", rows, columns)


def measure_table1(seeds: int) -> list[dict[str, Any]]:
    """Run the strategies on the three rows, each with seeds 0, 1, ...

    Return for each row and strategy: ``row``, ``strategy``, the paper's figures ``paper_A`` and
    ``paper_B``, means over seeds of ``A``, ``B``,
    ``mean_area`` (of the views rendered), ``seconds`` (processor time) and ``coverage`` (reached),
    standard deviations ``A_std``, ``B_std``, ``mean_area_std``, ``seconds_std``, and ``bound``,
    ``asked * 10000 / mean_area``.
    """
    rows = []
    for number, row in enumerate(TABLE_1, start=1):
        simulation = Simulation(row)
        for name, strategy in STRATEGIES.items():
            runs = [simulate(simulation, strategy, seed) for seed in range(seeds)]
            measured = _summary(runs)
            bound = row.coverage * simulation.candidates.valid.size / measured["mean_area"]
            papers = dict(
                zip(("paper_A", "paper_B"), PAPERS_FIGURES[number - 1][name], strict=True)
            )
            rows.append({"row": number, "strategy": name, **papers, **measured, "bound": bound})
    return rows


def _summary(runs: Sequence[Run]) -> dict[str, float]:
    figures: dict[str, list[float]] = {
        "A": [len(run.coverage.viewpoints) for run in runs],
        "B": [run.coverage.overlap for run in runs],
        "mean_area": [
            np.count_nonzero(run.coverage.areas) / len(run.coverage.areas) for run in runs
        ],
        "seconds": [run.seconds for run in runs],
    }
    summary = {name: float(np.mean(values)) for name, values in figures.items()}
    summary |= {f"{name}_std": float(np.std(values)) for name, values in figures.items()}
    summary["coverage"] = float(np.mean([run.coverage.fraction() for run in runs]))
    return summary


# --- predictors on real terrain -------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class QualitySetup:
    """The size of the measurement."""

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


def prediction_quality(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    seed: options.Seed = 41,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Reprojection errors compared with renderings: which displaced views look alike."""
    setup = QualitySetup(viewpoints=8 if quick else 200, seed=seed)
    rows = measure_quality(read_dem(dem, DemOptions(crs=crs)), setup)
    columns = "predictor precision recall rank_correlation answered"
    options.report(json_file, "prediction-quality", rows, columns)


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
    moved = displacements_m(stored, stored.heading, *(part.reshape(shape) for part in eyes_m))
    return QualityPairs(stored, moved, true_px.reshape(shape))


def measure_quality(field: HeightField, setup: QualitySetup) -> list[Row]:
    """Measure every predictor on one terrain.

    Return ``precision`` and ``recall`` of "alike within the threshold", with 95 % intervals over
    viewpoints (precision is NaN where nothing was predicted alike); Spearman's
    ``rank_correlation`` of predicted and true errors; ``answered``, the share of displacements the
    predictor had a finite error for.
    """
    pairs = quality_pairs(field, setup)
    _log.info("alike within the threshold: %.3f", (pairs.true_px <= setup.threshold_px).mean())
    return [_row(name, pairs, setup) for name in WARPS]


def _row(name: str, pairs: QualityPairs, setup: QualitySetup) -> Row:
    points = skyline_points_m(pairs.views)
    errors = errors_px(points, pairs.displacements_m, pairs.views.width, WARPS[name])
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
    }


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

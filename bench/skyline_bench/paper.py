"""The paper's tables: its simulation (Table 1), and its predictors compared with renderings.

The simulation (section 5.1) compares the strategies by (A), the viewpoints rendered, corners
included, and (B), the overlap: all inclusions in tolerance areas less the locations covered. The
least number of viewpoints of a strategy, ``bound``, is the number of locations to cover divided by
the mean area of its views.
"""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np
from scipy.stats import spearmanr
from typer import Option

from skyline.arrays import BoolArray
from skyline.errors import InputError
from skyline.paper.reprojection import WARPS, displacements_m, errors_px, skyline_points_m
from skyline.paper.strategies import STRATEGIES
from skyline.paper.verify import true_errors_px
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench import options
from skyline_bench.measuring.record import Row
from skyline_bench.truth.simulation import PAPERS_FIGURES, TABLE_1, Run, Simulation, simulate

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


_DISPLACEMENTS, _REACH_M = 12, 300.0
"""Other eyes around each viewpoint, uniform in a disc of this radius."""
_THRESHOLD_PX = 3.0
"""Two skylines are alike within this."""
_MARGIN_M = 3000.0
"""Least distance of a viewpoint from the map's border."""


def prediction_quality(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    seed: options.Seed = 41,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Reprojection errors compared with renderings: which displaced views look alike."""
    rows = measure_quality(read_dem(dem, DemOptions(crs=crs)), 8 if quick else 200, seed)
    columns = "predictor precision recall rank_correlation answered"
    options.report(json_file, "prediction-quality", rows, columns)


def measure_quality(field: HeightField, viewpoints: int, seed: int) -> list[Row]:
    """Compare every predictor with renderings around random viewpoints.

    Return ``precision`` and ``recall`` of "alike within the threshold", with 95 % intervals over
    viewpoints (precision is NaN where nothing was predicted alike); Spearman's
    ``rank_correlation`` of predicted and true errors; and ``answered``, the share of displacements
    with a finite predicted error.
    """
    eyes, others = _choose_eyes(field, viewpoints, seed)
    with HorizonRenderer(field) as renderer:
        views, rendered = renderer.render(eyes), renderer.render(others)
    shape = len(views), _DISPLACEMENTS
    # Rows of `rendered` run over eyes, moves, headings; pairs over eyes, headings, moves.
    order = np.arange(len(rendered)).reshape(viewpoints, _DISPLACEMENTS, 4).swapaxes(1, 2).ravel()
    there = rendered[order]
    true_px = true_errors_px(views[np.repeat(np.arange(len(views)), _DISPLACEMENTS)], there)
    true_px = true_px.reshape(shape)
    eyes_m = (there.easting_m, there.northing_m, there.eye_elevation_m)
    moved_m = displacements_m(views, views.heading, *(part.reshape(shape) for part in eyes_m))
    points_m, alike = skyline_points_m(views), true_px <= _THRESHOLD_PX
    rows = list[Row]()
    for name, warp in WARPS.items():
        errors = errors_px(points_m, moved_m, views.width, warp)
        claimed = errors <= _THRESHOLD_PX
        precision, precision_interval = _share(claimed & alike, claimed, seed)
        recall, recall_interval = _share(claimed & alike, alike, seed)
        rows.append(
            {
                "predictor": name,
                "precision": precision,
                "precision_interval": precision_interval,
                "recall": recall,
                "recall_interval": recall_interval,
                "rank_correlation": float(spearmanr(errors.ravel(), true_px.ravel()).statistic),
                "answered": float(np.isfinite(errors).mean()),
            }
        )
    return rows


def _choose_eyes(field: HeightField, viewpoints: int, seed: int) -> tuple[Viewpoints, Viewpoints]:
    """Return the viewpoints, and all displaced ones, those of one viewpoint together."""
    generator = np.random.default_rng(seed)
    west, south, east, north = field.bounds_m
    margin = _MARGIN_M + _REACH_M
    if not (east - west > 2.0 * margin and north - south > 2.0 * margin):
        raise InputError(
            f"the map is {(east - west) / 1e3:.1f} x {(north - south) / 1e3:.1f} km; expected more "
            f"than {2e-3 * margin:.1f} km either way: choose a larger DEM"
        )
    tried = 10 * viewpoints
    easting = generator.uniform(west + margin, east - margin, tried)[:, np.newaxis]
    northing = generator.uniform(south + margin, north - margin, tried)[:, np.newaxis]
    radius = _REACH_M * np.sqrt(generator.random((tried, _DISPLACEMENTS)))
    bearing = generator.uniform(0.0, 2.0 * np.pi, radius.shape)
    there = easting + radius * np.sin(bearing), northing + radius * np.cos(bearing)
    on_ground = ~np.isnan(field.height_at(easting_m=there[0], northing_m=there[1])).any(axis=1)
    on_ground &= ~np.isnan(field.height_at(easting_m=easting, northing_m=northing))[:, 0]
    chosen = np.flatnonzero(on_ground)[:viewpoints]
    if len(chosen) < viewpoints:
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

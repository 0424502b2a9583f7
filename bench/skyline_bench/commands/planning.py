"""Planning measured: the paper's simulation, what predictors say, what planned builds take."""

from dataclasses import asdict, replace
from typing import Annotated

import typer

from skyline.console import parse_bounds, progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands.options import (
    Bounds,
    Crs,
    Dems,
    JsonFile,
    PlotFile,
    Quick,
    Seed,
    check_outputs,
    keep_record,
    print_rows,
)
from skyline_bench.figures.table1 import save_table1
from skyline_bench.measuring.record import Row
from skyline_bench.runs import planned_build as planned_builds
from skyline_bench.runs.matching import middle_deg
from skyline_bench.runs.prediction_quality import QualitySetup
from skyline_bench.runs.prediction_quality import prediction_quality as qualities
from skyline_bench.runs.table1 import SEEDS, conclusions, measure


def table1(
    seeds: Annotated[int, typer.Option(help="How many seeds, from 0 on.")] = SEEDS,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    quick: Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of every strategy, its own and ours."""
    check_outputs(json_file, plot)
    rows = measure(seeds, quick)
    columns = {
        "row": "row",
        "strategy": "strategy",
        "A": "(A)",
        "A_std": "+-",
        "B": "(B)",
        "mean_area": "mean area",
        "bound": "bound",
        "seconds": "s",
    }
    print_rows(rows, columns)
    for said, holds in conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    keep_record(json_file, "table1", rows)
    if plot is not None:
        save_table1(plot)


_SETUP = QualitySetup()
_QUALITY = {
    "predictor": "predictor",
    "shells": "shells",
    "flanks": "flanks",
    "precision": "precision",
    "recall": "recall",
    "rank_correlation": "rank",
    "answered": "answered",
    "ms_per_area": "ms an area",
}
_BUILT = {
    "planner": "planner",
    "renderings": "renderings",
    "batches": "batches",
    "mean_area": "mean area",
    "render_cpu_s": "render cpu s",
    "plan_cpu_s": "plan cpu s",
    "build_cpu_s": "build cpu s",
    "predicted": "predicted",
    "verified": "verified",
    "bytes": "bytes",
}
_QUICK_M = 1500.0


def prediction_quality(
    dem: Dems,
    viewpoints: Annotated[int, typer.Option(help="Drawn at random.")] = _SETUP.viewpoints,
    json_file: JsonFile = None,
    seed: Seed = _SETUP.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Predictors against renderings: which displaced views look alike."""
    check_outputs(json_file, None)
    setup = replace(_SETUP, viewpoints=min(viewpoints, 8) if quick else viewpoints, seed=seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = [asdict(row) for row in qualities(terrain, setup)]
    print_rows(rows, _QUALITY)
    keep_record(json_file, "prediction-quality", rows)


def planned_build(
    dem: Dems,
    bounds: Bounds = None,
    coverage: Annotated[float, typer.Option(help="Share of the places to cover.")] = 0.98,
    planner: Annotated[list[str] | None, typer.Option(help="May be repeated [cover lpov].")] = None,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Planned builds: renderings, seconds of rendering and of planning, coverage as verified.

    The plot is the map of the last plan.
    """
    check_outputs(json_file, plot)
    terrain = read_dem(dem, DemOptions(crs=crs))
    asked = parse_bounds(bounds) if bounds is not None else middle_deg(terrain)
    area = middle_deg(terrain, (_QUICK_M, _QUICK_M), asked) if quick else asked
    planners = planner or ["cover", "lpov"]
    rows: list[Row] = []
    with progress_bar("planners") as progress:
        for name in planners:
            progress(len(rows), len(planners))
            rows.append(planned_builds.measure(terrain, name, coverage, area, plot))
            keep_record(json_file, "planned-build", rows)
    print_rows(rows, _BUILT)

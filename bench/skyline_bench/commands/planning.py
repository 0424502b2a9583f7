"""The paper's planners measured: its simulation, and what its reprojection error says."""

from dataclasses import asdict, replace
from typing import Annotated

import typer

from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.table1 import save_table1
from skyline_bench.runs.prediction_quality import QualitySetup
from skyline_bench.runs.prediction_quality import prediction_quality as qualities
from skyline_bench.runs.table1 import SEEDS, conclusions, measure


def table1(
    seeds: Annotated[int, typer.Option(help="How many seeds, from 0 on.")] = SEEDS,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    quick: options.Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of each of its strategies."""
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
    options.print_rows(rows, columns)
    for said, holds in conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    options.keep_record(json_file, "table1", rows)
    if plot is not None:
        save_table1(plot)


_SETUP = QualitySetup()
_QUALITY = {
    "predictor": "predictor",
    "precision": "precision",
    "recall": "recall",
    "rank_correlation": "rank",
    "answered": "answered",
    "ms_per_area": "ms an area",
}


def prediction_quality(
    dem: options.Dems,
    viewpoints: Annotated[int, typer.Option(help="Drawn at random.")] = _SETUP.viewpoints,
    json_file: options.JsonFile = None,
    seed: options.Seed = _SETUP.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Predictors against renderings: which displaced views look alike."""
    setup = replace(_SETUP, viewpoints=min(viewpoints, 8) if quick else viewpoints, seed=seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = [asdict(row) for row in qualities(terrain, setup)]
    options.tell(json_file, "prediction-quality", rows, _QUALITY)

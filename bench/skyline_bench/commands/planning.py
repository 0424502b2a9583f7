"""The paper's planners measured: its simulation, and what its reprojection error says."""

from dataclasses import replace
from typing import Annotated

import typer
from typer import Option

from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.plots import save_table1
from skyline_bench.runs import prediction_quality as qualities
from skyline_bench.runs.table1 import SEEDS, conclusions, measure

_SETUP = qualities.QualitySetup()


def table1(
    seeds: Annotated[int, Option(help="How many seeds, from 0 on.")] = SEEDS,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    quick: options.Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of each of its strategies."""
    rows = measure(min(seeds, 1) if quick else seeds)
    options.print_rows(rows, "row strategy A A_std B mean_area bound seconds")
    for said, holds in conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    options.keep_record(json_file, "table1", rows)
    if plot is not None:
        save_table1(plot)


def prediction_quality(
    dem: options.Dems,
    viewpoints: Annotated[int, Option(help="Drawn at random.")] = _SETUP.viewpoints,
    json_file: options.JsonFile = None,
    seed: options.Seed = _SETUP.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Predictors against renderings: which displaced views look alike."""
    setup = replace(_SETUP, viewpoints=min(viewpoints, 8) if quick else viewpoints, seed=seed)
    rows = qualities.prediction_quality(read_dem(dem, DemOptions(crs=crs)), setup)
    columns = "predictor precision recall rank_correlation answered ms_per_area"
    options.tell(json_file, "prediction-quality", rows, columns)

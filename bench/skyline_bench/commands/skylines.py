"""Skylines measured: speed against error, hard cases, very large DEMs, the page; and planners."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.console import progress_bar
from skyline.errors import SkylineError
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.cases import stability as hard_cases
from skyline_bench.commands import options
from skyline_bench.figures.plots import save_speed_error, save_stability, save_table1
from skyline_bench.measuring.record import Row, machine, write_record
from skyline_bench.runs import horizon as horizon_tools
from skyline_bench.runs import page as pages
from skyline_bench.runs import prediction_quality as qualities
from skyline_bench.runs import speeds
from skyline_bench.runs import summits as summits_kept
from skyline_bench.runs import table1 as simulated
from skyline_bench.runs.speed_error import SpeedErrorConfig, measure
from skyline_bench.truth.agreement import DEPTH, HORIZON

_SPEED_ERROR = SpeedErrorConfig()


def speed_error(
    dem: options.Dems,
    viewpoints: Annotated[
        int, Option(help="Viewpoints of a batch, on a 100 m grid in the DEM's middle.")
    ] = _SPEED_ERROR.viewpoints,
    width: Annotated[int, Option(help="Columns of all but the depth path.")] = _SPEED_ERROR.width,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _SPEED_ERROR.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Every way to a skyline: milliseconds a viewpoint against error from the oracle."""
    config = replace(_SPEED_ERROR, viewpoints=viewpoints, width=width, seed=seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with progress_bar("measuring") as progress:
        rows = measure(terrain, config.quick() if quick else config, progress)
    columns = "path setting viewpoints_per_s ms_per_viewpoint ms_alone rms_px max_px missing"
    options.tell(json_file, "speed-error", rows, columns)
    if plot is not None:
        save_speed_error(rows, machine(), plot)


def stability(
    json_file: options.JsonFile = None, plot: options.PlotFile = None, quick: options.Quick = False
) -> None:
    """Every hard case along every path that promises something there; exit code 1 if one fails."""
    rows: list[Row] = []
    asked = [
        (path, case)
        for path in (HORIZON, DEPTH)
        for case in hard_cases.HARD_CASES
        if path.name in case.paths
    ]
    with progress_bar("cases") as progress:
        for path, case in asked:
            progress(len(rows), len(asked))
            rows += hard_cases.measure(path, quick, [case])
    verdicts = [{**row, "verdict": "holds" if row["ok"] else "FAILS"} for row in rows]
    options.print_rows(verdicts, "case path error_px bound_px verdict")
    write_record(json_file, "stability", rows)
    if plot is not None:
        save_stability(rows, plot)
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")


def place_speed(
    dem: options.Dems,
    eyes: Annotated[int, Option(help="Eyes, on an 80 m grid in the DEM's middle.")] = 2000,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Skylines all the way round against four headings: milliseconds an eye, taken in turns."""
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = speeds.place_speed(terrain, min(eyes, 100) if quick else eyes)
    options.tell(json_file, "place-speed", rows)


def horizon(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    seed: options.Seed = 0,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Horizons of 1,000 places every half degree: Skyline, Embree's rays and GRASS.

    Embree needs embreex (extra peers), GRASS `grass` on the path; what is not there is left out.
    """
    config = horizon_tools.HorizonConfig(seed=seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    rows = horizon_tools.measure(terrain, config.quick() if quick else config)
    options.tell(json_file, "horizon", rows)


def summits(
    dem: options.Dems,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Summits of a DEM's file against those of the surface, how they are seen and what from them.

    A record that is there keeps the rows of other DEMs.
    """
    config = summits_kept.SummitsConfig()
    rows = summits_kept.measure(dem, crs, config.quick() if quick else config)
    columns = """surface spacing_m summits lowest_m highest_m summits_off sights median_sight_m
        p90_sight_m bias_m rms_off_m place_cpu_ms"""
    options.print_rows(rows, columns)
    for name, value in rows[0].items():
        if name.startswith(
            ("summit_below", "prominent", "coarse", "anywhere", *summits_kept.STOOD)
        ):
            typer.echo(f"{name:<24} {value:g}")
    write_record(json_file, "summits", options.rows_but(json_file, "dem", [rows[0]["dem"]]) + rows)


def large_dem(
    samples: Annotated[int, Option(help="Rows and columns of the made-up DEM.")] = 20_000,
    viewpoints: Annotated[int, Option(help="About its middle.")] = 256,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """A DEM of 20,000 x 20,000 samples: seconds of rendering, and memory."""
    if quick:
        samples, viewpoints = min(samples, 4000), min(viewpoints, 32)
    options.tell(json_file, "large-dem", [speeds.large_dem(samples, viewpoints)])


def pipeline_speed(json_file: options.JsonFile = None, quick: options.Quick = False) -> None:
    """Every stage from DEM to match, on a small DEM that is always at hand."""
    with tempfile.TemporaryDirectory() as folder:
        rows = speeds.pipeline_speed(Path(folder), repeats=1 if quick else 3)
    options.tell(json_file, "pipeline-speed", rows)


def page(
    matches: Annotated[int, Option(help="Over which memory is compared.")] = 50,
    json_file: options.JsonFile = None,
    quick: options.Quick = False,
) -> None:
    """The page in a browser: ready, strokes on 12 megapixels, the live skyline, memory."""
    with tempfile.TemporaryDirectory() as folder, progress_bar("page") as bar:
        rows = pages.measure(Path(folder), 3 if quick else matches, 2.0 if quick else 10.0, bar)
    options.tell(json_file, "page", rows)


_SETUP = qualities.QualitySetup()


def table1(
    seeds: Annotated[int, Option(help="How many seeds, from 0 on.")] = simulated.SEEDS,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    quick: options.Quick = False,
) -> None:
    """Repeat the paper's simulation: viewpoints and overlap of each of its strategies."""
    rows = simulated.measure(min(seeds, 1) if quick else seeds)
    options.print_rows(rows, "row strategy A A_std B mean_area bound seconds")
    for said, holds in simulated.conclusions(rows).items():
        typer.echo(f"{'holds' if holds else 'does not hold':<14} {said}")
    write_record(json_file, "table1", rows)
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

"""Rendering measured: its speed against its error, and the hard cases."""

from dataclasses import replace
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.errors import SkylineError
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.cases import stability as hard_cases
from skyline_bench.commands.options import (
    Crs,
    Dems,
    JsonFile,
    PlotFile,
    Quick,
    Seed,
    check_outputs,
    print_rows,
)
from skyline_bench.figures.speed_error import save_speed_error
from skyline_bench.figures.stability import save_stability
from skyline_bench.measuring.record import machine, write_record
from skyline_bench.runs.speed_error import SpeedErrorConfig, measure
from skyline_bench.truth.agreement import DEPTH, HORIZON

_SPEED_ERROR = SpeedErrorConfig()


def speed_error(
    dem: Dems,
    viewpoints: Annotated[
        int, typer.Option(help="Viewpoints of a batch, on a 100 m grid in the DEM's middle.")
    ] = _SPEED_ERROR.viewpoints,
    width: Annotated[
        int, typer.Option(help="Columns of all but the depth path.")
    ] = _SPEED_ERROR.width,
    json_file: JsonFile = None,
    plot: PlotFile = None,
    seed: Seed = _SPEED_ERROR.seed,
    quick: Quick = False,
    crs: Crs = None,
) -> None:
    """Every way to a skyline: milliseconds a viewpoint against error from the oracle."""
    config = replace(_SPEED_ERROR, viewpoints=viewpoints, width=width, seed=seed)
    check_outputs(json_file, plot)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with progress_bar("measuring") as progress:
        rows = measure(terrain, config.quick() if quick else config, progress)
    columns = {
        "path": "path",
        "setting": "setting",
        "viewpoints_per_s": "per s",
        "ms_per_viewpoint": "ms",
        "ms_alone": "alone",
        "rms_px": "rms px",
        "max_px": "max px",
        "missing": "lost",
    }
    print_rows(rows, columns)
    if json_file is not None:
        write_record(json_file, "speed-error", rows)
    if plot is not None:
        save_speed_error(rows, machine(), plot)


def stability(
    json_file: JsonFile = None,
    plot: PlotFile = None,
    seed: Annotated[
        int, typer.Option(help="For uniformity: the cases are fixed, nothing is drawn.")
    ] = 0,
    quick: Quick = False,
) -> None:
    """Every hard case along every path that promises something there; exit code 1 if one fails."""
    check_outputs(json_file, plot)
    rows: list[hard_cases.Row] = []
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
    print_rows(
        [{**row, "verdict": "holds" if row["ok"] else "FAILS"} for row in rows],
        {
            "case": "case",
            "path": "path",
            "error_px": "error px",
            "bound_px": "bound px",
            "verdict": "verdict",
        },
    )
    if json_file is not None:
        write_record(json_file, "stability", rows)
    if plot is not None:
        save_stability(rows, plot)
    failed = [f"{row['case']} ({row['path']})" for row in rows if not row["ok"]]
    if failed:
        raise SkylineError(f"{len(failed)} of {len(rows)} cases fail: {', '.join(failed)}")

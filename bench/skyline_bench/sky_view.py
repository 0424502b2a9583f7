"""Sky view factors of a DEM: time and errors by azimuth step."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from typer import Option

from skyline.cli.terminal import Terminal
from skyline.horizons.grids import GRID_EYE_HEIGHT_M, GRID_STEP_DEG, sky_view_grid
from skyline.horizons.horizon import DEFAULT_STEP_DEG, horizons_of
from skyline.progress import Progress
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions
from skyline.terrain.viewpoints import stand_on
from skyline_bench import options
from skyline_bench.measuring import Row, square_km, timed

_COMPARED = 400
"""Samples whose factors are compared with those of fine horizons."""


def sky_view(
    dem: options.Dems,
    record: options.Record = None,
    side: Annotated[int, Option(min=2, help="Rows and columns in the DEM's middle.")] = 1000,
    step_deg: Annotated[
        options.Floats,
        Option(
            help="Degrees between azimuths; may be repeated.", show_default=f"{GRID_STEP_DEG:g}"
        ),
    ] = None,
    seed: options.Seed = 0,
    quick: Annotated[bool, options.quick_with(side=100)] = False,
    crs: options.Crs = None,
) -> None:
    """A whole DEM's sky view factor: seconds, and errors by azimuth step.

    A square is cut out of the DEM's middle, and taken as the whole DEM. Errors are differences from
    factors of horizons with steps of 0.5 degrees at n of its samples.
    """
    terrain = _middle(read_dem(dem, DemOptions(crs=crs)), side)
    with Terminal().progress("measuring") as progress:
        rows = [_measured(terrain, one, seed, progress) for one in step_deg or [GRID_STEP_DEG]]
    columns = """step_deg samples km2 seconds cpu_seconds us_per_sample compared=n mean_error
        rms_error max_error"""
    options.report(record, rows, columns, terrain=terrain)


def _middle(terrain: HeightField, side: int) -> HeightField:
    """Return a field's middle square, or all of a smaller field."""
    rows, cols = min(side, terrain.rows), min(side, terrain.cols)
    top, left = (terrain.rows - rows) // 2, (terrain.cols - cols) // 2
    west_m, north_m = terrain.to_map(top, left)
    heights_m = terrain.part(slice(top, top + rows), slice(left, left + cols)).copy()
    return replace(terrain, heights_m=heights_m, west_m=float(west_m), north_m=float(north_m))


def _measured(terrain: HeightField, step_deg: float, seed: int, progress: Progress) -> Row:
    grid, timing = timed(lambda: sky_view_grid(terrain, step_deg=step_deg, progress=progress))
    known = np.flatnonzero(np.isfinite(grid.to_numpy()))
    drawn = np.random.default_rng(seed).permutation(known)[:_COMPARED]
    row, col = np.unravel_index(drawn, grid.shape)
    easting_m, northing_m = terrain.to_map(row, col)
    eyes = stand_on(
        terrain, easting_m=easting_m, northing_m=northing_m, eye_height_m=GRID_EYE_HEIGHT_M
    )
    error = grid.to_numpy()[row, col] - horizons_of(terrain, eyes).sky_view_factor()
    return {
        "step_deg": step_deg,
        "true_step_deg": DEFAULT_STEP_DEG,
        "samples": grid.size,
        "km2": square_km(terrain.bounds_m),
        "seconds": timing.seconds,
        "cpu_seconds": timing.cpu_seconds,
        "us_per_sample": 1e6 * timing.seconds / grid.size,
        "compared": len(drawn),
        "mean_error": float(error.mean()),
        "rms_error": float(np.sqrt(np.mean(error**2))),
        "max_error": float(np.abs(error).max()),
    }

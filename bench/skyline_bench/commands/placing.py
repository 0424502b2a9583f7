"""Placing measured: uniform grids against planned places."""

from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.placing import save_placing
from skyline_bench.runs.placing import PlacingConfig, measure

_PLACING = PlacingConfig()
_COLUMNS = {
    "layout": "layout",
    "places": "places",
    "bytes": "MB",
    "build_cpu_s": "cpu s",
    "group": "skyline",
    "n": "n",
    "within_200m": "in 200 m",
    "within_1km": "in 1 km",
    "median_m": "median m",
    "mean_m": "mean m",
    "answered": "answered",
    "precision": "right of these",
    "claimed_loss": "claimed loss",
    "expected_loss": "expected",
    "lost": "lost",
    "model_precision": "model's precision",
    "model_recall": "recall",
}


def placing(
    dem: options.Dems,
    spacing: Annotated[
        list[float] | None,
        typer.Option(metavar="M", help="Of a uniform grid; may be repeated [320 160 80]."),
    ] = None,
    loss: Annotated[
        list[float] | None,
        typer.Option(metavar="SHARE", help="Of planned places; may be repeated [0.35 0.27 0.2]."),
    ] = None,
    bounds: options.BuiltBounds = None,
    queries: options.Queries = _PLACING.queries,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _PLACING.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Placing: what uniform grids and planned places find for what they cost.

    A query is lost that is not found within 1 km. The claimed loss is what the planner expects
    over the area, the expected one what it expects of the queries; precision and recall are those
    of foretelling which are found.
    """
    config = PlacingConfig(
        tuple(spacing or _PLACING.spacings_m),
        tuple(loss or _PLACING.losses),
        options.bounds_of(bounds),
        queries,
        seed,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    with options.store_folder(folder) as place, progress_bar("building and matching") as progress:
        rows = measure(terrain, config, place, progress)
    options.tell(json_file, "placing", rows, _COLUMNS)
    if plot is not None:
        save_placing(rows, plot)

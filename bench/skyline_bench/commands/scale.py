"""Size measured: what areas cost to build and to search, and what is found in them."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.figures.scale import save_scale
from skyline_bench.runs.scale import ScaleConfig, measure

_SCALE = ScaleConfig()
_COST = {
    "store": "store",
    "places": "places",
    "km2": "km2",
    "build_s": "build s",
    "build_cpu_s": "cpu s",
    "bytes": "MB",
    "open_s": "open s",
    "own_bytes": "own MB",
    "peak_bytes": "peak MB",
}
_FOUND = {
    "search": "searched",
    "group": "skyline",
    "n": "n",
    "within_200m": "in 200 m",
    "within_1km": "in 1 km",
    "median_m": "median m",
    "answered": "answered",
    "precision": "right of these",
    "query_s": "s",
    "query_cpu_s": "cpu s",
    "screened": "screened",
    "fitted": "fitted",
    "retrieved": "retrieved",
    "refined": "refined",
}


def scale(
    dem: options.Dems,
    spacing: Annotated[
        float | None,
        typer.Option(help="Of the store that is built, metres; by default places are planned."),
    ] = _SCALE.spacing_m,
    loss: Annotated[
        float, typer.Option(help="Share of the views that planned places may lose.")
    ] = _SCALE.loss,
    bounds: options.BuiltBounds = None,
    store: Annotated[
        Path | None, typer.Option(help="A store of places that is there already, instead.")
    ] = None,
    area: Annotated[
        list[float] | None,
        typer.Option(
            metavar="KM2",
            help="A square that is searched; may be repeated [50 1000 10000]. What is larger than "
            "the store is left out; all of it is searched as well.",
        ),
    ] = None,
    near: Annotated[
        list[float] | None,
        typer.Option(metavar="KM", help="A circle's radius, likewise [30]."),
    ] = None,
    queries: options.Queries = _SCALE.queries,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    plot: options.PlotFile = None,
    seed: options.Seed = _SCALE.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Size: a store of places built, and synthetic queries found in squares of it that grow.

    A query's place lies anywhere in its squares. Of screened, fitted, retrieved and refined
    places, the share of queries is told that have one within one spacing of the truth, looking
    within 10 degrees of the right way: where it drops, queries are lost.
    """
    config = ScaleConfig(
        spacing_m=spacing,
        loss=loss,
        bounds_deg=options.bounds_of(bounds),
        store=store,
        areas_km2=tuple(area or _SCALE.areas_km2),
        near_km=tuple(near or _SCALE.near_km),
        queries=queries,
        seed=seed,
    )
    terrain = read_dem(dem, DemOptions(crs=crs))
    config = config.quick(terrain) if quick else config
    with options.store_folder(folder) as place, progress_bar("building and matching") as progress:
        cost, rows = measure(terrain, config, place, progress)
    options.print_rows([cost], _COST)
    options.print_rows(rows, _FOUND)
    options.keep_record(json_file, "scale", rows, {"store": [cost]})
    if plot is not None:
        save_scale(rows, plot)

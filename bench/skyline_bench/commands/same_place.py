"""Photos of one place measured: each alone and all together."""

from typing import Annotated

import typer

from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions, read_dem
from skyline_bench.commands import options
from skyline_bench.runs.same_place import SamePlaceConfig, measure

_SAME_PLACE = SamePlaceConfig()
_COLUMNS = {
    "group": "group",
    "places": "places",
    "photos": "photos",
    "alone_within_200m": "one: in 200 m",
    "alone_median_m": "median m",
    "within_200m": "all: in 200 m",
    "median_m": "median m",
    "answered": "answered",
    "precision": "right",
    "radius_holds": "in radius",
    "mixed_within_200m": "mixed: in 200 m",
    "mixed_precision": "right",
    "stranger_named": "named",
}


def same_place(
    dem: options.Dems,
    bounds: options.Bounds = None,
    spacing: Annotated[
        float, typer.Option(help="Of the store of places, metres.")
    ] = _SAME_PLACE.spacing_m,
    places: Annotated[int, typer.Option(help="Where photos are taken.")] = _SAME_PLACE.places,
    photos: Annotated[int, typer.Option(help="Photos of each place.")] = _SAME_PLACE.photos,
    folder: options.Folder = None,
    json_file: options.JsonFile = None,
    seed: options.Seed = _SAME_PLACE.seed,
    quick: options.Quick = False,
    crs: options.Crs = None,
) -> None:
    """Photos of one place: how often one of them finds it, and how often all together.

    Once more, the last photo of each place is exchanged for a stranger: one of another place.
    """
    config = SamePlaceConfig(options.bounds_of(bounds), spacing, places, photos, seed)
    terrain = read_dem(dem, DemOptions(crs=crs))
    with options.store_folder(folder) as place, progress_bar("matching") as progress:
        rows = measure(terrain, config.quick() if quick else config, place, progress)
    options.tell(json_file, "same-place", rows, _COLUMNS)

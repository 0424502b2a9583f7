"""``skyline dem fetch``, ``peaks`` and ``cache``: data from servers, and the cache of `locate`."""

import json
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

from skyline.cache import cache_folder, cached_areas, clear_cache
from skyline.cli.console import (
    AsJson,
    on_interrupt,
    output_option,
    parse_bounds,
    print_line,
    print_note,
    print_written,
    progress_bar,
)
from skyline.fetch.dem_tiles import SOURCES, fetch_dem
from skyline.fetch.overpass import fetch_peaks

Box = Annotated[str, Option(metavar="W,S,E,N", help="The box, in degrees (WGS 84).")]

dem = typer.Typer(
    name="dem", help="Fetch the elevation of an area: `dem fetch`.", no_args_is_help=True
)


@dem.callback()
def _group() -> None:
    """Do nothing: with this callback, `fetch` stays a subcommand although it is the only one."""


@dem.command()
def fetch(
    bbox: Box,
    folder: Annotated[Path, output_option("The folder for the tiles.", "DIR")],
    source: Annotated[
        str,
        Option(
            metavar="NAME|URL",
            help=f"{', '.join(SOURCES)}, or an address with {{lat:02d}}, {{lon:03d}}, {{ns}}, "
            "{ew}: the degrees of a tile's south-west corner without signs, and its hemispheres.",
        ),
    ] = "copernicus",
) -> None:
    """Fetch elevation tiles (cloud-optimized GeoTIFF), cut to a box, for `skyline build DIR/*.tif`.

    The box must contain the area to build and all terrain that is seen from it.
    After a stop or a failure, the same command continues.
    """
    bounds = parse_bounds(bbox)
    on_interrupt(
        "the tiles that were fetched are kept, and the same command continues with the others",
        lambda: any(folder.glob("*.tif")),
    )
    with progress_bar("fetching tiles") as progress:
        done = fetch_dem(bounds, source, folder, progress=progress)
    held = sum(path.stat().st_size for path in done.files)
    print_line(
        f"{folder}: {len(done.files)} tiles, {done.fetched} fetched now, {held / 1e6:.1f} MB"
    )
    if done.missing:
        print_line(f"the source has no tile (usually sea) for: {', '.join(done.missing)}")


def peaks(
    bbox: Box,
    server: Annotated[
        str, Option(metavar="URL", help="An Overpass server: https://host/api/interpreter.")
    ],
    output: Annotated[Path, output_option("The GeoJSON to write.")],
) -> None:
    """Fetch the named peaks of a box from OpenStreetMap, for `--peaks`."""
    count = fetch_peaks(parse_bounds(bbox), server, output)
    print_written(output, f"{count} peaks (OpenStreetMap contributors, ODbL)")


def cache(
    clear: Annotated[bool, Option("--clear", help="Remove all of it.")] = False,
    as_json: AsJson = False,
) -> None:
    """List what `locate` keeps: elevation tiles and stores of areas."""
    areas = [one.to_dict() for one in cached_areas()]
    total = _bytes_of(areas)
    if clear:
        count = clear_cache(print_note)
        left = _bytes_of([one.to_dict() for one in cached_areas()])
        print_line(f"{cache_folder()}: areas removed: {count}, {(total - left) / 1e6:.1f} MB")
        return
    if as_json:
        about = {"folder": str(cache_folder()), "areas": areas}
        print_line(json.dumps(about | {"bytes": total}))
        return
    for one in areas:
        unfinished = "" if one["finished"] else ", unfinished"
        store = f"store {one['store_bytes'] / 1e6:.1f} MB{unfinished}"
        tiles = f"tiles: {one['tiles']}, {one['tile_bytes'] / 1e6:.1f} MB; " if one["tiles"] else ""
        box = ",".join(f"{side:g}" for side in one["bounds_deg"])
        changed = datetime.fromisoformat(one["changed"])
        print_line(f"{one['origin']} {box}: {tiles}{store}, {changed:%Y-%m-%d %H:%M}")
    print_line(f"{cache_folder()}: areas: {len(areas)}, {total / 1e6:.1f} MB")


def _bytes_of(areas: list[dict[str, Any]]) -> int:
    return sum(one["tile_bytes"] + one["store_bytes"] for one in areas)

"""``skyline dem fetch`` and ``peaks``: elevation tiles and named peaks from servers."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.console import (
    on_interrupt,
    output_option,
    parse_bounds,
    print_line,
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
        f"{folder}: {len(done.files)} tiles, {done.fetched} of them new, {held / 1e6:.1f} MB"
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

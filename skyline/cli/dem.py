"""``skyline dem fetch``: elevation tiles from a server."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import BoundsText, output_option, parse_bounds
from skyline.cli.terminal import Terminal, size_in_words
from skyline.fetch.dem_tiles import DEFAULT_SOURCE, SOURCE_VARIABLE, SOURCES, fetch_dem
from skyline.progress import Step

TileSource = Annotated[
    str | None,
    Option(
        "--source",
        metavar="NAME|URL",
        help=f"Source of tiles: {', '.join(SOURCES)}, or an address with {{lat:02d}}, {{lon:03d}}, "
        "{ns}, {ew}: the degrees of a tile's south-west corner without signs, and its hemispheres.",
        show_default=f"${SOURCE_VARIABLE}, else {DEFAULT_SOURCE}",
        autocompletion=lambda: list(SOURCES),
    ),
]

dem = typer.Typer(
    name="dem", help="Fetch the elevation of an area: `dem fetch`.", no_args_is_help=True
)


@dem.callback()
def _group() -> None:
    """Do nothing; with this callback, `fetch` stays a subcommand.

    It is the only one, and Typer would otherwise take it for the whole command.
    """


@dem.command()
def fetch(
    context: typer.Context,
    bounds: BoundsText,
    folder: Annotated[Path, output_option("The folder for the tiles.", "DIR")],
    source: TileSource = None,
) -> None:
    """Fetch elevation tiles (cloud-optimized GeoTIFF), cut to an area, for `build DIR/*.tif`.

    The bounds must contain the area to build and all terrain that is seen from it.
    After a stop or a failure, the same command continues.
    """
    terminal = Terminal.of(context)
    terminal.keeps(
        "the tiles that were fetched are kept, and the same command continues with the others",
        lambda: any(folder.glob("*.tif")),
    )
    with terminal.progress(Step.FETCHING) as progress:
        done = fetch_dem(parse_bounds(bounds), source, folder, progress=progress)
    held = sum(path.stat().st_size for path in done.files)
    terminal.line(
        f"{folder}: {len(done.files)} tiles, {done.fetched} fetched now, {size_in_words(held)}"
    )
    if done.missing:
        terminal.line(f"the source has no tile (usually sea) for: {', '.join(done.missing)}")

"""``skyline dem``: elevation data for an area."""

from pathlib import Path
from typing import Annotated

import typer

from skyline.console import parse_bounds, progress_bar
from skyline.fetch import SOURCES, HttpOptions, fetch_dem

_HTTP = HttpOptions()

app = typer.Typer(name="dem", help="Elevation data for an area.", no_args_is_help=True)


@app.callback()
def dem() -> None:
    """Elevation data for an area."""


@app.command()
def fetch(
    bbox: Annotated[str, typer.Option(metavar="W,S,E,N", help="Degrees (WGS 84).")],
    folder: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Where tiles go.")],
    source: Annotated[
        str,
        typer.Option(
            metavar="NAME|URL",
            help=f"{', '.join(SOURCES)}, or an address with {{lat:02d}}, {{lon:03d}}, {{ns}}, "
            "{ew}: a tile's south-west corner without its signs, and its hemispheres.",
        ),
    ] = "copernicus",
    retries: Annotated[int, typer.Option(help="Of a request that failed.")] = _HTTP.retries,
    timeout: Annotated[
        int, typer.Option(metavar="SECONDS", help="Without an answer, until a request failed.")
    ] = _HTTP.timeout_s,
) -> None:
    """Fetch elevation tiles (cloud-optimized GeoTIFF), cut to a box, for `skyline build DIR/*.tif`.

    Give a box as much larger than the area to build as one sees from it. Stopped or failed, the
    same command goes on.
    """
    bounds = parse_bounds(bbox)
    options = HttpOptions(retries=retries, timeout_s=timeout)
    with progress_bar("fetching tiles") as progress:
        done = fetch_dem(bounds, source, folder, options, progress)
    held = sum(path.stat().st_size for path in done.files)
    typer.echo(
        f"{folder}: {len(done.files)} tiles, {done.fetched} of them new, {held / 1e6:.1f} MB"
    )
    if done.missing:
        typer.echo(f"not there, as a rule sea: {', '.join(done.missing)}")

"""``skyline peaks``: names of peaks from OpenStreetMap."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import BoundsText, output_option, parse_bounds
from skyline.cli.terminal import Terminal
from skyline.fetch.overpass import DEFAULT_SERVER, fetch_peaks


def peaks(
    context: typer.Context,
    bounds: BoundsText,
    output: Annotated[Path, output_option("The GeoJSON to write.")],
    server: Annotated[
        str,
        Option(
            metavar="URL",
            help="An Overpass server: https://host/api/interpreter.",
            envvar="SKYLINE_PEAKS_SERVER",
        ),
    ] = DEFAULT_SERVER,
) -> None:
    """Fetch the named peaks of an area from OpenStreetMap, for `--peaks`."""
    count = fetch_peaks(parse_bounds(bounds), server, output)
    Terminal.of(context).written(output, f"{count} peaks (OpenStreetMap contributors, ODbL)")

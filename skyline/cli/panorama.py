"""``skyline panorama``: a drawing of the view from a position."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import (
    PEAKS,
    Crs,
    Dems,
    EyeHeight,
    SummitWithin,
    SurfaceFiles,
    output_option,
    parse_position,
)
from skyline.cli.terminal import Terminal, size_in_words
from skyline.report.panorama_view import PanoramaConfig
from skyline.tasks.panorama import PanoramaTask, write_panorama

_DRAWN = PanoramaConfig()


def panorama(
    context: typer.Context,
    dem: Dems,
    at: Annotated[str, Option(metavar="LON,LAT", help="The position, degrees (WGS 84).")],
    output: Annotated[Path, output_option("The file to write: .png, .svg or .pdf.")],
    peaks: Annotated[Path | None, PEAKS] = None,
    heading: Annotated[
        float, Option(metavar="DEG", help="Heading of the picture's middle, from true north.")
    ] = _DRAWN.heading_deg,
    fov_deg: Annotated[
        float, Option(metavar="DEG", help="Horizontal field of view, 5 to 360 degrees.")
    ] = _DRAWN.fov_deg,
    eye_height: EyeHeight = _DRAWN.eye_height_m,
    summit_within: SummitWithin = None,
    surface: SurfaceFiles = None,
    crs: Crs = None,
) -> None:
    """Draw the view from a position, with the peaks' names."""
    task = PanoramaTask(
        dem=dem,
        crs=crs,
        position=parse_position(at),
        config=PanoramaConfig(heading, fov_deg, eye_height, summit_within),
        peaks=peaks,
        surface=surface or (),
        output=output,
    )
    terminal = Terminal.of(context)
    named = write_panorama(task, terminal)
    terminal.line(f"{output}: {size_in_words(output.stat().st_size)}{named}")

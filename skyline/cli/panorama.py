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
from skyline.errors import suffix_of
from skyline.report.panorama_view import PanoramaConfig, panorama_view
from skyline.tasks.standing import stand_with_notes
from skyline.tasks.terrain import read_terrain
from skyline.terrain.surface_model import read_surface
from skyline.view.peaks import read_peaks

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
    from skyline.report import panorama as pictures  # noqa: PLC0415  (slow to load)

    terminal = Terminal.of(context)
    position = parse_position(at)
    suffix_of(output, pictures.PANORAMA_SUFFIXES)
    config = PanoramaConfig(heading, fov_deg, eye_height, summit_within)
    terrain = read_terrain(terminal, dem, crs)
    eye = stand_with_notes(terrain, [position], eye_height, summit_within, terminal)
    with terminal.slow(f"drawing {output}"):
        over = read_surface(surface, terrain) if surface else None
        gazetteer = None if peaks is None else read_peaks(peaks, terrain.frame)
        view = panorama_view(terrain, eye, gazetteer, config, over)
        unnamed = pictures.save_view(view, output)
    seen = len(view.sightings)
    named = "" if gazetteer is None else f", {seen} of {len(gazetteer)} peaks are seen"
    terminal.line(f"{output}: {size_in_words(output.stat().st_size)}{named}{unnamed.named}")

"""``skyline extract``: the skyline of a photo as a trace."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Option

from skyline.cli.options import PhotoProjection, output_option
from skyline.cli.photo_options import FieldOfView, PhotoFile
from skyline.cli.terminal import Terminal
from skyline.errors import check_suffix, suffix_of
from skyline.files.disk import check_outputs
from skyline.photo.drawn_skyline import OVERLAYS, write_overlay
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline
from skyline.photo.trace import TRACES, write_trace


def extract(
    context: typer.Context,
    photo: PhotoFile,
    output: Annotated[Path, output_option("The trace to write.", "FILE.csv")],
    overlay: Annotated[
        Path | None, Option(metavar="PNG", help="Also write the photo with its skyline drawn.")
    ] = None,
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    sky_model: Annotated[
        Path | None, Option(metavar="ONNX", help="Your own sky segmentation model (extra `onnx`).")
    ] = None,
) -> None:
    """Find the skyline in a photo and write it as a trace.

    A person can correct the trace.
    """
    terminal = Terminal.of(context)
    check_outputs([output, overlay], [photo])
    check_suffix(output, TRACES)
    if overlay is not None:
        suffix_of(overlay, OVERLAYS)
    read = read_photo(photo, fov_deg, projection=projection)
    skyline = find_skyline(read, sky_model)
    if overlay is not None:
        write_overlay(read.rgb, skyline, overlay)
    write_trace(skyline, output)
    trusted = np.count_nonzero(skyline.trusted)
    terminal.written(output, f"skyline found in {trusted} of {skyline.width_px} columns")
    if skyline.lens is not None and skyline.lens.reason:
        terminal.written(output, skyline.lens.in_words)

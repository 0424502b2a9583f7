"""``skyline extract``: the skyline of a photo as a trace."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Option

from skyline.cli.options import PhotoProjection, output_option
from skyline.cli.photo_options import FieldOfView, PhotoFile
from skyline.cli.terminal import Terminal
from skyline.tasks.extract import ExtractTask, write_extracted


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

    Correct the trace by hand, and give it to `match` in place of the photo.
    """
    task = ExtractTask(
        photo=photo,
        output=output,
        overlay=overlay,
        fov_deg=fov_deg,
        projection=projection,
        sky_model=sky_model,
    )
    skyline = write_extracted(task)
    terminal = Terminal.of(context)
    trusted = np.count_nonzero(skyline.trusted)
    terminal.written(output, f"skyline found in {trusted} of {skyline.width_px} columns")
    if skyline.lens is not None and skyline.lens.reason:
        terminal.written(output, skyline.lens.in_words)

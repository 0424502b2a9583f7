"""``skyline pixels``: the positions that a photo's pixels show."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from typer import Option

from skyline.cli.options import POSE, Crs, Dem, PhotoProjection, output_option
from skyline.cli.photo_options import PhotoFile
from skyline.cli.terminal import Terminal
from skyline.ground.pixel_places import PIXEL_FILES
from skyline.tasks.pixels import PixelsTask, place_pixels


def pixels(
    context: typer.Context,
    photo: PhotoFile,
    pose: Annotated[Path, POSE],
    dem: Dem,
    output: Annotated[Path, output_option(f"The file to write: {' or '.join(PIXEL_FILES)}.")],
    step: Annotated[
        int, Option(min=1, metavar="N", help="Take every Nth row and column of pixels.")
    ] = 1,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Give the position on the terrain of each pixel of a photo.

    Distance, longitude, latitude and elevation are NaN for sky.
    """
    terminal = Terminal.of(context)
    task = PixelsTask(
        photo=photo, pose=pose, dem=dem, crs=crs, output=output, step=step, projection=projection
    )
    places = place_pixels(task, terminal)
    ground = 100.0 * float(np.isfinite(places.distance_m).mean())
    height, width = places.distance_m.shape
    terminal.line(f"{output}: {width} x {height} pixels, {ground:.0f} % of them on terrain")

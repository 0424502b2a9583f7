"""``skyline label``: the names of the summits in a photo."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from skyline.cli.options import (
    PEAKS,
    POSE,
    Crs,
    Dem,
    PhotoProjection,
    output_option,
    parse_position,
)
from skyline.cli.photo_options import (
    CameraElevation,
    CameraPosition,
    FieldOfView,
    Heading,
    HeadingSlack,
    PhotoFile,
    heading_of,
)
from skyline.cli.terminal import Terminal
from skyline.sky.sun import time_of
from skyline.tasks.label import LABEL_FILES, LabelTask, label_photo
from skyline.tasks.orient import CameraAt


def label(
    context: typer.Context,
    photo: PhotoFile,
    dem: Dem,
    output: Annotated[Path, output_option(f"The file to write: {', '.join(LABEL_FILES)}.")],
    peaks: Annotated[Path | None, PEAKS] = None,
    at: CameraPosition = None,
    elevation: CameraElevation = None,
    pose: Annotated[Path | None, POSE] = None,
    fov_deg: FieldOfView = None,
    heading: Heading = None,
    heading_slack: HeadingSlack = None,
    ridges: Annotated[
        bool, Option("--ridges", help="Draw the skyline of the elevation model faintly.")
    ] = False,
    time: Annotated[
        str | None,
        Option(
            metavar="TIME",
            help="When the photo was taken, as 2026-12-21T15:04Z: draw the sun and the moon.",
        ),
    ] = None,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Write the names of summits on a copy of a photo.

    Distances stand beside the names. Unless its pose is given, the camera at --at is oriented by
    the skyline. Summits that terrain hides are left out; if none is in view, the photo is written
    without names. If the direction is not sure, but more likely right than wrong, the names are
    written with its confidence.
    """
    terminal = Terminal.of(context)
    task = LabelTask(
        photo=photo,
        dem=dem,
        crs=crs,
        peaks=peaks,
        output=output,
        at=CameraAt(
            lonlat_deg=None if at is None else parse_position(at),
            elevation_m=elevation,
            heading_deg=heading_of(heading, heading_slack),
        ),
        pose=pose,
        fov_deg=fov_deg,
        projection=projection,
        ridges=ridges,
        time=None if time is None else time_of(time),
    )
    seen, *missing = label_photo(task, terminal)
    terminal.line(f"{output}: {seen}")
    for line in missing:
        terminal.line(f"  {line}")

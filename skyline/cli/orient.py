"""``skyline orient``: how cameras were held at known positions."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.options import (
    AsJson,
    Crs,
    Dem,
    PhotoProjection,
    output_option,
    panel,
    parse_position,
)
from skyline.cli.photo_options import (
    CameraElevation,
    CameraPosition,
    FieldOfView,
    Heading,
    HeadingSlack,
    HeightSd,
    PixelSd,
    heading_of,
)
from skyline.cli.terminal import Terminal
from skyline.errors import InputError
from skyline.match.photo_lists import Entry, entries_of
from skyline.orientation.control_points import PointErrors
from skyline.orientation.orienter import DEFAULT_POSITION_SD_M
from skyline.pose.pose_errors import PIXEL_SD_PX
from skyline.tasks.orient import CameraAt, OrientTask, orient_photos
from skyline.tasks.points import PointsTask, orient_by_points

_by_points = panel("Control points")


def orient(
    context: typer.Context,
    photo: Annotated[
        list[Path],
        Argument(
            metavar="PHOTO",
            help="Photos, folders of them, sky masks, CSV traces or lists, or - for the names of "
            "photos on standard input.",
        ),
    ],
    dem: Dem,
    at: CameraPosition = None,
    elevation: CameraElevation = None,
    position_sd_m: Annotated[
        float | None,
        Option(
            "--position-sd",
            metavar="M",
            help="Standard deviation of the position, metres.",
            show_default=f"{DEFAULT_POSITION_SD_M:g}, or what the GPS notes",
        ),
    ] = None,
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    heading: Heading = None,
    heading_slack: HeadingSlack = None,
    output: Annotated[
        Path | None,
        output_option("Write a table with a row for each photo.", "FILE.csv"),
    ] = None,
    points: Annotated[
        Path | None,
        _by_points(
            "--points",
            metavar="FILE",
            help="Points whose pixel and place are known, in place of the skyline: CSV "
            "(column_px,row_px,lon,lat[,elevation_m][,name]) or QGIS's .points.",
        ),
    ] = None,
    pose: Annotated[
        Path | None,
        _by_points("--pose", metavar="FILE.json", help="A pose that the points refine."),
    ] = None,
    residuals: Annotated[
        Path | None,
        _by_points(
            "--residuals", metavar="FILE", help="Write the points with residuals: .csv, .points."
        ),
    ] = None,
    pixel_sd_px: PixelSd = PIXEL_SD_PX,
    height_sd_m: HeightSd = None,
    as_json: AsJson = False,
    crs: Crs = None,
) -> None:
    """Find how cameras were held at a known position.

    The answer is the heading, pitch, roll and field of view of each camera. With --points it comes
    from points whose pixel and place are known, and has the position, too.
    """
    terminal = Terminal.of(context, as_json)
    stood = CameraAt(
        lonlat_deg=None if at is None else parse_position(at),
        elevation_m=elevation,
        position_sd_m=position_sd_m,
        heading_deg=heading_of(heading, heading_slack),
    )
    if points is not None:
        if output is not None:
            raise InputError("-o writes a table of many photos; leave it out: --json prints a pose")
        task = PointsTask(
            photo=_only_one(photo),
            points=points,
            dem=dem,
            crs=crs,
            at=stood,
            pose=pose,
            fov_deg=fov_deg,
            projection=projection,
            errors=PointErrors(pixel_sd_px=pixel_sd_px, height_sd_m=height_sd_m),
            residuals=residuals,
        )
        by_points = orient_by_points(task, terminal)
        terminal.result(by_points.to_dict(), by_points.to_text())
        return
    if pose is not None or residuals is not None:
        raise InputError("--pose and --residuals are for control points; give --points FILE too")
    many = OrientTask(
        entries=list(entries_of(photo, Entry("", fov_deg, None, projection))),
        inputs=photo,
        dem=dem,
        crs=crs,
        at=stood,
        output=output,
    )
    raise typer.Exit(orient_photos(many, terminal))


def _only_one(photos: list[Path]) -> Path:
    """Return the photo of control points; raises `InputError` for several."""
    if len(photos) != 1:
        raise InputError(f"--points takes one photo, and {len(photos)} are given; give one")
    return photos[0]

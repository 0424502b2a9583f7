"""``skyline orient``: how cameras were held at known positions."""

from pathlib import Path
from typing import Annotated, Any

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
from skyline.errors import InputError, SkylineError, check_suffix, printable
from skyline.files.disk import STANDARD, check_outputs, write_whole
from skyline.files.tables import csv_lines
from skyline.match.photo_lists import Entry, entries_of, usable_entries
from skyline.orientation.control_points import PointErrors
from skyline.orientation.orienter import DEFAULT_POSITION_SD_M
from skyline.orientation.result import Orientation
from skyline.pose.pose_errors import PIXEL_SD_PX
from skyline.tasks.orient import CameraAt, orient_photos
from skyline.tasks.points import PointsTask, orient_by_points
from skyline.tasks.terrain import read_terrain
from skyline.terrain.heightfield import HeightField

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
    entries = list(entries_of(photo, Entry("", fov_deg, None, projection)))
    check_outputs([output], [*photo, *(Path(one.path) for one in entries)])
    if output is not None:
        check_suffix(output, [".csv"])
    usable_entries(entries)  # Refused before the DEM is read, if none is usable
    terrain = read_terrain(terminal, dem, crs)
    raise typer.Exit(_orient_each(terminal, terrain, entries, stood, output))


def _only_one(photos: list[Path]) -> Path:
    """Return the photo of control points; raises `InputError` for several."""
    if len(photos) != 1:
        raise InputError(f"--points takes one photo, and {len(photos)} are given; give one")
    return photos[0]


def _orient_each(
    terminal: Terminal,
    terrain: HeightField,
    entries: list[Entry],
    stood: CameraAt,
    output: Path | None,
) -> int:
    """Print and write the orientation of each photo; return the exit code."""
    rows: list[dict[str, Any]] = []
    exit_code = 0
    oriented = 0
    doing = f"orienting {entries[0].path}" if len(entries) == 1 else "orienting photos"
    with terminal.progress(doing) as progress:
        progress(0, len(entries))
        for entry, found in zip(entries, orient_photos(terrain, entries, stood), strict=True):
            if isinstance(found, SkylineError):
                terminal.error(str(found))
                exit_code = found.exit_code
            else:
                oriented += 1
                _print(terminal, entry, found, output)
            rows.append(_row(entry, found))
            progress(len(rows), len(entries))
    if output is not None and oriented:
        write_whole(output, _csv(rows))
    return exit_code


def _print(terminal: Terminal, entry: Entry, found: Orientation, output: Path | None) -> None:
    """Print an orientation, unless the table goes to standard output."""
    if output is not None and str(output) == STANDARD:
        return
    try:
        terminal.result(found.to_dict() | _label(entry), found.to_text())
    except BrokenPipeError:
        if output is None:
            raise


def _row(entry: Entry, found: Orientation | SkylineError) -> dict[str, Any]:
    if isinstance(found, SkylineError):
        failed = {"photo": printable(entry.path), "trusted": 0, "refusal": str(found)}
        return failed | _label(entry)
    return found.to_row() | _label(entry)


def _label(entry: Entry) -> dict[str, str]:
    return {"id": printable(entry.label)} if entry.label else {}


def _csv(rows: list[dict[str, Any]]) -> str:
    names = dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row)
    return csv_lines([names, *([row.get(name) for name in names] for row in rows)])

"""``skyline orient``: how cameras were held at known positions."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from skyline.batch import Entry, entries_of, usable_entries
from skyline.cli.options import (
    AsJson,
    Crs,
    Dem,
    PhotoProjection,
    output_option,
    parse_position,
    read_terrain,
)
from skyline.cli.photo_options import (
    CameraElevation,
    CameraPosition,
    FieldOfView,
    Heading,
    HeadingSlack,
    heading_of,
)
from skyline.cli.terminal import Terminal
from skyline.errors import SkylineError, check_suffix, printable
from skyline.files import STANDARD, check_outputs, write_whole
from skyline.orientation import DEFAULT_POSITION_SD_M, Orientation
from skyline.tables import csv_lines
from skyline.tasks.orient import CameraAt, orient_photos


def orient(
    context: typer.Context,
    photo: Annotated[
        list[Path],
        Argument(metavar="PHOTO", help="Photos, folders of them, sky masks or CSV traces."),
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
    as_json: AsJson = False,
    crs: Crs = None,
) -> None:
    """Find how cameras were held at a known position.

    The heading, pitch, roll and field of view of each camera are given.
    """
    terminal = Terminal.of(context, as_json)
    stood = CameraAt(
        lonlat_deg=None if at is None else parse_position(at),
        elevation_m=elevation,
        position_sd_m=position_sd_m,
        heading_deg=heading_of(heading, heading_slack),
    )
    entries = list(entries_of(photo, Entry("", fov_deg, None, projection)))
    check_outputs([output], [*photo, *(Path(one.path) for one in entries)])
    if output is not None:
        check_suffix(output, [".csv"])
    usable_entries(entries)  # Refused before the DEM is read, if none is usable
    terrain = read_terrain(terminal, dem, crs)
    rows: list[dict[str, Any]] = []
    exit_code = 0
    oriented = 0
    for entry, found in zip(entries, orient_photos(terrain, entries, stood), strict=True):
        if isinstance(found, SkylineError):
            terminal.error(str(found))
            exit_code = found.exit_code
        else:
            oriented += 1
            _print(terminal, entry, found, output)
        rows.append(_row(entry, found))
    if output is not None and oriented:
        write_whole(output, _csv(rows))
    raise typer.Exit(exit_code)


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

"""``skyline orient``: how cameras were held at a known place."""

import csv
import io
import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Argument, Option

from skyline.cli.console import (
    AsJson,
    Crs,
    Reproject,
    are_degrees,
    parse_numbers,
    print_error,
    print_line,
    read_terrain,
)
from skyline.cli.photo import FieldOfView, PhotoProjection, check_outputs
from skyline.errors import InputError, SkylineError, printable
from skyline.files import STANDARD, write_whole
from skyline.match.orient import DEFAULT_WITHIN_M, Place, noted_place, orienters
from skyline.match.queries import Query, listed
from skyline.photo.query import QuerySkyline

CameraPlace = Annotated[
    str | None,
    Option(
        metavar="LON,LAT[,ELEV]",
        help="The camera's place in degrees and, if known, its elevation in metres above the "
        "DEM's datum. By default each photo's own GPS position.",
    ),
]


def orient(
    photo: Annotated[
        list[Path],
        Argument(metavar="PHOTO...", help="Photos, folders of them, sky masks or CSV traces."),
    ],
    dem: Annotated[
        list[str], Option("--dem", metavar="DEM", help="Elevation file; repeat for each tile.")
    ],
    at: CameraPlace = None,
    within: Annotated[
        float | None,
        Option(
            metavar="M",
            help="Standard error of the place, metres.",
            show_default=f"{DEFAULT_WITHIN_M:g}, or what the GPS notes",
        ),
    ] = None,
    fov_deg: FieldOfView = None,
    projection: PhotoProjection = None,
    csv_file: Annotated[
        Path | None,
        Option("--csv", metavar="FILE", help="Write a table with a row for each photo."),
    ] = None,
    as_json: AsJson = False,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Find how cameras were held at a known place: heading, pitch, roll and field of view."""
    place = camera_place(at)
    queries = list(listed(photo, Query("", fov_deg, None, projection)))
    check_outputs([csv_file], [*photo, *(Path(one.path) for one in queries)])
    for one in queries:
        one.check()
    terrain = read_terrain(dem, crs, reproject)
    found: list[dict[str, Any]] = []
    oriented, exit_code = 0, 0
    with orienters(terrain) as orienter_at:
        for one in queries:
            label = {"id": printable(one.label)} if one.label else {}
            try:
                skyline = one.read()
                lon, lat, elevation_m, usual_m = place or place_noted(skyline, one.path)
                there = lon, lat, elevation_m, usual_m if within is None else within
                result = orienter_at(there).orient(skyline, name=one.path)
            except SkylineError as error:
                print_error(str(error))
                exit_code = error.exit_code
                failed = {"query": printable(one.path), "trusted": 0, "refusal": str(error)}
                found.append(failed | label)
                continue
            row = result.to_row() | label
            found.append(row)
            oriented += 1
            if csv_file is not None and str(csv_file) == STANDARD:
                continue
            text = json.dumps(row) if as_json else result.to_text()
            try:
                for line in text.splitlines():
                    print_line(line)
            except BrokenPipeError:
                if csv_file is None:
                    raise
    if csv_file is not None and oriented:
        write_whole(csv_file, _csv(found))
    if exit_code:
        raise typer.Exit(exit_code)


def camera_place(at: str | None) -> Place | None:
    """Return the place of ``--at``, if there is one; raises `InputError` for bad text."""
    if at is None:
        return None
    count = 3 if at.count(",") == 2 else 2
    error = f"--at is `{at}`; expected LON,LAT or LON,LAT,ELEV in degrees and metres"
    lon, lat, *rest = parse_numbers(at, count, error)
    if not are_degrees(lon, lat):
        raise InputError(error)
    return lon, lat, rest[0] if rest else None, DEFAULT_WITHIN_M


def place_noted(query: QuerySkyline, name: str) -> Place:
    """Return the place that a photo's GPS notes; raises `InputError` where it notes none."""
    lon, lat, within_m = noted_place(query, name)
    return lon, lat, None, within_m


def _csv(rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    names = dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row)
    writer = csv.DictWriter(text, list(names), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()

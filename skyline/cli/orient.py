"""``skyline orient``: how cameras were held at a known place."""

import csv
import io
import json
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from skyline.cli.console import (
    AsJson,
    Crs,
    Reproject,
    are_degrees,
    note_if_slow,
    parse_numbers,
    print_error,
    print_line,
)
from skyline.cli.photo import FieldOfView, PhotoProjection, check_outputs
from skyline.errors import InputError, SkylineError
from skyline.files import write_whole
from skyline.match.orient import (
    DEFAULT_WITHIN_M,
    Orientation,
    Place,
    noted_place,
    orienters,
)
from skyline.match.queries import Query, listed
from skyline.terrain.dem import DemOptions, read_dem


def orient(
    photo: Annotated[
        list[Path],
        Argument(metavar="PHOTO...", help="Photos, folders of them, sky masks or CSV traces."),
    ],
    dem: Annotated[
        list[str], Option("--dem", metavar="DEM", help="Elevation file; repeat for each tile.")
    ],
    at: Annotated[
        str | None,
        Option(
            metavar="LON,LAT[,ELEV]",
            help="The camera's place in degrees and, if known, its elevation in metres above the "
            "DEM's datum. By default each photo's own GPS position.",
        ),
    ] = None,
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
        Path | None, Option("--csv", metavar="FILE", help="Write a row for each photo.")
    ] = None,
    as_json: AsJson = False,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Find how cameras were held at a known place: heading, pitch, roll and field of view."""
    place = None
    if at is not None:
        place = _place(at, DEFAULT_WITHIN_M if within is None else within)
    queries = list(listed(photo, Query("", fov_deg, None, projection)))
    check_outputs([csv_file], [*photo, *(Path(one.path) for one in queries)])
    for one in queries:
        one.check()
    with note_if_slow("reading the elevation model"):
        terrain = read_dem(dem, DemOptions(crs=crs, reproject=reproject))
    found: list[Orientation] = []
    exit_code = 0
    with orienters(terrain) as orienter_at:
        for one in queries:
            try:
                skyline = one.read()
                there = place
                if there is None:
                    lon, lat, noted_m = noted_place(skyline, one.path)
                    there = lon, lat, None, noted_m if within is None else within
                result = orienter_at(there).orient(skyline, name=one.path)
            except SkylineError as error:
                print_error(str(error))
                exit_code = error.exit_code
                continue
            found.append(result)
            text = json.dumps(result.to_row()) if as_json else result.to_text()
            try:
                for line in text.splitlines():
                    print_line(line)
            except BrokenPipeError:
                if csv_file is None:
                    raise
    if csv_file is not None and found:
        write_whole(csv_file, _csv(found))
    if exit_code:
        raise typer.Exit(exit_code)


def _place(text: str, within_m: float) -> Place:
    count = 3 if text.count(",") == 2 else 2
    error = f"--at is `{text}`; expected LON,LAT or LON,LAT,ELEV in degrees and metres"
    lon, lat, *rest = parse_numbers(text, count, error)
    if not are_degrees(lon, lat):
        raise InputError(error)
    return lon, lat, rest[0] if rest else None, within_m


def _csv(found: list[Orientation]) -> str:
    rows = [one.to_row() for one in found]
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()

"""``skyline orient``, ``label`` and ``pixels``: cameras at known places, and what they see."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from typer import Argument, Option

from skyline.batch import Query, listed
from skyline.camera import MOST_DISTORTION, WANDER_DEGREES, Projection
from skyline.cli.console import (
    PEAKS,
    AsJson,
    Crs,
    are_degrees,
    check_outputs,
    lies_in_any,
    note_if_slow,
    output_option,
    print_error,
    print_line,
    print_note,
    progress_bar,
    read_terrain,
)
from skyline.cli.photo import FieldOfView, PhotoFile, PhotoProjection, usable_queries
from skyline.errors import (
    InputError,
    SkylineError,
    check_suffix,
    numbers_of,
    printable,
    suffix_of,
)
from skyline.files import STANDARD, on_disk, read_bytes, write_whole
from skyline.orientation import DEFAULT_WITHIN_M, Place, noted_place, orienters
from skyline.peaks import read_peaks
from skyline.photo.photo import read_photo
from skyline.photo.read import read_query
from skyline.photo.skyline import PhotoSkyline
from skyline.pose import Pose
from skyline.tables import csv_lines
from skyline.terrain.dem_files import dem_names
from skyline.terrain.viewpoints import LEAST_EYE_HEIGHT_M, check_eye_elevation
from skyline.view import PIXEL_FILES, Viewer

_LABEL_FILES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".svg": "svg", ".json": "json"}
_ROUNDED_M = 0.01
"""An eye that is too low by less than this is rounded."""
_NEEDED = ("lon", "lat", "heading_deg", "fov_deg")
_EXPECTED = (
    "expected JSON as `skyline match --json` or `skyline orient --json` prints it, or a record "
    f"with {', '.join(_NEEDED)}"
)

_POSE = Option(
    metavar="FILE.json",
    help="The camera's place and direction, as `match --json` and `orient --json` print them.",
)
Dem = Annotated[
    list[str],
    Option("--dem", metavar="DEM", help="Elevation file, or a folder of them; may be repeated."),
]
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
    dem: Dem,
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
) -> None:
    """Find how cameras were held at a known place: heading, pitch, roll and field of view."""
    place = camera_place(at)
    queries = list(listed(photo, Query("", fov_deg, None, projection)))
    check_outputs([csv_file], [*photo, *(Path(one.path) for one in queries)])
    if csv_file is not None:
        check_suffix(csv_file, [".csv"])
    usable_queries(queries)  # Refused before the DEM is read, if none is usable
    terrain = read_terrain(dem, crs)
    found: list[dict[str, Any]] = []
    oriented, exit_code = 0, 0
    with orienters(terrain) as orienter_at:
        for one in queries:
            label = {"id": printable(one.label)} if one.label else {}
            try:
                skyline = one.read()
                lon, lat, elevation_m, usual_m = place or noted_place(skyline, one.path)
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
            text = json.dumps(result.to_dict() | label) if as_json else result.to_text()
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
    lon, lat, *rest = numbers_of(at.split(","), count, error)
    if not are_degrees(lon, lat):
        raise InputError(error)
    return lon, lat, rest[0] if rest else None, DEFAULT_WITHIN_M


def _csv(rows: list[dict[str, Any]]) -> str:
    names = dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row)
    return csv_lines([names, *([row.get(name) for name in names] for row in rows)])


def label(
    photo: PhotoFile,
    dem: Dem,
    peaks: Annotated[Path, PEAKS],
    output: Annotated[Path, output_option(f"The file to write: {', '.join(_LABEL_FILES)}.")],
    at: CameraPlace = None,
    pose: Annotated[Path | None, _POSE] = None,
    fov_deg: FieldOfView = None,
    ridges: Annotated[
        bool, Option("--ridges", help="Draw the skyline of the elevation model faintly.")
    ] = False,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Write the names and distances of the summits in a photo on a copy of it.

    The camera is oriented by the skyline at its place, unless its pose is given.
    Summits that terrain hides are left out; if none is in view, the photo is written without names.
    """
    from skyline.report.labels import UnnamedPeaks, some_of  # noqa: PLC0415  (slow to load)
    from skyline.report.overlay import draw_labels  # noqa: PLC0415

    kind = _LABEL_FILES[suffix_of(output, _LABEL_FILES)]
    if pose is not None and (at is not None or fov_deg is not None):
        raise InputError("--pose has the place and the field of view; leave --at and --fov-deg out")
    check_outputs([output], [photo, *filter(None, [pose]), peaks])
    place = camera_place(at)
    picture = read_photo(photo, fov_deg, projection=projection)
    query = picture.blank
    known: dict[str, float] | Place
    if pose is not None:
        known = _read_pose(pose, photo, query.projection)
    else:
        query = read_query(photo, fov_deg, projection=projection)
        known = place or noted_place(query, str(photo))
    terrain = read_terrain(dem, crs)
    gazetteer = read_peaks(peaks, terrain.frame)
    with Viewer(terrain, gazetteer) as viewer:
        with note_if_slow("orienting the camera"):
            if isinstance(known, dict):
                camera = _camera(known, viewer)
            else:
                camera = _oriented(photo, query, known, viewer)
        with note_if_slow("looking for summits"):
            seen = viewer.summits(camera, query)
            sight = viewer.look(camera, query) if ridges and kind != "json" else None
    unnamed = UnnamedPeaks()
    if kind == "json":
        names = ("name", "column_px", "row_px", "distance_m", "elevation_m")
        records = [{name: getattr(one, name) for name in names} for one in seen]
        written: str | bytes = json.dumps(records, indent=1) + "\n"
    else:
        written, unnamed = draw_labels(query, picture.rgb, seen, sight, kind)
    write_whole(output, written)
    without = unnamed.named
    missing = sorted(set(gazetteer.names) - {one.name for one in seen})
    if missing:
        without += f"; hidden or outside the photo: {some_of(missing)}"
    print_line(f"{output}: {len(seen)} of {len(gazetteer)} peaks are seen{without}")


def pixels(
    photo: PhotoFile,
    pose: Annotated[Path, _POSE],
    dem: Dem,
    output: Annotated[Path, output_option(f"The file to write: {' or '.join(PIXEL_FILES)}.")],
    step: Annotated[
        int, Option(min=1, metavar="N", help="Take every Nth row and column of pixels.")
    ] = 1,
    projection: PhotoProjection = None,
    crs: Crs = None,
) -> None:
    """Give the place on the terrain that each pixel of a photo shows.

    Distance, longitude, latitude and elevation are NaN for sky.
    """
    suffix = suffix_of(output, PIXEL_FILES)
    names = dem_names(dem)
    check_outputs([output], [photo, pose, *map(Path, map(on_disk, names))])
    if suffix == ".tif" and lies_in_any(output, dem):
        raise InputError(f"{output} would become a part of the DEM; choose another folder for it")
    query = read_photo(photo, projection=projection).blank
    record = _read_pose(pose, photo, query.projection)
    terrain = read_terrain(names, crs)
    with progress_bar("following rays") as progress:
        viewer = Viewer(terrain)
        camera = _camera(record, viewer)
        places = viewer.places(camera, query, step, progress)
    places.save(output, camera)
    ground = 100.0 * float(np.isfinite(places.distance_m).mean())
    height, width = places.distance_m.shape
    print_line(f"{output}: {width} x {height} pixels, {ground:.0f} % of them on terrain")


def _read_pose(path: Path, photo: Path, projection: Projection) -> dict[str, Any]:
    """Return the numbers of a photo's pose in a file; raises `InputError` unless all are there.

    A file of several photos has the pose in the line that names the photo.
    """
    try:
        text = read_bytes(path, _EXPECTED).decode("utf-8-sig")
        try:
            records = [json.loads(text, parse_int=float)]
        except ValueError:
            lines = filter(str.strip, text.splitlines())
            records = [json.loads(line, parse_int=float) for line in lines]
    except (ValueError, RecursionError) as error:
        raise InputError(f"pose {path} cannot be read ({error}); {_EXPECTED}") from None
    if len(records) > 1:
        named = {"query": printable(photo)}
        records = [one for one in records if isinstance(one, dict) and named.items() <= one.items()]
        if len(records) != 1:
            raise InputError(
                f"pose {path} has {len(records)} lines whose `query` is {photo}; expected one: "
                "give a file of this photo alone"
            )
    record = records[0] if records else None
    if isinstance(record, dict) and isinstance(record.get("candidates"), list):
        candidates = record["candidates"] or [None]
        if record.get("answer") is None and candidates[0] is not None:
            print_note(f"{path} has no answer, so the best candidate is taken")
        record = record.get("answer") or candidates[0]
    elif isinstance(record, dict) and record.get("refusal"):
        print_note(f"the pose in {path} is not trusted: {printable(str(record['refusal']))}")
    if not isinstance(record, dict) or any(record.get(name) is None for name in _NEEDED):
        raise InputError(f"pose {path} has no pose; {_EXPECTED}")
    numbers = _pose_numbers(record, path)
    projection.check_fov_deg(numbers["fov_deg"])
    if any(numbers["wander"]) and not projection.is_panorama:
        raise InputError(
            f"pose {path} is of a panorama, which {photo} does not note; give --projection"
        )
    return numbers


def _pose_numbers(record: dict[str, Any], path: Path) -> dict[str, Any]:
    """Return the numbers of a pose in a file; raises `InputError` for values that no camera has."""
    names = (*_NEEDED, "pitch_deg", "roll_deg", "distortion", "eye_elevation_m")
    given = {name: record[name] for name in names if record.get(name) is not None}
    wander = record.get("wander") or []
    if not isinstance(wander, list) or len(wander) not in {0, len(WANDER_DEGREES)}:
        raise InputError(
            f"pose {path}: wander is {str(wander)[:40]}; expected a list of {len(WANDER_DEGREES)} "
            "numbers, or none"
        )
    for name, value in (*given.items(), *(("wander", value) for value in wander)):
        if not isinstance(value, float) or not math.isfinite(value):
            raise InputError(f"pose {path}: {name} is {str(value)[:40]}; expected a number")
    if abs(given.get("distortion", 0.0)) > MOST_DISTORTION:
        raise InputError(
            f"pose {path}: distortion is {given['distortion']:g}; expected {-MOST_DISTORTION:g} to "
            f"{MOST_DISTORTION:g}"
        )
    lon, lat = given["lon"], given["lat"]
    if not are_degrees(lon, lat):
        raise InputError(f"pose {path}: the place is {lon:g},{lat:g}; expected degrees (WGS 84)")
    return given | {"wander": tuple(wander)}


def _oriented(photo: Path, query: PhotoSkyline, place: Place, viewer: Viewer) -> Pose:
    """Return the camera's pose at a known place; `InputError` where it cannot be trusted."""
    with orienters(viewer.terrain) as orienter_at:
        held = orienter_at(place).orient(query, name=str(photo))
    if held.answer is None:
        raise InputError(
            f"{photo}: the camera's direction is not sure ({held.refusal}); give its pose with "
            "--pose"
        )
    for line in held.to_text().splitlines():
        print_note(line)
    return held.answer


def _camera(record: dict[str, Any], viewer: Viewer) -> Pose:
    """Return the pose of a record; without an elevation the eye stands on the ground.

    An eye lower than a camera is held is lifted, and a line says so.
    """
    given = {name: record[name] for name in (*_NEEDED, "pitch_deg", "roll_deg") if name in record}
    others = {name: record[name] for name in record if name not in given}
    standing = viewer.pose(**given)
    if "eye_elevation_m" not in others:
        return replace(standing, **others)
    check_eye_elevation(others["eye_elevation_m"], standing.eye_elevation_m)
    pose = replace(standing, **others)
    held = viewer.held(pose)
    height_m = LEAST_EYE_HEIGHT_M - (held.eye_elevation_m - pose.eye_elevation_m)
    if height_m < LEAST_EYE_HEIGHT_M - _ROUNDED_M:
        side = "below" if height_m < -_ROUNDED_M else "above"
        print_note(
            f"the pose's eye is {abs(height_m):.1f} m {side} the ground of the DEM, lower than a "
            f"camera is held; it is lifted to {LEAST_EYE_HEIGHT_M:g} m above it"
        )
    return held

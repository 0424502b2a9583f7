"""A photo's vectors on the map, and the map's in a photo."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline.errors import InputError, suffix_of
from skyline.files.disk import check_outputs, write_whole
from skyline.files.gdal_names import on_disk
from skyline.files.geojson import GEOJSON
from skyline.files.shapes import Vectors
from skyline.files.vectors import read_vectors
from skyline.ground.ground_shapes import GroundShape, Jump, Measure, in_photo, on_ground
from skyline.ground.ground_view import GroundErrors, GroundView
from skyline.photo.photo import Photo
from skyline.report.vector_files import MAP_FILES, write_in_photo, write_on_map
from skyline.tasks.label import LABEL_FILES
from skyline.tasks.listener import Listener
from skyline.tasks.photo_task import PosedTask
from skyline.tasks.standing import assumed_lines, shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.terrain.dem_files import dem_names
from skyline.terrain.viewpoints import swap_hint
from skyline.view.viewer import Viewer

PHOTO_FILES = tuple(dict.fromkeys([*GEOJSON, *LABEL_FILES]))
"""Suffixes of shapes in a photo: in its pixels, or drawn on it."""
_MOST_LINES = 20
"""Most shapes for which a line is printed."""
DRAWN_FILES = tuple(dict.fromkeys([*MAP_FILES, *PHOTO_FILES]))


@dataclass(frozen=True, slots=True, kw_only=True)
class DrawTask(PosedTask):
    """A photo, its camera's pose, vectors, and the file to write."""

    vectors: Path
    """Vectors of the photo, or of the map."""
    output: Path
    """File of the kinds of `MAP_FILES` for vectors of the photo, else of `PHOTO_FILES`."""
    in_pixels: bool = False
    """Whether GeoJSON is in pixels even if it does not say so."""
    errors: GroundErrors = GroundErrors()  # noqa: RUF009  (it is frozen)


def draw_vectors(task: DrawTask, listener: Listener) -> list[str]:
    """Write a photo's vectors on the map, or the map's in it.

    Returns lines about it. Raises `InputError` for an output of another kind, for vectors or a pose
    that do not belong to the photo, for vertices in the sky, and if nothing of the map is in the
    photo; and as `read_vectors` and `read_pose`.
    """
    suffix = suffix_of(task.output, DRAWN_FILES)
    names = dem_names(task.dem)
    inputs = [task.photo, task.pose, task.vectors, *map(Path, map(on_disk, names))]
    check_outputs([task.output], inputs)
    photo, noted = task.read()
    vectors = read_vectors(task.vectors, task.photo, task.in_pixels)
    _check_kind(task, vectors, suffix)
    if vectors.of_qgis:
        photo.check_upright(task.vectors)
    if vectors.in_pixels:
        vectors.check_photo(task.photo, photo.width_px, photo.height_px)
    terrain = read_terrain(listener, names, task.crs)
    with Viewer(terrain) as viewer:
        pose = shown_pose(noted, viewer, listener)
        view = viewer.ground_view(pose, photo)
        if not vectors.in_pixels:
            with listener.slow("drawing the map into the photo"):
                return _into_photo(task, vectors, view, photo, suffix)
        with listener.progress("following rays") as progress:
            found = []
            for number, shape in enumerate(vectors.shapes, start=1):
                found.append(on_ground(view, shape, viewer.frame, task.errors))
                progress(number, len(vectors.shapes))
    write_on_map(task.output, found, viewer.frame, task.photo)
    lines = [f"{task.output}: {_counted(len(found))} on the map", *_lines(found)]
    return lines + assumed_lines(pose.assumed(photo))


def _check_kind(task: DrawTask, vectors: Vectors, suffix: str) -> None:
    """Raise `InputError` for an output that does not suit the vectors."""
    known = MAP_FILES if vectors.in_pixels else PHOTO_FILES
    if suffix not in known:
        whose, goes = ("photo", "onto the map") if vectors.in_pixels else ("map", "into the photo")
        other = "" if vectors.in_pixels else ", or give --pixels if they are of the photo"
        raise InputError(
            f"{task.vectors} has vectors of the {whose}, which go {goes}, but {task.output} is "
            f"another kind of file; name a file with the suffix {', '.join(known)}{other}"
        )


def _into_photo(
    task: DrawTask, vectors: Vectors, view: GroundView, photo: Photo, suffix: str
) -> list[str]:
    """Write vectors of the map in the photo; return lines about it."""
    shapes = [in_photo(view, shape, view.terrain.frame) for shape in vectors.shapes]
    parts = [one.parts(photo.width_px, photo.height_px) for one in shapes]
    if not any(parts):
        lon, lat = np.concatenate([one.vertices for one in vectors.shapes]).T
        raise InputError(
            f"{task.vectors}: nothing of it is in the photo; give vectors of what the camera saw, "
            f"or a DEM that holds them{swap_hint(view.terrain, lon, lat)}"
        )
    if suffix in GEOJSON:
        write_in_photo(task.output, shapes, task.photo, photo)
    else:
        from skyline.report.overlay import draw_shapes  # noqa: PLC0415  (slow to load)

        write_whole(task.output, draw_shapes(photo, photo.rgb, shapes, LABEL_FILES[suffix]))
    seen = sum(any(not hidden for _, hidden in some) for some in parts)
    hidden = sum(bool(some) for some in parts) - seen
    outside = len(parts) - seen - hidden
    return [
        f"{task.output}: {_counted(len(parts))} of the map; seen {seen}, hidden {hidden}, outside "
        f"the photo {outside}"
    ]


def _counted(number: int) -> str:
    return "1 shape" if number == 1 else f"{number} shapes"


def _lines(found: Sequence[GroundShape]) -> list[str]:
    """Return lines on a few shapes, on jumps and on grazing views."""
    lines = [f"  {one.shape.where}: {_in_words(one)}" for one in found[:_MOST_LINES]]
    if len(found) > _MOST_LINES:
        lines.append(f"  and {len(found) - _MOST_LINES} more")
    jumps = [(one.shape.where, one.jump) for one in found if one.jump is not None]
    if jumps:
        lines.append(f"  {_counted(len(jumps))} {_jumping(*jumps[0], len(jumps))}")
    grazing = np.concatenate([one.vertices.is_grazing for one in found])
    if grazing.any():
        lines.append(
            f"  {grazing.sum()} of {len(grazing)} vertices are seen at a grazing angle: a metre of "
            "height moves them by 20 m or more"
        )
    return lines


def _jumping(where: str, jump: Jump, number: int) -> str:
    """Say how many shapes jump, and where one of them does."""
    return (
        f"jump{'s' if number == 1 else ''} over an edge, {where} from {jump.near_m:.0f} to "
        f"{jump.far_m:.0f} m away at column {jump.column_px:.0f}, row {jump.row_px:.0f}: the model "
        "hides the ground between, and lengths and areas hold the jump"
    )


def _in_words(one: GroundShape) -> str:
    vertices = one.vertices
    error = f"+- {_rounded(float(np.median(vertices.error_m)))} m"
    if one.length is None:
        return (
            f"{vertices.distance_m[0]:.0f} m away, {vertices.elevation_m[0]:.0f} m high, "
            f"its place {error}"
        )
    length = f"{_with_error(one.length)} m"
    if one.area is None:
        return f"{length} long, its vertices {error}"
    return f"{_with_error(one.area)} m2, {length} around, its vertices {error}"


def _with_error(measure: Measure) -> str:
    """Return a figure and its standard error, to the error's two digits."""
    return f"{_rounded(measure.value, measure.sd)} +- {_rounded(measure.sd)}"


def _rounded(value: float, error: float | None = None) -> str:
    """Return a number rounded to two digits of itself or its error."""
    size = abs(value if error is None else error)
    decimals = 1 - math.floor(math.log10(size)) if size > 0.0 else 2
    return f"{round(value, decimals):.{max(decimals, 0)}f}"

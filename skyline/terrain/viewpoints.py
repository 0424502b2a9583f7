"""Viewpoints: positions of eyes on a height field.

They are given as arrays or in a CSV file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import (
    BoolArray,
    Float64Array,
    Int64Array,
    Rows,
    UInt8Array,
    by_dimensions,
    refuse_text,
)
from skyline.errors import InputError, OffMapError, one_line, printable, swapped_in_words
from skyline.files.tables import Table, read_table
from skyline.geodesy.bounds import are_degrees, distance_in_words
from skyline.geodesy.earth import GROUND_M
from skyline.geodesy.map_frame import in_rectangle
from skyline.skylines import HEADINGS
from skyline.terrain.heightfield import HeightField
from skyline.terrain.summits import highest_within, summit_heights_m

DEFAULT_EYE_HEIGHT_M = 2.0
"""Height above ground of a camera in the hands of a standing person."""

LEAST_EYE_HEIGHT_M = 0.3
"""Height above ground of a camera on a very low tripod, or in the hands of a person lying down. An
eye that seems lower stands where the terrain model is too high."""

IN_FLIGHT_M = 120.0
"""Drones may fly up to this height above ground. A greater one is often an elevation, given by
mistake."""

HIGHEST_EYE_M = 20_000.0
"""Greatest elevation of an eye, above all aeroplanes with passengers."""
_ROUNDING_M = 1e-3
"""Rounding error of degrees with eight decimals, as files have them."""
_POSITIONS = (("easting", "northing"), ("lon", "lat"))
_HEIGHTS = ("eye_height_m", "eye_elevation_m")
_LABELS = ("id", "name")
_EXPECTED = (
    "expected a header `lon,lat` or `easting,northing`, and optionally `eye_height_m` (above "
    "ground) or `eye_elevation_m` (above the datum), and `id` or `name`"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Viewpoints(Rows):
    """N eyes in a DEM's frame.

    Attributes
    ----------
    easting_m : (N,) float64
    northing_m : (N,) float64
    eye_elevation_m : (N,) float64
        Metres above the DEM's datum (not above ground).
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array


def in_four_views(viewpoints: Viewpoints) -> tuple[Viewpoints, UInt8Array]:
    """Return each eye four times, and its views' headings.

    Headings (4 N,) run from north to west.
    """
    count = len(viewpoints)
    heading = np.tile(np.array(HEADINGS, dtype=np.uint8), count)
    return viewpoints[np.repeat(np.arange(count), len(HEADINGS))], heading


def stand_on(
    field: HeightField,
    *,
    easting_m: ArrayLike,
    northing_m: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
    summit_within_m: float | None = 0.0,
) -> Viewpoints:
    """Place eyes at a height above the surface of a height field.

    Parameters
    ----------
    easting_m, northing_m : array_like, broadcast to (N,), metres in the field's frame
    eye_height_m : array_like, metres above ground, at least 0
    summit_within_m : float or None
        Eyes move to the highest point within this distance. None moves no eye, but lifts each one
        that is within a sample's spacing of a summit of the model to the summit's height
        (`skyline.terrain.summits.summit_heights_m`).

    Raises
    ------
    OffMapError
        A location is off the map or on a hole, or an eye height is below 0.
    InputError
        ``summit_within_m`` is not from 0 to 10,000 m.
    """
    easting, northing, eye_height = _flat(
        easting_m=easting_m, northing_m=northing_m, eye_height_m=eye_height_m
    )
    _check_heights(eye_height)
    refuse_text(summit_within_m=summit_within_m)
    given = easting, northing
    if summit_within_m is not None and not 0.0 <= summit_within_m <= 10_000.0:
        raise InputError(f"summits are searched within {summit_within_m:g} m; expected 0 to 10000")
    if summit_within_m:
        highest = [
            highest_within(field, *position, summit_within_m)
            for position in zip(easting.tolist(), northing.tolist(), strict=True)
        ]
        easting, northing = np.array(highest).reshape(-1, 2).T.copy()
    ground = field.height_at(easting_m=easting, northing_m=northing)
    missing = np.flatnonzero(np.isnan(ground))
    if missing.size:
        raise _no_ground(field, missing, *given)
    if summit_within_m is None:
        ground = np.fmax(ground, summit_heights_m(field, easting, northing))
    return Viewpoints(easting_m=easting, northing_m=northing, eye_elevation_m=ground + eye_height)


def stand_at(
    field: HeightField,
    *,
    lon: ArrayLike,
    lat: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
    summit_within_m: float | None = None,
) -> Viewpoints:
    """Place eyes at longitudes and latitudes (WGS 84).

    Parameters and errors are as in `stand_on`. By default an eye beside a summit of the model is
    lifted to the summit's height.
    """
    easting_m, northing_m = position_on(field, lon, lat)
    return stand_on(
        field,
        easting_m=easting_m,
        northing_m=northing_m,
        eye_height_m=eye_height_m,
        summit_within_m=summit_within_m,
    )


def stand_at_one(
    field: HeightField,
    *,
    lon: float,
    lat: float,
    eye_height_m: float,
    summit_within_m: float | None = None,
) -> Viewpoints:
    """Place a single eye, as `stand_at`; raises `InputError` for several."""
    eye = stand_at(
        field, lon=lon, lat=lat, eye_height_m=eye_height_m, summit_within_m=summit_within_m
    )
    if len(eye) != 1:
        raise InputError(f"{len(eye)} places are given; expected one: call this for each of them")
    return eye


def position_on(
    field: HeightField, lon_deg: ArrayLike, lat_deg: ArrayLike
) -> tuple[Float64Array, Float64Array]:
    """Return easting and northing of positions given in degrees.

    Longitudes and latitudes are on WGS 84; the result has shape (N,). Raises `OffMapError` for a
    position off the map.
    """
    lon, lat = _flat(lon=lon_deg, lat=lat_deg)
    easting, northing = _onto_border(field, *field.frame.from_lonlat(lon, lat))
    outside = np.flatnonzero(~is_on_map(field, easting, northing))
    if outside.size:
        first = outside[0]
        box = field.box_deg
        away_m = _past_border_m(field, float(easting[first]), float(northing[first]))
        # Far away a place may have no position on the map.
        away = f"{distance_in_words(away_m)} " if math.isfinite(away_m) else ""
        remedy = "give another place, or a DEM that covers it"
        if not are_degrees(lon[first], lat[first]):
            remedy = "give degrees, not eastings and northings"
        elif is_on_map(field, *field.frame.from_lonlat(lat[first], lon[first])):
            remedy = swapped_in_words(lon[first], lat[first])
        raise OffMapError(
            f"{_first_of(outside, len(lon))} at lon {lon[first]:.5f}, lat {lat[first]:.5f} is "
            f"{away}off the map; the corners of the DEM lie within lon "
            f"{box[0]:.4f} to {box[2]:.4f}, lat {box[1]:.4f} to {box[3]:.4f}: {remedy}"
        )
    return easting, northing


def swap_hint(field: HeightField, lon: Float64Array, lat: Float64Array) -> str:
    """Return a hint that longitudes and latitudes (N,) are swapped, or "".

    They are if no place lies on the map, and one does with the other order.
    """
    frame = field.frame
    swapped = np.flatnonzero(is_on_map(field, *frame.from_lonlat(lat, lon)))
    if not swapped.size or is_on_map(field, *frame.from_lonlat(lon, lat)).any():
        return ""
    return f"; {swapped_in_words(lon[swapped[0]], lat[swapped[0]])}"


def stand_where_possible(
    field: HeightField, easting_m: ArrayLike, northing_m: ArrayLike
) -> tuple[Viewpoints, BoolArray]:
    """Place eyes 2 m above ground, where there is ground.

    Returns the eyes, and a mask of the locations (N,) where they stand.
    """
    easting, northing = _flat(easting_m=easting_m, northing_m=northing_m)
    ground = field.height_at(easting_m=easting, northing_m=northing)
    stands = ~np.isnan(ground)
    elevation = ground + DEFAULT_EYE_HEIGHT_M
    eyes = Viewpoints(easting_m=easting, northing_m=northing, eye_elevation_m=elevation)
    return eyes[stands], stands


def at_elevation(
    field: HeightField, easting_m: ArrayLike, northing_m: ArrayLike, eye_elevation_m: ArrayLike
) -> Viewpoints:
    """Place eyes at elevations above the datum; otherwise as `stand_on`."""
    easting, northing, eye_elevation = _flat(
        easting_m=easting_m, northing_m=northing_m, eye_elevation_m=eye_elevation_m
    )
    ground = stand_on(field, easting_m=easting, northing_m=northing, eye_height_m=0.0)
    _check_heights(eye_elevation - ground.eye_elevation_m)
    return Viewpoints(easting_m=easting, northing_m=northing, eye_elevation_m=eye_elevation)


def check_eye_elevation(eye_elevation_m: float, ground_m: float) -> None:
    """Raise an error if an eye's elevation is impossible.

    ``ground_m`` is the elevation of the lowest ground where the eye may stand. Raises `InputError`
    outside -500 to 20,000 m (or 200 m below the ground to 1,000 m above it, on worlds where that is
    lower or higher), and `OffMapError` more than 200 m below the ground: vertical datums
    differ by up to 100 m, and models err as much beside cliffs.
    """
    lowest_m = min(GROUND_M[0], ground_m - 200.0)
    highest_m = max(HIGHEST_EYE_M, ground_m + 1000.0)
    if not lowest_m <= eye_elevation_m <= highest_m:
        raise InputError(
            f"the eye's elevation is {eye_elevation_m:g} m; expected metres above the DEM's datum, "
            f"{lowest_m:g} to {highest_m:g}"
        )
    if eye_elevation_m < ground_m - 200.0:
        raise OffMapError(
            f"the eye's elevation is {eye_elevation_m:g} m, and the ground of the DEM lies at "
            f"{ground_m:.0f} m there; expected metres above the DEM's datum: correct it, or leave "
            "it out"
        )


def _no_ground(
    field: HeightField, missing: Int64Array, easting_m: Float64Array, northing_m: Float64Array
) -> OffMapError:
    """Return the error for viewpoints without ground to stand on."""
    first = missing[0]
    easting = easting_m[first]
    northing = northing_m[first]
    lon, lat = field.frame.to_lonlat(easting, northing)
    place = (
        f"{_first_of(missing, len(easting_m))} at lon {lon:.5f}, lat {lat:.5f} (easting "
        f"{easting:.2f}, northing {northing:.2f}) is"
    )
    if is_on_map(field, easting, northing):
        return OffMapError(f"{place} on a hole of the DEM: move it or remove it")
    west, south, east, north = field.bounds_m
    remedy = "move it or remove it"
    if is_on_map(field, northing, easting):
        remedy = swapped_in_words(easting, northing, names="easting and northing")
    return OffMapError(
        f"{place} off the map; the DEM covers easting {west:.1f} to {east:.1f}, northing "
        f"{south:.1f} to {north:.1f}: {remedy}"
    )


def _first_of(failing: Int64Array, count: int) -> str:
    """Return words for the first failing viewpoint of ``count``."""
    return "the place" if count == 1 else f"viewpoint {failing[0]} ({failing.size} such)"


def _onto_border(
    field: HeightField, easting_m: Float64Array, northing_m: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return positions, moved onto the border if rounding put them off.

    Otherwise the outermost samples, whose degrees are rounded, would be off their own map.
    """
    west, south, east, north = field.bounds_m
    inside = np.clip(easting_m, west, east), np.clip(northing_m, south, north)
    is_rounding = np.hypot(inside[0] - easting_m, inside[1] - northing_m) < _ROUNDING_M
    easting, northing = np.where(is_rounding, inside, (easting_m, northing_m))
    return easting, northing


def _past_border_m(field: HeightField, easting_m: float, northing_m: float) -> float:
    """Return how far a position lies outside a map."""
    west, south, east, north = field.bounds_m
    return math.hypot(
        max(west - easting_m, easting_m - east, 0.0),
        max(south - northing_m, northing_m - north, 0.0),
    )


def is_on_map(field: HeightField, easting_m: ArrayLike, northing_m: ArrayLike) -> BoolArray:
    """Return a mask of the positions that lie on a map."""
    return in_rectangle(field.bounds_m, easting_m, northing_m)


def broadcast(**values: ArrayLike) -> list[Float64Array]:
    """Return named values broadcast together.

    Arrays of xarray are broadcast by the names of their dimensions, all others by position. Raises
    `InputError` unless the values are finite numbers.
    """
    refuse_text(**values)
    try:
        numbers = [
            np.ma.filled(np.asanyarray(v, dtype=np.float64), np.nan)
            for v in by_dimensions(*values.values())
        ]
        arrays = np.broadcast_arrays(*numbers)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"coordinates and heights of places cannot be used ({one_line(error)}); "
            "expected numbers, as many latitudes as longitudes"
        ) from error
    for name, array in zip(values, arrays, strict=True):
        unknown = np.flatnonzero(~np.isfinite(array))
        if unknown.size:
            raise InputError(
                f"{name} of {_first_of(unknown, array.size)} is masked or not a finite number; "
                "correct it, or leave the place out"
            )
    return list(arrays)


def _flat(**values: ArrayLike) -> list[Float64Array]:
    """Return values broadcast to (N,); raises as `broadcast`."""
    return [np.ascontiguousarray(array).reshape(-1) for array in broadcast(**values)]


def _check_heights(eye_height_m: Float64Array) -> None:
    """Raise `OffMapError` for an eye below the ground."""
    # A micrometre is rounding.
    below = np.flatnonzero(eye_height_m < -1e-6)
    if below.size:
        raise OffMapError(
            f"the eye at {_first_of(below, len(eye_height_m))} is "
            f"{-eye_height_m[below[0]]:.2f} m below the ground; raise it to the ground or above"
        )


def read_viewpoints(
    path: str | Path,
    field: HeightField,
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M,
    summit_within_m: float | None = 0.0,
) -> tuple[Viewpoints, tuple[str, ...]]:
    """Read viewpoints with their labels from a CSV file.

    The CSV has a header: ``easting,northing`` in the field's frame or ``lon,lat`` in degrees
    (WGS 84), and optionally ``eye_height_m`` or, in other rows, ``eye_elevation_m``, and ``id`` or
    ``name``, which become labels; without either column there are none. ``eye_height_m`` is for
    rows without a height or an elevation, ``summit_within_m`` (as in `stand_on`) for rows without
    an elevation.

    Raises `MissingFileError` or `InputError` if the file does not exist or has no rows, the columns
    are wrong, a row has both a height and an elevation, or a value is not a number; otherwise as
    `stand_on`.
    """
    table = read_table(path, _EXPECTED)
    position = table.first_in(*_POSITIONS, expected=_EXPECTED)
    table.refuse_other(*position, *_HEIGHTS, *_LABELS)
    if not table.rows:
        raise InputError(f"{path} has a header but no viewpoints; give one row for each viewpoint")
    first, second = (np.array([row.number(name) for row in table.rows]) for name in position)
    labels = (
        tuple(printable(row.label) for row in table.rows) if {*_LABELS} & {*table.header} else ()
    )
    if position == ("lon", "lat"):
        first, second = position_on(field, first, second)
    elif is_on_map(field, *field.frame.from_lonlat(first, second)).all():
        # Read as metres they would lie in the middle of a local frame, unnoticed.
        raise InputError(f"{path} has eastings and northings in degrees; name the columns lon,lat")
    height_m, elevation_m = (_optional(table, name) for name in _HEIGHTS)
    is_high = np.isfinite(elevation_m)
    if is_high.all():
        return at_elevation(field, first, second, elevation_m), labels
    stood = stand_on(
        field,
        easting_m=first,
        northing_m=second,
        eye_height_m=np.where(np.isnan(height_m), eye_height_m, height_m),
        summit_within_m=summit_within_m,
    )
    if is_high.any():
        aloft = at_elevation(field, first[is_high], second[is_high], elevation_m[is_high])
        for name in ("easting_m", "northing_m", "eye_elevation_m"):
            getattr(stood, name)[is_high] = getattr(aloft, name)
    return stood, labels


def _optional(table: Table, column: str) -> Float64Array:
    """Return a column's numbers (N,); NaN where empty or missing.

    Raises `InputError` for a row that fills more than one column of `_HEIGHTS`.
    """
    for row in table.rows:
        if all(row[name] for name in _HEIGHTS):
            raise InputError(f"{row.where} has {' and '.join(_HEIGHTS)}; expected one of them")
    return np.array([row.number(column) if row[column] else np.nan for row in table.rows])

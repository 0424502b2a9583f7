"""Viewpoints: where eyes are, as arrays, and from a CSV file."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError, MissingFileError, OffMapError
from skyline.row_arrays import Rows
from skyline.terrain.heightfield import HeightField

DEFAULT_EYE_HEIGHT_M = 2.0

_PLACES = (("easting", "northing"), ("lon", "lat"))
_EYES = ("eye_height_m", "eye_elevation_m")
_EXPECTED = (
    "expected a header `easting,northing` or `lon,lat`, and at most one of `eye_height_m` (above "
    "ground) and `eye_elevation_m` (above the datum)"
)


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoints(Rows):
    """N eyes in a DEM's frame.

    Attributes
    ----------
    easting_m, northing_m : (N,) float64
    eye_elevation_m : (N,) float64
        Metres above the DEM's datum (not above ground).
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array


def stand_on(
    field: HeightField,
    easting_m: ArrayLike,
    northing_m: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
) -> Viewpoints:
    """Place eyes on the surface plus an eye height.

    Parameters
    ----------
    easting_m, northing_m : array_like, broadcast to (N,), metres
    eye_height_m : array_like, metres above ground, at least 0

    Raises
    ------
    OffMapError
        A location off the map or on a hole, or an eye height below 0.
    """
    easting, northing, eye_height = _flat(easting_m, northing_m, eye_height_m)
    eyes, stands = stand_where_possible(field, easting, northing, eye_height)
    missing = np.flatnonzero(~stands)
    if missing.size:
        first = missing[0]
        west, south, east, north = field.bounds_m
        inside = west <= easting[first] <= east and south <= northing[first] <= north
        place = "on a hole of the DEM" if inside else "off the map"
        lon, lat = field.frame.to_lonlat(easting[first], northing[first])
        raise OffMapError(
            f"viewpoint {first} (lon {lon:.5f}, lat {lat:.5f}; easting {easting[first]:.2f}, "
            f"northing {northing[first]:.2f}) is {place}; the DEM covers easting {west:.1f} "
            f"to {east:.1f}, northing {south:.1f} to {north:.1f}: move it "
            f"or remove it ({missing.size} such)"
        )
    return eyes


def stand_where_possible(
    field: HeightField,
    easting_m: ArrayLike,
    northing_m: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
) -> tuple[Viewpoints, BoolArray]:
    """Place eyes as `stand_on` does, but leave out locations off the map or on a hole.

    Returns the eyes, and at which of the locations (N,) they stand. Raises `OffMapError` for an eye
    height below 0.
    """
    easting, northing, eye_height = _flat(easting_m, northing_m, eye_height_m)
    _check_heights(eye_height)
    ground = field.height_at(easting, northing)
    stands = ~np.isnan(ground)
    return Viewpoints(easting, northing, ground + eye_height)[stands], stands


def at_elevation(
    field: HeightField, easting_m: ArrayLike, northing_m: ArrayLike, eye_elevation_m: ArrayLike
) -> Viewpoints:
    """Place eyes at elevations above the datum; as `stand_on` otherwise."""
    easting, northing, eye_elevation = _flat(easting_m, northing_m, eye_elevation_m)
    _check_heights(eye_elevation - stand_on(field, easting, northing, 0.0).eye_elevation_m)
    return Viewpoints(easting, northing, eye_elevation)


def _flat(*values: ArrayLike) -> list[Float64Array]:
    arrays = np.broadcast_arrays(*[np.atleast_1d(np.asarray(v, dtype=np.float64)) for v in values])
    flat = [np.ascontiguousarray(array).reshape(-1) for array in arrays]
    if not all(np.isfinite(array).all() for array in flat):
        raise InputError("a viewpoint has a coordinate that is not a finite number")
    return flat


def _check_heights(eye_height_m: Float64Array) -> None:
    below = np.flatnonzero(eye_height_m < 0.0)
    if below.size:
        first = below[0]
        raise OffMapError(
            f"viewpoint {first} has its eye {-eye_height_m[first]:.2f} m below the ground; raise "
            f"the eye to the ground or above ({below.size} such)"
        )


def read_viewpoints(
    path: str | Path, field: HeightField, eye_height_m: float = DEFAULT_EYE_HEIGHT_M
) -> Viewpoints:
    """Read viewpoints and place their eyes on a height field.

    Parameters
    ----------
    path : str or Path
        CSV with a header: ``easting,northing`` in the field's frame or ``lon,lat`` in degrees
        (WGS 84), and optionally ``eye_height_m`` or ``eye_elevation_m``.
    eye_height_m : float
        Metres above ground where the file does not say.

    Raises
    ------
    MissingFileError, InputError
        No such file; wrong columns; a value that is not a number; no rows.
    OffMapError
        A viewpoint off the map, on a hole, or with its eye below the ground.
    """
    columns = _read_columns(Path(path))
    places = next((pair for pair in _PLACES if set(pair) <= columns.keys()), None)
    eyes = [name for name in _EYES if name in columns]
    unknown = columns.keys() - set(places or ()) - set(eyes)
    if places is None or unknown or len(eyes) > 1:
        raise InputError(f"{path}: columns are `{','.join(columns)}`; {_EXPECTED}")
    first, second = columns[places[0]], columns[places[1]]
    if places == ("lon", "lat"):
        first, second = field.frame.from_lonlat(first, second)
    if eyes == ["eye_elevation_m"]:
        return at_elevation(field, first, second, columns["eye_elevation_m"])
    return stand_on(field, first, second, columns.get("eye_height_m", eye_height_m))


def _read_columns(path: Path) -> dict[str, Float64Array]:
    """Return the file's columns of numbers by name."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row and any(cell.strip() for cell in row)]
    except FileNotFoundError as error:
        raise MissingFileError(f"viewpoint file {path} does not exist; check the path") from error
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} cannot be read as CSV ({error}); {_EXPECTED}") from error
    if not rows:
        raise InputError(f"{path} is empty; {_EXPECTED} and one row a viewpoint")
    header = [name.strip() for name in rows[0]]
    if len(rows) == 1:
        raise InputError(f"{path} has a header but no viewpoints; give one row a viewpoint")
    values = np.empty((len(rows) - 1, len(header)))
    for number, row in enumerate(rows[1:]):
        try:
            values[number] = [float(cell) for _, cell in zip(header, row, strict=True)]
        except ValueError as error:
            raise InputError(
                f"{path}, row {number + 1} after the header is `{','.join(row)[:80]}`; expected "
                f"{len(header)} numbers for `{','.join(header)}`"
            ) from error
    return dict(zip(header, values.T, strict=True))

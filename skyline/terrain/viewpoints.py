"""Viewpoints: where eyes are, as arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError, OffMapError
from skyline.rows import Rows
from skyline.terrain.heightfield import HeightField

DEFAULT_EYE_HEIGHT_M = 2.0


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

    def __len__(self) -> int:
        return len(self.easting_m)


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

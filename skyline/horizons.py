"""Horizons: the skylines of many eyes all the way round, in equal steps of azimuth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.errors import InputError
from skyline.row_arrays import Rows


def check_bins(bins: int) -> int:
    """Return ``bins`` if a turn can be cut into so many steps, else raise `InputError`."""
    if bins < 8 or bins % 8:
        raise InputError(f"{bins} azimuth bins; expected a positive multiple of 8")
    return bins


def bin_azimuths_rad(bins: int) -> Float64Array:
    """Return the grid azimuths (B,) of the bins' centres, radians clockwise from north.

    Bin b is centred at 360 (b + 1/2) / B degrees, so that a quarter of the bins lies wholly in
    each of the four 90 degree views.
    """
    return np.asarray((np.arange(bins) + 0.5) * (2.0 * np.pi / bins), dtype=np.float64)


def quadrant_azimuths_rad(bins: int) -> Float64Array:
    """Return the azimuths (B/4,) of a quadrant's bins from its axis, increasing, in radians.

    Those of heading h are bins h B/4 - B/8 to h B/4 + B/8 - 1, modulo B.
    """
    steps = np.arange(bins // 4) + 0.5 - bins / 8
    return np.asarray(steps * (2.0 * np.pi / bins), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Horizons(Rows):
    """The skylines of N eyes in B bins of azimuth: `bin_azimuths_rad`, unless others were asked."""

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    """``easting_m``, ``northing_m``, ``eye_elevation_m``: (N,) float64. The eye, in the DEM's frame
    and above its datum."""
    elevation_tan: Float32Array
    """(N, B) float32. Tangent of the skyline's elevation angle: up over horizontal distance. NaN
    where an azimuth meets no data."""
    distance_m: Float32Array
    """(N, B) float32. Horizontal distance of the skyline; NaN where an azimuth meets no data."""
    flags: NDArray[np.uint8]
    """(N, B) uint8. The bits of `skyline.views`: truncated, hole, no data."""

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.elevation_tan.shape[1])

"""Skylines of many eyes: in 90 degree views, and all the way round."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, FloatArray, Rows
from skyline.camera import columns_u, elevation_deg, rotation
from skyline.errors import InputError

FLAG_TRUNCATED = 1
"""The skyline lies on the border of the data."""
FLAG_HOLE = 2
"""The column passes over a hole with data behind it."""
FLAG_NO_DATA = 4
"""The column meets no data; its values are NaN."""
FLAG_OUT_OF_IMAGE = 8
"""Depth images only: the skyline lies above the image's top or below its bottom."""


@dataclass(frozen=True, slots=True, eq=False)
class Views(Rows):
    """N views of W columns each.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (N,) float64
        The eye, in the DEM's frame and above its datum.
    heading : (N,) uint8
        0, 1, 2, 3 = grid north, east, south, west.
    elevation_tan : (N, W) float32 (float64 from the oracle)
        Image-plane ordinate v of the skyline; NaN where a column meets no data.
    depth_m : (N, W) float32 (float64 from the oracle)
        Forward distance of the skyline; NaN where a column meets no data.
    flags : (N, W) uint8
        Bits `FLAG_TRUNCATED`, `FLAG_HOLE`, `FLAG_NO_DATA`, `FLAG_OUT_OF_IMAGE`.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    heading: NDArray[np.uint8]
    elevation_tan: FloatArray
    depth_m: FloatArray
    flags: NDArray[np.uint8]

    @property
    def width(self) -> int:
        """Number of columns W."""
        return int(self.elevation_tan.shape[1])

    def azimuth_deg(self) -> Float64Array:
        """Return grid azimuths of the columns, shape (N, W), degrees in [0, 360).

        `skyline.Frame.convergence_deg` plus these are the azimuths from true north.
        """
        u = columns_u(self.width)
        turn_deg = 90.0 * self.heading[:, np.newaxis].astype(np.float64)
        return np.asarray((turn_deg + np.degrees(np.arctan(u))) % 360.0, dtype=np.float64)

    def elevation_deg(self) -> Float64Array:
        """Return elevation angles of the skyline, shape (N, W), degrees."""
        return elevation_deg(self.elevation_tan.astype(np.float64), columns_u(self.width))

    def skyline_points_m(self) -> Float64Array:
        """Return the skyline's 3-D points X_i, shape (N, W, 3): east, up, north minus the eye."""
        depth = self.depth_m.astype(np.float64)
        camera = np.stack(
            [columns_u(self.width) * depth, self.elevation_tan * depth, depth], axis=-1
        )
        turns = np.stack([rotation(heading) for heading in range(4)])[self.heading]
        return np.asarray(np.einsum("nwc,nck->nwk", camera, turns), dtype=np.float64)


def check_bins(bins: int) -> int:
    """Return ``bins`` if a turn can be divided into that many, else raise `InputError`."""
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

    The quadrant of heading h has the bins h B/4 - B/8 to h B/4 + B/8 - 1, modulo B.
    """
    steps = np.arange(bins // 4) + 0.5 - bins / 8
    return np.asarray(steps * (2.0 * np.pi / bins), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Horizons(Rows):
    """The skylines of N eyes in B bins of azimuth, by default those of `bin_azimuths_rad`."""

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
    """(N, B) uint8. The bits of `skyline.skylines`: truncated, hole, no data."""

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.elevation_tan.shape[1])

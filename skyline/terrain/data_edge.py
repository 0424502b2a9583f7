"""The edge of a DEM's data, and the terrain beyond it.

Terrain that the DEM lacks may rise above the skyline: this module bounds how high.
"""

from dataclasses import dataclass
from math import ceil
from typing import Self

import numpy as np

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Rectangle
from skyline.terrain.heightfield import HeightField

BAND_M = 10_000.0
"""Terrain past a point of the edge is assumed to be no higher than the terrain within this distance
inside it."""

PARTS = 256
"""Number of parts of each side of a DEM, each with a greatest height of its own."""

LEAST_SIDE_M = 1.0
"""Least distance of an eye from the edge, and least length of a side: a DEM may be one sample
wide."""


@dataclass(frozen=True, slots=True, eq=False)
class DataEdge:
    """The rectangle of a DEM, and the greatest heights beyond.

    Holes within the rectangle are ignored.
    """

    bounds_m: Rectangle
    """West, south, east and north of the outermost samples."""
    highest_m: Float32Array
    """(4, P) float32. Greatest height of terrain past each of P equal parts of the sides: west,
    south, east, north. The parts run from south to north and from west to east."""
    curvature: Curvature
    """The drop of terrain with distance."""

    @classmethod
    def of(cls, terrain: HeightField, curvature: Curvature) -> Self:
        """Return the edge of a DEM.

        Ranges beyond it are assumed to be as high as inside.
        """
        cols = ceil(BAND_M / terrain.spacing_east_m)
        rows = ceil(BAND_M / terrain.spacing_north_m)
        every = slice(None)
        highest_m = np.stack(
            [
                _highest(terrain.part(every, slice(cols))[::-1].T, rows),
                _highest(terrain.part(slice(-rows, None), every), cols),
                _highest(terrain.part(every, slice(-cols, None))[::-1].T, rows),
                _highest(terrain.part(slice(rows), every), cols),
            ]
        )
        known = np.where(np.isfinite(highest_m), highest_m, terrain.height_range_m[1])
        return cls(terrain.bounds_m, known.astype(np.float32), curvature)

    def elevation_tan(
        self,
        easting_m: FloatArray,
        northing_m: FloatArray,
        eye_elevation_m: FloatArray,
        azimuth_rad: FloatArray,
    ) -> FloatArray:
        """Return the greatest elevation tangent of terrain past the edge.

        An eye above the terrain's greatest height sees ground of that height best at its horizon,
        not at the edge. The arguments broadcast; azimuths are from grid north, positions lie inside
        the edge. float32 arguments give a float32 result, for speed.
        """
        distance_m, highest_m = self._leaving(easting_m, northing_m, azimuth_rad)
        above_m = highest_m - np.asarray(eye_elevation_m)
        drop = self.curvature.drop_per_m2
        if drop > 0.0:
            distance_m = np.maximum(distance_m, self.curvature.horizon_m(-above_m))
            return np.asarray(above_m / distance_m - drop * distance_m)
        # On a flat Earth terrain below the eye rises towards its level with distance, without end.
        return np.asarray(np.where(above_m > 0.0, above_m / distance_m, 0.0))

    def _leaving(
        self, easting_m: FloatArray, northing_m: FloatArray, azimuth_rad: FloatArray
    ) -> tuple[FloatArray, Float32Array]:
        """Return where rays leave the data, and the heights beyond."""
        west, south, east, north = self.bounds_m
        width_m = east - west
        length_m = north - south
        # The position from the middle of the rectangle.
        east_m = easting_m - (west + east) / 2.0
        north_m = northing_m - (south + north) / 2.0
        sine = np.sin(azimuth_rad)
        cosine = np.cos(azimuth_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = width_m / 2.0 / np.abs(sine) - east_m / sine
            along = length_m / 2.0 / np.abs(cosine) - north_m / cosine
        # A ray due north or south never crosses the east or west side: that distance is infinite
        # or NaN, and counts as the farther one.
        distance_m = np.fmin(across, along)
        is_across = across <= along
        share = np.where(
            is_across,
            (north_m + distance_m * cosine) / max(length_m, LEAST_SIDE_M),
            (east_m + distance_m * sine) / max(width_m, LEAST_SIDE_M),
        )
        is_far = np.where(is_across, sine, cosine) > 0.0
        parts = self.highest_m.shape[1]
        part = np.clip((share + 0.5) * parts, 0, parts - 1).astype(np.int32)
        part += (2 * is_far + ~is_across) * np.int32(parts)
        return np.maximum(distance_m, LEAST_SIDE_M), self.highest_m.ravel()[part]


def _highest(band_m: FloatArray, reach: int) -> Float64Array:
    """Return the greatest height of a band near parts of its length.

    The band is (D, N); its length N has P equal parts. Near means within ``reach`` samples of the
    part's middle. Where there are no data, the height is -inf.
    """
    along_m = np.fmax.reduce(band_m, axis=0, initial=-np.inf)
    middle = ((np.arange(PARTS) + 0.5) * len(along_m) / PARTS).astype(np.intp)
    near = (along_m[max(at - reach, 0) : at + reach + 1].max() for at in middle)
    return np.fromiter(near, np.float64, PARTS)

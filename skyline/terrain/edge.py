"""The edge of a DEM, and how high terrain beyond it may stand in the skyline."""

from dataclasses import dataclass
from math import ceil
from typing import Self

import numpy as np

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.geodesy import Curvature, Rectangle
from skyline.terrain.heightfield import HeightField

_REACH_M = 10_000.0
"""Terrain past a point of the edge is assumed to be no higher than the terrain within this distance
inside it."""
_PARTS = 256
"""Number of parts of each side, each with a greatest height of its own."""
_LEAST_M = 1.0
"""Least distance of an eye from the edge, and least length of a side: a DEM may be one sample
wide."""


@dataclass(frozen=True, slots=True, eq=False)
class DataEdge:
    """The rectangle that a DEM covers, and how high the terrain beyond may be.

    Holes within the rectangle are ignored.
    """

    bounds_m: Rectangle
    highest_m: Float32Array
    """(4, P) float32. Greatest height of terrain past each of P equal parts of the sides: west,
    south, east, north. The parts run from south to north and from west to east."""
    curvature: Curvature

    @classmethod
    def of(cls, terrain: HeightField, curvature: Curvature) -> Self:
        """Return the edge of a DEM; beyond, ranges go on as high as they are inside."""
        northward = terrain.heights_m[::-1]
        cols = ceil(_REACH_M / terrain.spacing_east_m)
        rows = ceil(_REACH_M / terrain.spacing_north_m)
        highest_m = np.stack(
            [
                _highest(northward[:, :cols].T, rows),
                _highest(northward[:rows], cols),
                _highest(northward[:, -cols:].T, rows),
                _highest(northward[-rows:], cols),
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
        """Return the greatest tangent of elevation of terrain past the edge.

        An eye above all that terrain sees it best at the horizon of its greatest height, not at the
        edge. The arguments broadcast; azimuths are from grid north, places lie inside. float32
        arguments give a float32 result, for speed.
        """
        distance_m, highest_m = self._leaving(easting_m, northing_m, azimuth_rad)
        above_m = highest_m - np.asarray(eye_elevation_m)
        drop = self.curvature.drop_per_m2
        if drop > 0.0:
            distance_m = np.maximum(distance_m, np.sqrt(np.maximum(-above_m, 0.0) / drop))
            return np.asarray(above_m / distance_m - drop * distance_m)
        # On a flat Earth terrain below the eye rises towards its level with distance, without end.
        return np.asarray(np.where(above_m > 0.0, above_m / distance_m, 0.0))

    def _leaving(
        self, easting_m: FloatArray, northing_m: FloatArray, azimuth_rad: FloatArray
    ) -> tuple[FloatArray, Float32Array]:
        """Return the distance at which rays leave the data, and the height of terrain beyond."""
        west, south, east, north = self.bounds_m
        wide_m, high_m = east - west, north - south
        from_middle_m = easting_m - (west + east) / 2.0, northing_m - (south + north) / 2.0
        sine, cosine = np.sin(azimuth_rad), np.cos(azimuth_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = wide_m / 2.0 / np.abs(sine) - from_middle_m[0] / sine
            along = high_m / 2.0 / np.abs(cosine) - from_middle_m[1] / cosine
        # A ray due north or south never crosses the east or west side: its distance is NaN, which
        # counts as the farther one.
        distance_m, is_across = np.fmin(across, along), across <= along
        share = np.where(
            is_across,
            (from_middle_m[1] + distance_m * cosine) / max(high_m, _LEAST_M),
            (from_middle_m[0] + distance_m * sine) / max(wide_m, _LEAST_M),
        )
        is_far = np.where(is_across, sine, cosine) > 0.0
        parts = self.highest_m.shape[1]
        part = np.clip((share + 0.5) * parts, 0, parts - 1).astype(np.int32)
        part += (2 * is_far + ~is_across) * np.int32(parts)
        return np.maximum(distance_m, _LEAST_M), self.highest_m.ravel()[part]


def _highest(band_m: FloatArray, reach: int) -> Float64Array:
    """Return the greatest height of a band (D, N) near each of P parts of its length N.

    Near means within ``reach`` samples of the part's middle. It is -inf where there are no data.
    """
    along_m = np.fmax.reduce(band_m, axis=0, initial=-np.inf)
    middle = ((np.arange(_PARTS) + 0.5) * len(along_m) / _PARTS).astype(np.intp)
    near = (along_m[max(at - reach, 0) : at + reach + 1].max() for at in middle)
    return np.fromiter(near, np.float64, _PARTS)

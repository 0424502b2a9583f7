"""Where a DEM ends: how high terrain beyond it may stand in the skyline."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array
from skyline.geodesy import Curvature, Rectangle
from skyline.terrain.heightfield import HeightField

_LEAST_M = 1.0
"""Who stands on the edge is taken to stand this far inside."""


@dataclass(frozen=True, slots=True)
class DataEdge:
    """The rectangle that a DEM covers, and how high the terrain beyond may be.

    Holes within the rectangle are not looked for.

    Attributes
    ----------
    bounds_m : (float, float, float, float)
        West, south, east, north.
    highest_m : float
        The terrain beyond is taken to be no higher than the highest within.
    curvature : Curvature
    """

    bounds_m: Rectangle
    highest_m: float
    curvature: Curvature

    @classmethod
    def of(cls, terrain: HeightField, curvature: Curvature) -> Self:
        """Return the edge of a DEM."""
        return cls(terrain.bounds_m, terrain.height_range_m[1], curvature)

    def distance_m(
        self, easting_m: ArrayLike, northing_m: ArrayLike, azimuth_rad: ArrayLike
    ) -> Float64Array:
        """Return how far off the edge is along azimuths from grid north; they broadcast."""
        west, south, east, north = self.bounds_m
        easting_m, northing_m = np.asarray(easting_m), np.asarray(northing_m)
        sine, cosine = np.sin(azimuth_rad), np.cos(azimuth_rad)
        with np.errstate(divide="ignore", invalid="ignore"):
            across = np.where(sine > 0.0, east - easting_m, easting_m - west) / np.abs(sine)
            along = np.where(cosine > 0.0, north - northing_m, northing_m - south) / np.abs(cosine)
        # Along one pair of sides a ray never meets them; who stands on one divides 0 by 0.
        return np.asarray(np.maximum(np.fmin(across, along), _LEAST_M))

    def elevation_tan(
        self,
        easting_m: ArrayLike,
        northing_m: ArrayLike,
        eye_elevation_m: ArrayLike,
        azimuth_rad: ArrayLike,
    ) -> Float64Array:
        """Return the greatest tangent of elevation, over grid azimuths, of terrain past the edge.

        An eye above all terrain sees it best at the horizon of its greatest height, not at the
        edge. The arguments broadcast.
        """
        distance_m = self.distance_m(easting_m, northing_m, azimuth_rad)
        above_m = self.highest_m - np.asarray(eye_elevation_m, dtype=np.float64)
        drop = self.curvature.drop_per_m2
        if drop > 0.0:
            distance_m = np.maximum(distance_m, np.sqrt(np.maximum(-above_m, 0.0) / drop))
            return np.asarray(above_m / distance_m - drop * distance_m)
        # On a flat Earth what lies below the eye rises towards its level, endlessly far off.
        return np.asarray(np.where(above_m > 0.0, above_m / distance_m, 0.0))

"""Ridges that hide ground behind them, as seen from an eye."""

import math
from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array, IntArray
from skyline.geodesy.earth import Curvature
from skyline.terrain.heightfield import HeightField, heights_along


@dataclass(frozen=True, slots=True)
class RidgeSearch:
    """How ridges are searched."""

    reach_m: float = 40_000.0
    """Ridges farther away are left out, since haze hides them."""
    step_share: float = 0.006
    """Step from sample to sample, as a share of the distance; at least half the DEM's spacing."""
    least_ratio: float = 1.12
    """Least ratio of the distance of the ground seen behind a ridge to the distance of the
    ridge."""


_SEARCH = RidgeSearch()


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """N points of ridges, by azimuth and then from near to far.

    Attributes
    ----------
    azimuth : (N,) int
        Indices of the given azimuths.
    elevation_tan : (N,) float64
        Tangents of their elevation angles.
    distance_m : (N,) float64
        Horizontal distances.
    """

    azimuth: IntArray
    elevation_tan: Float64Array
    distance_m: Float64Array


def ridges_around(
    terrain: HeightField,
    curvature: Curvature,
    eye_m: tuple[float, float, float],
    azimuth_rad: Float64Array,
) -> Ridges:
    """Return the ridges along azimuths from an eye, without the skyline.

    Parameters
    ----------
    terrain : HeightField
    curvature : Curvature
    eye_m : (float, float, float)
        Easting, northing and elevation.
    azimuth_rad : (A,) float64
        Grid azimuths.
    """
    east_m, north_m, up_m = eye_m
    distance_m = _distances_m(terrain.spacing_m)
    height_m = heights_along(terrain, east_m, north_m, azimuth_rad, distance_m)
    tangent = (height_m - curvature.drop_m(distance_m) - up_m) / distance_m
    tangent = np.where(np.isnan(tangent), -np.inf, tangent)
    highest = np.maximum.accumulate(tangent, axis=1)
    is_seen = np.diff(highest, axis=1, prepend=-np.inf) > 0.0
    azimuth, sample = np.nonzero(is_seen)
    is_ridge = (
        (azimuth[1:] == azimuth[:-1])
        & (sample[1:] > sample[:-1] + 1)
        & (distance_m[sample[1:]] >= _SEARCH.least_ratio * distance_m[sample[:-1]])
    )
    azimuth = azimuth[:-1][is_ridge]
    sample = sample[:-1][is_ridge]
    return Ridges(azimuth, tangent[azimuth, sample], distance_m[sample])


def _distances_m(spacing_m: float) -> Float64Array:
    """Return the distances at which profiles are sampled, from near to far."""
    least_m = 0.5 * spacing_m
    turn_m = least_m / _SEARCH.step_share
    reach_m = _SEARCH.reach_m
    near_m = np.arange(least_m, min(turn_m, reach_m), least_m)
    count = math.ceil(math.log(max(reach_m / turn_m, 1.0)) / math.log1p(_SEARCH.step_share))
    return np.concatenate([near_m, turn_m * (1.0 + _SEARCH.step_share) ** np.arange(count)])

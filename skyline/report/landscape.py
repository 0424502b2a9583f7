"""The terrain one eye sees: how far away it is in every direction, and its ridges.

Columns of azimuth are followed outwards in steps no wider than a pixel of the picture; what is seen
is what stands higher than all that is nearer.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import Float32Array, Float64Array
from skyline.geodesy import Curvature
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_COLUMNS_AT_ONCE, _STEPS_AT_ONCE = 128, 256
_SAMPLES_A_STEP = 0.7
_RIDGE_JUMP, _RIDGE_SAMPLES = 1.04, 4.0
"""How much farther what is behind a ridge must be: times as far, and samples beyond that."""
_RANGES_A_DOUBLING = 10
_NOTHING_DEG = -90.0


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What one eye sees in C columns, S steps outwards.

    Attributes
    ----------
    azimuth_deg : (C,) float64
        From true north, increasing.
    distance_m : (S,) float64
        Of the steps, horizontal, increasing.
    top_deg : (C, S) float32
        Highest elevation angle of the terrain up to each step; -90 before any.
    ridge_m : (R,) float64
        Distances at which ranges begin, increasing.
    ridge_deg : (R, C) float32
        Elevation angle of the highest ridge of each range, NaN where it has none. Behind a ridge
        the terrain drops out of sight.
    """

    azimuth_deg: Float64Array
    distance_m: Float64Array
    top_deg: Float32Array
    ridge_m: Float64Array
    ridge_deg: Float32Array

    @classmethod
    def of(
        cls,
        terrain: HeightField,
        eye: Viewpoints,
        azimuth_deg: Float64Array,
        curvature: Curvature | None = None,
    ) -> Self:
        """Look at the terrain.

        Parameters
        ----------
        terrain : HeightField
        eye : Viewpoints
            One.
        azimuth_deg : (C,) float64
            From true north, in equal steps, at least two.
        curvature : Curvature, optional
            Defaults to the Earth's with k = 0.13.
        """
        curvature = curvature or Curvature()
        distance = _steps_m(terrain, eye, math.radians(azimuth_deg[1] - azimuth_deg[0]))
        drop = float(eye.eye_elevation_m[0]) + curvature.drop_m(distance)
        convergence = terrain.frame.convergence_deg(eye.easting_m[0], eye.northing_m[0])
        top = np.empty((len(azimuth_deg), len(distance)), np.float32)
        bound_deg = np.degrees(np.arctan((terrain.height_range_m[1] - drop) / distance))
        # Of all from each step on.
        bound_deg = np.maximum.accumulate(bound_deg[::-1])[::-1]
        ranges = (np.log2(distance / distance[0]) * _RANGES_A_DOUBLING).astype(np.intp)
        ridge = np.full((ranges[-1] + 1, len(azimuth_deg)), np.nan, np.float32)
        for start in range(0, len(azimuth_deg), _COLUMNS_AT_ONCE):
            part = slice(start, start + _COLUMNS_AT_ONCE)
            grid = np.radians(azimuth_deg[part, np.newaxis] - convergence)
            so_far = np.full((grid.shape[0], 1), _NOTHING_DEG, np.float32)
            for first in range(0, len(distance), _STEPS_AT_ONCE):
                if bound_deg[first] <= so_far.min():
                    top[part, first:] = so_far
                    break
                steps = slice(first, first + _STEPS_AT_ONCE)
                height = terrain.height_at(
                    eye.easting_m[0] + distance[steps] * np.sin(grid),
                    eye.northing_m[0] + distance[steps] * np.cos(grid),
                )
                up_deg = np.degrees(np.arctan((height - drop[steps]) / distance[steps]))
                up_deg = np.nan_to_num(up_deg, nan=_NOTHING_DEG).astype(np.float32)
                top[part, steps] = np.maximum.accumulate(np.maximum(up_deg, so_far), axis=1)
                so_far = top[part, steps][:, -1:]
            column, step = _ridges(top[part], distance, terrain.spacing_m)
            # Later ones stand higher.
            ridge[ranges[step], start + column] = top[part][column, step]
        begins = distance[0] * 2.0 ** (np.arange(len(ridge)) / _RANGES_A_DOUBLING)
        return cls(azimuth_deg, distance, top, begins, ridge)

    @property
    def skyline_deg(self) -> Float32Array:
        """The highest elevation angle in each column, (C,)."""
        return np.asarray(self.top_deg[:, -1])

    @property
    def reach_m(self) -> float:
        """How far away the farthest terrain seen is."""
        farthest = (self.top_deg < self.skyline_deg[:, np.newaxis]).sum(axis=1).max()
        return float(self.distance_m[min(int(farthest), len(self.distance_m) - 1)])

    def seen_m(self, columns: slice, elevation_deg: Float64Array) -> Float64Array:
        """Return how far away what is seen in P columns is, (E, P); inf for the sky.

        Parameters
        ----------
        columns : slice
        elevation_deg : (E,) float64
        """
        away = np.append(self.distance_m, np.inf)
        steps = [np.searchsorted(top, elevation_deg) for top in self.top_deg[columns]]
        return away[np.stack(steps, axis=1)]


def _steps_m(terrain: HeightField, eye: Viewpoints, pixel_rad: float) -> Float64Array:
    """Return distances from underfoot to the farthest corner of the terrain."""
    reach_m = terrain.reach_m(float(eye.easting_m[0]), float(eye.northing_m[0]))
    step_m = _SAMPLES_A_STEP * terrain.spacing_m
    turn_m = min(max(step_m / pixel_rad, step_m), reach_m)
    near = np.arange(0.5 * step_m, turn_m, step_m)
    wider = math.ceil(math.log(reach_m / turn_m) / pixel_rad) + 1
    return np.concatenate([near, np.geomspace(turn_m, max(reach_m, 1.01 * turn_m), wider + 1)])


def _ridges(
    top_deg: Float32Array, distance_m: Float64Array, spacing_m: float
) -> tuple[np.ndarray[tuple[int], np.dtype[np.intp]], np.ndarray[tuple[int], np.dtype[np.intp]]]:
    """Return columns and steps behind which the next that is seen is much farther, or the sky."""
    seen = np.empty(top_deg.shape, dtype=bool)
    seen[:, 0] = top_deg[:, 0] > _NOTHING_DEG
    seen[:, 1:] = top_deg[:, 1:] > top_deg[:, :-1]
    column, step = np.nonzero(seen)
    behind = np.append(distance_m[step[1:]], np.inf)
    behind[np.append(np.diff(column) > 0, True)] = np.inf
    ridge = behind > _RIDGE_JUMP * distance_m[step] + _RIDGE_SAMPLES * spacing_m
    return column[ridge], step[ridge]

"""The terrain one eye sees: how far away it is in every direction, and its ridges.

Columns of azimuth are followed outwards in steps no wider than a pixel of the picture; what is seen
is what stands higher than all that is nearer. Terrain that nearer terrain hides is not made.
"""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.geodesy import Curvature
from skyline.terrain.blocks import Blocks
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_COLUMNS_AT_ONCE, _STEPS_AT_ONCE = 128, 256
_SAMPLES_A_STEP = 0.7
_NEAR_SAMPLES = 300
"""Within so many samples all is looked at; it hides most of what lies beyond."""
_HIDDEN_DEG = 0.25
"""Terrain so far below what is nearer is hidden: farther than a peak that is named may be."""
_RIDGE_JUMP, _RIDGE_SAMPLES = 1.04, 4.0
"""How much farther what is behind a ridge must be: times as far, and samples beyond that."""
_RANGES_A_DOUBLING = 10
_NOTHING_DEG = -90.0


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """What one eye sees in C columns, S steps outwards.

    Attributes
    ----------
    terrain : HeightField
        What is hidden from the eye may be missing.
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

    terrain: HeightField
    azimuth_deg: Float64Array
    distance_m: Float64Array
    top_deg: Float32Array
    ridge_m: Float64Array
    ridge_deg: Float32Array

    @classmethod
    def of(
        cls,
        blocks: Blocks,
        eye: Viewpoints,
        azimuth_deg: Float64Array,
        curvature: Curvature | None = None,
    ) -> Self:
        """Look at the terrain.

        Parameters
        ----------
        blocks : Blocks
        eye : Viewpoints
            One.
        azimuth_deg : (C,) float64
            From true north, in equal steps, at least two.
        curvature : Curvature, optional
            Defaults to the Earth's with k = 0.13.
        """
        look = _Look(blocks, eye, azimuth_deg, curvature or Curvature())
        terrain = blocks.field(near_blocks(blocks, eye.easting_m[0], eye.northing_m[0]))
        near = int(np.searchsorted(look.distance_m, _NEAR_SAMPLES * terrain.spacing_m))
        look.walk(terrain, slice(0, near), np.full(len(azimuth_deg), np.inf))
        wanted, until_m = look.may_be_seen(near)
        terrain = blocks.field(wanted)
        look.walk(terrain, slice(near, len(look.distance_m)), until_m)
        ridge_m, ridge_deg = look.ridges(terrain)
        return cls(terrain, azimuth_deg, look.distance_m, look.top_deg, ridge_m, ridge_deg)

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


def near_blocks(blocks: Blocks, easting_m: float, northing_m: float) -> BoolArray:
    """Return which blocks are looked at in any case, (R, C)."""
    spacing_m = min(blocks.spacing_east_m, blocks.spacing_north_m)
    away_m = np.hypot(*blocks.around_m(easting_m, northing_m))
    return np.asarray(away_m <= _NEAR_SAMPLES * spacing_m + blocks.radius_m)


class _Look:
    """Follows columns outwards; see `Landscape`."""

    def __init__(
        self, blocks: Blocks, eye: Viewpoints, azimuth_deg: Float64Array, curvature: Curvature
    ) -> None:
        self._blocks, self._curvature = blocks, curvature
        self._place = float(eye.easting_m[0]), float(eye.northing_m[0])
        self._eye_m = float(eye.eye_elevation_m[0])
        turn_deg = float(blocks.frame.convergence_deg(*self._place))
        self._grid_rad = np.radians(azimuth_deg - turn_deg)
        self._column_rad = math.radians(azimuth_deg[1] - azimuth_deg[0])
        self.distance_m = _steps_m(blocks, self._place, self._column_rad)
        self.top_deg = np.full(
            (len(azimuth_deg), len(self.distance_m)), _NOTHING_DEG, dtype=np.float32
        )
        self._so_far_deg = self.top_deg[:, 0].copy()

    def walk(self, terrain: HeightField, steps: slice, until_m: Float64Array) -> None:
        """Go some steps on in every column, no farther than a distance (C,)."""
        for start in range(0, len(until_m), _COLUMNS_AT_ONCE):
            for first in range(steps.start, steps.stop, _STEPS_AT_ONCE):
                part = slice(first, min(first + _STEPS_AT_ONCE, steps.stop))
                open_ = until_m[start : start + _COLUMNS_AT_ONCE] > self.distance_m[first]
                columns = start + np.flatnonzero(open_)
                up_deg = self._up_deg(terrain, columns, self.distance_m[part])
                np.maximum(up_deg[:, 0], self._so_far_deg[columns], out=up_deg[:, 0])
                up_deg = np.maximum.accumulate(up_deg, axis=1)
                self.top_deg[columns, part] = up_deg
                self._so_far_deg[columns] = up_deg[:, -1]

    def _up_deg(
        self, terrain: HeightField, columns: Int64Array, distance_m: Float64Array
    ) -> Float32Array:
        """Return the elevation angles of the ground of K columns at distances (D,) or (K, D)."""
        east, north = (turn(self._grid_rad[columns])[:, np.newaxis] for turn in (np.sin, np.cos))
        ground_m = terrain.height_at(
            self._place[0] + distance_m * east, self._place[1] + distance_m * north
        )
        drop_m = self._eye_m + self._curvature.drop_m(distance_m)
        up_deg = np.degrees(np.arctan((ground_m - drop_m) / distance_m))
        return np.nan_to_num(up_deg, nan=_NOTHING_DEG).astype(np.float32)

    def may_be_seen(self, step: int) -> tuple[BoolArray, Float64Array]:
        """Return the blocks (R, C) that what was seen up to a step does not hide.

        And how far away the farthest of them is in each column, (C,).
        """
        blocks, near_m = self._blocks, self.distance_m[step - 1]
        east_m, north_m = blocks.around_m(*self._place)
        away_m, radius_m = np.hypot(east_m, north_m), blocks.radius_m
        from_m, to_m = np.maximum(away_m - radius_m, near_m), away_m + radius_m
        up_m = blocks.highest_m - self._eye_m - self._curvature.drop_m(from_m)
        up_deg = np.degrees(np.arctan(up_m / np.where(up_m > 0.0, from_m, to_m))) + _HIDDEN_DEG
        far = np.flatnonzero((to_m > near_m) & (up_deg > self._so_far_deg.min()))
        half_rad = np.arcsin(radius_m / away_m.flat[far])
        # Columns all the way round, twice, so that none of the spans is cut.
        columns, turn = len(self._so_far_deg), round(2.0 * math.pi / self._column_rad)
        hidden_deg = np.full((2, turn), np.inf)
        hidden_deg[:, :columns] = self._so_far_deg
        left_rad = np.arctan2(east_m, north_m).flat[far] - half_rad - self._grid_rad[0]
        left = (left_rad % (2.0 * math.pi) / self._column_rad).astype(np.int64) % turn
        right = left + np.ceil(2.0 * half_rad / self._column_rad).astype(np.int64) + 2
        spans = np.stack([left, right], axis=1)
        least_deg = np.minimum.reduceat(np.append(hidden_deg, np.inf), spans.ravel())[::2]
        seen = up_deg.flat[far] > least_deg
        wanted = away_m - radius_m <= near_m
        wanted.flat[far[seen]] = True
        until_m = np.zeros(2 * turn)
        for (first, last), far_m in zip(spans[seen], to_m.flat[far[seen]], strict=True):
            until_m[first:last] = np.maximum(until_m[first:last], far_m)
        return wanted, until_m.reshape(2, turn).max(axis=0)[:columns]

    def ridges(self, terrain: HeightField) -> tuple[Float64Array, Float32Array]:
        """Return `Landscape.ridge_m` and `Landscape.ridge_deg`, and close the columns."""
        np.maximum.accumulate(self.top_deg, axis=1, out=self.top_deg)
        distance_m = self.distance_m
        ranges = (np.log2(distance_m / distance_m[0]) * _RANGES_A_DOUBLING).astype(np.intp)
        ridge_deg = np.full((ranges[-1] + 1, len(self.top_deg)), np.nan, np.float32)
        for start in range(0, len(self.top_deg), _COLUMNS_AT_ONCE):
            top_deg = self.top_deg[start : start + _COLUMNS_AT_ONCE]
            column, step = _ridges(top_deg, distance_m, terrain.spacing_m)
            # Later ones stand higher.
            ridge_deg[ranges[step], start + column] = top_deg[column, step]
        begins_m = distance_m[0] * 2.0 ** (np.arange(len(ridge_deg)) / _RANGES_A_DOUBLING)
        return begins_m, ridge_deg


def _steps_m(blocks: Blocks, place: tuple[float, float], pixel_rad: float) -> Float64Array:
    """Return distances from underfoot to the farthest corner of the terrain."""
    reach_m = float(np.hypot(*blocks.around_m(*place)).max()) + blocks.radius_m
    step_m = _SAMPLES_A_STEP * min(blocks.spacing_east_m, blocks.spacing_north_m)
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

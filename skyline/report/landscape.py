"""The terrain and the named summits that one eye sees in a panorama.

Columns of azimuth are followed outwards in steps no wider than a pixel of the picture; a point is
seen if its elevation angle is greater than those of all nearer points. Blocks of terrain that
nearer terrain hides are never read.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.report.peaks import (
    UNDERFOOT_SAMPLES,
    Peaks,
    Sighting,
    check_on_map,
    ground_elevation_deg,
    highest_between_deg,
    most_prominent_first,
    visible_peaks,
)
from skyline.solar import horizons_of
from skyline.terrain.heightfield import BLOCK, HeightField, TerrainBlocks
from skyline.terrain.summits import PROMINENCE_REACH
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, place_on, stand_on

ROW_DEG = 120.0
"""The widest row of a panorama; a wider panorama has several rows of equal width."""
COLUMNS = 2265
"""Pixels across a row."""
_LEAST_FOV_DEG = 5.0
_SURFACE_STEP_DEG = 0.1

_COLUMNS_AT_ONCE, _STEPS_AT_ONCE = 128, 256
_RINGS_SAMPLES = (300.0, 1000.0, math.inf)
"""Outer radii of rings around the eye; terrain seen in one ring hides terrain of the next."""
_HIDDEN_DEG = 0.05
"""Terrain this far below nearer terrain is hidden, as are peaks on it between two columns."""
_RIDGE_JUMP, _RIDGE_SAMPLES = 1.04, 4.0
"""A point is a ridge if the next terrain in sight is farther by more than this factor and, beyond
that, by more than this many samples."""
_RANGES_A_DOUBLING = 10
_NOTHING_DEG = -90.0


@dataclass(frozen=True, slots=True)
class PanoramaConfig:
    """The view that a panorama shows; by default the full turn from north to north.

    Attributes
    ----------
    heading_deg, fov_deg : float
        Azimuth of the picture's middle from true north, and its width, 5 to 360 degrees.
    eye_height_m : float
        Height of the eye above ground.
    summit_within_m : float, optional
        As in `skyline.horizon`.
    """

    heading_deg: float = 180.0
    fov_deg: float = 360.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    summit_within_m: float | None = None

    def __post_init__(self) -> None:
        if not (_LEAST_FOV_DEG <= self.fov_deg <= 360.0 and math.isfinite(self.heading_deg)):
            raise InputError(
                f"heading is {self.heading_deg:g} and field of view {self.fov_deg:g} degrees; "
                f"expected a field of view of {_LEAST_FOV_DEG:g} to 360"
            )

    @property
    def start_deg(self) -> float:
        """Azimuth of the picture's left border."""
        return (self.heading_deg - 0.5 * self.fov_deg) % 360.0


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaView:
    """The terrain and the summits that a panorama shows."""

    landscape: "Landscape"
    """Its columns are those of the picture, one row after another."""
    sightings: Sequence[Sighting]
    """Visible summits, the most prominent first."""
    config: PanoramaConfig
    surface_deg: Float64Array | None = None
    """(C,) float64. Elevation angle up to which trees and houses may rise in each column."""


def panorama_view(
    blocks: TerrainBlocks,
    lonlat: tuple[float, float],
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> PanoramaView:
    """Return the view from a place and its visible peaks; raises as `Landscape.of`."""
    start_deg, fov_deg = config.start_deg, config.fov_deg
    columns = row_count(fov_deg) * COLUMNS
    easting_m, northing_m = place_on(blocks.frame, blocks.grid.bounds, *lonlat)
    landscape = Landscape.of(
        blocks,
        (float(easting_m[0]), float(northing_m[0])),
        config.eye_height_m,
        start_deg + np.arange(0.5, columns) * (fov_deg / columns),
        config.summit_within_m,
    )
    terrain, eye = landscape.terrain, landscape.eye
    seen = []
    if peaks is not None:
        check_on_map(peaks, blocks.frame, blocks.grid.bounds)
        seen = visible_peaks(terrain, eye, peaks, Curvature())
    inside = [
        one
        for one in seen
        if (one.azimuth_deg + landscape.convergence_deg - start_deg) % 360.0 < fov_deg
    ]
    if inside:
        inside = most_prominent_first(_terrain_around(blocks, inside), inside)
    surface_deg = None
    if surface is not None:
        both = horizons_of(terrain, eye, _SURFACE_STEP_DEG, surface=surface)
        surface_deg = np.interp(
            landscape.azimuth_deg, both.azimuth_deg[0], both.surface_deg[0], period=360.0
        )
    return PanoramaView(landscape, inside, config, surface_deg)


def _terrain_around(blocks: TerrainBlocks, sightings: Sequence[Sighting]) -> HeightField:
    """Return the terrain around summits, including parts hidden from the eye."""
    wanted = np.zeros(blocks.highest_m.shape, np.bool_)
    for one in sightings:
        east_m, north_m = np.abs(blocks.around_m(one.easting_m, one.northing_m))
        grid, reach = blocks.grid, PROMINENCE_REACH + 0.5 * BLOCK
        wanted |= (east_m <= reach * grid.step_east) & (north_m <= reach * grid.step_north)
    return blocks.field(wanted)


def row_count(fov_deg: float) -> int:
    """Return the number of rows of a panorama, each at most `ROW_DEG` wide."""
    return int(np.ceil(fov_deg / ROW_DEG - 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """The terrain that one eye sees: P points in C columns of azimuth, outwards in each."""

    terrain: HeightField
    """Parts hidden from the eye may be missing."""
    eye: Viewpoints
    """A single eye."""
    ground_m: float
    """Height of the ground below the eye; on a summit, the height of the summit."""
    azimuth_deg: Float64Array
    """(C,) float64. Azimuth from true north, increasing."""
    begins: Int64Array
    """(C + 1,) int64. The points of column c are ``begins[c]`` to ``begins[c + 1]``."""
    distance_m: Float64Array
    """(P,) float64. Horizontal, increasing in each column."""
    elevation_deg: Float32Array
    """(P,) float32. Elevation angle, increasing in each column."""
    is_ridge: BoolArray
    """(P,) bool. Whether the terrain behind a point drops out of sight."""

    @classmethod
    def of(
        cls,
        blocks: TerrainBlocks,
        place_m: tuple[float, float],
        eye_height_m: float,
        azimuth_deg: Float64Array,
        summit_within_m: float | None = 0.0,
    ) -> Self:
        """Find the terrain visible from an easting and a northing at azimuths (C,) in equal steps.

        The Earth is curved, with refraction k = 0.13. Raises `OffMapError` if the place is off the
        map or on a hole, and `InputError` if no terrain is visible.
        """
        near_m, *farther_m = (samples * blocks.spacing_m for samples in _RINGS_SAMPLES)
        easting_m, northing_m = place_m
        from_m = np.hypot(*blocks.around_m(*place_m)) - blocks.radius_m
        wanted = from_m <= near_m + (summit_within_m or 0.0)
        terrain = blocks.field(wanted)
        if np.isnan(terrain.height_at(easting_m=easting_m, northing_m=northing_m)):
            # This raises an error that names the extent of the map.
            terrain = blocks.field(np.zeros_like(wanted))
        eye = stand_on(
            terrain,
            easting_m=easting_m,
            northing_m=northing_m,
            eye_height_m=eye_height_m,
            summit_within_m=summit_within_m,
        )
        from_m = np.hypot(*blocks.around_m(eye.easting_m[0], eye.northing_m[0])) - blocks.radius_m
        rays = _RayWalk(blocks, eye, azimuth_deg)
        rays.walk(terrain, 0.0, near_m, np.full(len(azimuth_deg), np.inf))
        for ring_m in itertools.pairwise((near_m, *farther_m)):
            seen, until_m = rays.may_be_seen(ring_m[0])
            wanted = np.where(from_m <= ring_m[0], wanted, seen)
            terrain = blocks.field(wanted & (from_m <= ring_m[1]))
            rays.walk(terrain, *ring_m, until_m)
        ground_m = float(eye.eye_elevation_m[0]) - eye_height_m
        return cls(terrain, eye, ground_m, azimuth_deg, *rays.points(terrain))

    @property
    def skyline_deg(self) -> Float32Array:
        """Highest elevation angle in each column, (C,); -90 if the column sees no terrain."""
        highest = self.elevation_deg[np.maximum(self.begins[1:], 1) - 1]
        return np.where(np.diff(self.begins) > 0, highest, np.float32(_NOTHING_DEG))

    @property
    def convergence_deg(self) -> float:
        """Azimuth from true north minus grid azimuth, at the eye."""
        place = {"easting_m": self.eye.easting_m[0], "northing_m": self.eye.northing_m[0]}
        return float(self.terrain.frame.convergence_deg(**place))

    @property
    def reach_m(self) -> float:
        """Distance of the farthest visible terrain."""
        return float(self.distance_m.max())

    @property
    def column(self) -> Int64Array:
        """Column of each point, (P,)."""
        return np.repeat(np.arange(len(self.azimuth_deg)), np.diff(self.begins))

    def seen(self, columns: slice, elevation_deg: Float64Array) -> Int64Array:
        """Return the indices of the points seen at angles (E,) in K columns, (E, K); P is sky."""
        begins = self.begins[columns.start : columns.stop + 1]
        seen = np.full((len(begins) - 1, len(elevation_deg)), len(self.distance_m))
        for row, (begin, end) in zip(seen, itertools.pairwise(begins), strict=True):
            point = begin + np.searchsorted(self.elevation_deg[begin:end], elevation_deg)
            np.copyto(row, point, where=point < end)
        return seen.T

    def ridges(self) -> tuple[Float64Array, Float32Array]:
        """Return the distances (R,) at which ranges begin, increasing, and their ridges (R, C).

        A ridge is the elevation angle of a range's highest point; NaN where the range has none.
        """
        first_m = float(self.distance_m.min(initial=np.inf))
        distance_m = self.distance_m[self.is_ridge]
        ranges = (np.log2(distance_m / first_m) * _RANGES_A_DOUBLING).astype(np.intp)
        shape = ranges.max(initial=0) + 1, len(self.azimuth_deg)
        ridge_deg = np.full(shape, np.nan, np.float32)
        # The last of several in a range stands highest.
        ridge_deg[ranges, self.column[self.is_ridge]] = self.elevation_deg[self.is_ridge]
        return first_m * 2.0 ** (np.arange(len(ridge_deg)) / _RANGES_A_DOUBLING), ridge_deg


class _RayWalk:
    """Follows columns of azimuth outwards; see `Landscape`."""

    def __init__(self, blocks: TerrainBlocks, eye: Viewpoints, azimuth_deg: Float64Array) -> None:
        self._blocks, self._eye, self._curvature = blocks, eye, Curvature()
        self._place = float(eye.easting_m[0]), float(eye.northing_m[0])
        turn_deg = blocks.frame.convergence_deg(easting_m=eye.easting_m, northing_m=eye.northing_m)
        self._grid_rad = np.radians(azimuth_deg - turn_deg)
        self._column_rad = math.radians(azimuth_deg[1] - azimuth_deg[0])
        self._distance_m = _steps_m(blocks, self._place, self._column_rad)
        self._so_far_deg = np.full(len(azimuth_deg), _NOTHING_DEG, dtype=np.float32)
        self._seen: list[tuple[Int64Array, Int64Array, Float32Array]] = []

    def walk(self, terrain: HeightField, from_m: float, to_m: float, until_m: Float64Array) -> None:
        """Continue from one distance to another, in each column at most to ``until_m``, (C,)."""
        begin, end = np.searchsorted(self._distance_m, [from_m, to_m]).tolist()
        for start in range(0, len(until_m), _COLUMNS_AT_ONCE):
            for first in range(begin, end, _STEPS_AT_ONCE):
                part = slice(first, min(first + _STEPS_AT_ONCE, end))
                open_ = until_m[start : start + _COLUMNS_AT_ONCE] > self._distance_m[first]
                columns = start + np.flatnonzero(open_)
                rays = self._grid_rad[columns], self._distance_m[part]
                on_deg = ground_elevation_deg(terrain, self._eye, self._curvature, *rays)
                so_far_deg = self._so_far_deg[columns, np.newaxis]
                up_deg = np.concatenate([so_far_deg, on_deg.astype(np.float32)], axis=1)
                np.maximum.accumulate(up_deg, axis=1, out=up_deg)
                self._so_far_deg[columns] = up_deg[:, -1]
                column, step = np.nonzero(up_deg[:, 1:] > up_deg[:, :-1])
                self._seen.append((columns[column], first + step, up_deg[column, step + 1]))

    def points(
        self, terrain: HeightField
    ) -> tuple[Int64Array, Float64Array, Float32Array, BoolArray]:
        """Return the points of a `Landscape`; ridges have the exact height of the surface there."""
        column, step, up_deg = (np.concatenate(part) for part in zip(*self._seen, strict=True))
        if not len(column):
            raise InputError(
                "no terrain is seen: the DEM has no heights around the place; give a wider DEM"
            )
        order = np.argsort(column, kind="stable")  # Steps are in order already.
        column, step, up_deg = column[order], step[order], up_deg[order]
        distance_m = self._distance_m[step]
        behind_m = np.append(distance_m[1:], np.inf)
        behind_m[np.append(np.diff(column) > 0, True)] = np.inf
        samples_m = _RIDGE_SAMPLES * terrain.spacing_m
        is_ridge = behind_m > _RIDGE_JUMP * distance_m + samples_m
        ridge = step[is_ridge]
        crest_deg = highest_between_deg(
            terrain,
            self._eye,
            self._curvature,
            self._grid_rad[column[is_ridge]],
            self._distance_m[np.maximum(ridge - 1, 0)],
            self._distance_m[np.minimum(ridge + 1, len(self._distance_m) - 1)],
        )
        up_deg[is_ridge] = np.maximum(up_deg[is_ridge], crest_deg.astype(np.float32))
        # A raised ridge may hide points found behind it.
        highest_deg = np.maximum.accumulate(up_deg + 360.0 * column)
        seen = np.diff(highest_deg, prepend=-np.inf) > 0.0
        begins = np.searchsorted(column[seen], np.arange(len(self._so_far_deg) + 1))
        return begins, distance_m[seen], up_deg[seen], is_ridge[seen]

    def may_be_seen(self, near_m: float) -> tuple[BoolArray, Float64Array]:
        """Return which blocks (R, C) beyond a distance the nearer terrain leaves unhidden.

        The second array is the distance of the farthest of them in each column, (C,).
        """
        blocks = self._blocks
        east_m, north_m = blocks.around_m(*self._place)
        away_m, radius_m = np.hypot(east_m, north_m), blocks.radius_m
        from_m, to_m = np.maximum(away_m - radius_m, near_m), away_m + radius_m
        up_m = blocks.highest_m - self._eye.eye_elevation_m - self._curvature.drop_m(from_m)
        up_deg = np.degrees(np.arctan(up_m / np.where(up_m > 0.0, from_m, to_m))) + _HIDDEN_DEG
        far = np.flatnonzero((to_m > near_m) & (up_deg > self._so_far_deg.min()))
        half_rad = np.arcsin(radius_m / away_m.flat[far])
        # Two full turns of columns, so that a span across north is not cut.
        columns, turn = len(self._so_far_deg), round(2.0 * math.pi / self._column_rad)
        hidden_deg = np.full((2, turn), np.inf)
        hidden_deg[:, :columns] = self._so_far_deg
        left_rad = np.arctan2(east_m, north_m).flat[far] - half_rad - self._grid_rad[0]
        left = (left_rad % (2.0 * math.pi) / self._column_rad).astype(np.int64) % turn
        right = left + np.ceil(2.0 * half_rad / self._column_rad).astype(np.int64) + 2
        spans = np.stack([left, right], axis=1)
        least_deg = np.minimum.reduceat(np.append(hidden_deg, np.inf), spans.ravel())[::2]
        seen = up_deg.flat[far] > least_deg
        unhidden = np.zeros(away_m.shape, np.bool_)
        unhidden.flat[far[seen]] = True
        until_m = np.zeros(2 * turn)
        for (first, last), far_m in zip(spans[seen], to_m.flat[far[seen]], strict=True):
            until_m[first:last] = np.maximum(until_m[first:last], far_m)
        return unhidden, until_m.reshape(2, turn).max(axis=0)[:columns]


def _steps_m(blocks: TerrainBlocks, place: tuple[float, float], pixel_rad: float) -> Float64Array:
    """Return distances from underfoot to the farthest corner of the terrain."""
    reach_m = float(np.hypot(*blocks.around_m(*place)).max()) + blocks.radius_m
    step_m = blocks.spacing_m
    turn_m = min(max(step_m / pixel_rad, step_m), reach_m)
    near = np.arange(UNDERFOOT_SAMPLES * blocks.spacing_m, turn_m, step_m)
    wider = math.ceil(math.log(reach_m / turn_m) / pixel_rad) + 1
    return np.concatenate([near, np.geomspace(turn_m, max(reach_m, 1.01 * turn_m), wider + 1)])

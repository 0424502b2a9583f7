"""Lines of sight: where rays cross edges of the surface, first meet it, and leave the DEM.

Crossings and meetings are float64 and exact on the surface of triangles. A ray's ``elevation_tan``
is up over horizontal distance, and the terrain drops with the square of the distance (`Curvature`).
"""

from dataclasses import dataclass
from math import ceil
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray, Int64Array, Progress
from skyline.geodesy import Curvature, Rectangle
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_CROSSINGS_AT_ONCE = 400_000
"""Crossings evaluated together: small enough to stay in the processor's cache."""
_JUST_INSIDE = 1.0 - 1e-12
"""Factor on the distance of the map's border, so that rounding leaves no point outside."""
_ENDS = np.minimum, np.maximum
_NEWTON_STEPS = 4
_MET_RAD = 1e-6
"""Angle between a ray and the terrain below which they have met."""
_REACH_SAMPLES = 2.0
"""Greatest change, in samples, from the distance at a nearby azimuth to that at a ray's own."""
_EDGE_BAND_M = 10_000.0
"""Terrain past a point of a DEM's edge is assumed to be no higher than the terrain within this
distance inside it."""
_EDGE_PARTS = 256
"""Number of parts of each side of a DEM, each with a greatest height of its own."""
_LEAST_SIDE_M = 1.0
"""Least distance of an eye from the edge, and least length of a side: a DEM may be one sample
wide."""


def edge_crossings_m(
    field: HeightField,
    eye: Viewpoints,
    azimuth_rad: Float64Array,
    near_m: Float64Array,
    far_m: Float64Array,
) -> tuple[Float64Array, BoolArray]:
    """Return the distances at which K level rays of one eye cross edges of the surface, unordered.

    Rays are followed from ``near_m`` to ``far_m`` (K,). The surface is a plane between two
    crossings. Returns distances (K, C), and which of them are crossings; the others are ``near_m``.
    """
    row, col = field.to_grid(easting_m=eye.easting_m, northing_m=eye.northing_m)
    down = -np.cos(azimuth_rad) / field.spacing_north_m
    right = np.sin(azimuth_rad) / field.spacing_east_m
    crossings_m = []
    for start, a_metre in ((row, down), (col, right), (col - row, right - down)):
        ends = start + a_metre * np.stack([near_m, far_m])
        first, count = np.ceil(ends.min(axis=0)), int(np.ceil(np.ptp(ends, axis=0).max())) + 1
        edge = first[:, np.newaxis] + np.arange(count)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings_m.append((edge - start) / a_metre[:, np.newaxis])
    away_m = np.concatenate(crossings_m, axis=1)
    is_between = (away_m > near_m[:, np.newaxis]) & (away_m < far_m[:, np.newaxis])
    return np.where(is_between, away_m, near_m[:, np.newaxis]), is_between


def first_hits_m(
    field: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    azimuth_rad: Float64Array,
    elevation_tan: Float64Array,
    step_rad: float,
    progress: Progress | None,
) -> Float64Array:
    """Return the horizontal distances at which N rays of one eye first meet the surface.

    The profile of the terrain is followed along azimuths ``step_rad`` apart, and each ray is met on
    the profile nearest to it. From there the distance is carried over to the ray's own azimuth,
    where the surface allows it: beside a ridge's edge, that azimuth may see other terrain.

    Rays have grid azimuths and tangents of elevation (N,). The distances (N,) are exact for a ray
    within ``step_rad / 2`` of the true one in azimuth, and NaN for sky. ``progress`` is called with
    the number of rays that are done, and N.
    """
    distance_m = np.full(len(azimuth_rad), np.nan)
    steps = np.rint(azimuth_rad / step_rad).astype(np.int64)
    order = np.argsort(steps, kind="stable")
    begins = np.append(np.flatnonzero(np.diff(steps[order], prepend=-(1 << 62))), len(order))
    crossings = 3 * (field.rows + field.cols)
    at_once = max(1, _CROSSINGS_AT_ONCE // crossings)
    for start in range(0, len(begins) - 1, at_once):
        bounds = begins[start : start + at_once + 1]
        rays = order[bounds[0] : bounds[-1]]
        # The middle of its rays' azimuths, so that rays of one azimuth are met exactly.
        least, most = (of.reduceat(azimuth_rad[rays], bounds[:-1] - bounds[0]) for of in _ENDS)
        along = 0.5 * (least + most)
        found = _met(field, eye, curvature, along, elevation_tan[rays], bounds - bounds[0])
        distance_m[rays] = _carried_over(
            field, eye, curvature, azimuth_rad[rays], elevation_tan[rays], found
        )
        if progress is not None:
            progress(int(bounds[-1]), len(order))
    return distance_m


def _met(
    field: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    azimuth_rad: Float64Array,
    elevation_tan: Float64Array,
    bounds: Int64Array,
) -> Float64Array:
    """Return where rays meet the profiles of K azimuths.

    Rays ``bounds[k]`` to ``bounds[k + 1]`` belong to azimuth k.
    """
    far_m = _JUST_INSIDE * _border_m(field, eye, azimuth_rad)
    crossing_m, _ = edge_crossings_m(field, eye, azimuth_rad, np.zeros_like(far_m), far_m)
    away_m = np.sort(np.column_stack([crossing_m, np.zeros_like(far_m), far_m]), axis=1)
    ground_m = field.height_at(
        easting_m=eye.easting_m + away_m * np.sin(azimuth_rad)[:, np.newaxis],
        northing_m=eye.northing_m + away_m * np.cos(azimuth_rad)[:, np.newaxis],
    )
    up_m = ground_m - eye.eye_elevation_m - curvature.drop_m(away_m)
    with np.errstate(divide="ignore", invalid="ignore"):
        tan = np.where((away_m > 0.0) & np.isfinite(up_m), up_m / away_m, -np.inf)
    highest = np.maximum.accumulate(tan, axis=1)
    width = away_m.shape[1]
    first = np.concatenate(
        [
            np.searchsorted(line, elevation_tan[begin:end])
            for line, begin, end in zip(highest, bounds[:-1], bounds[1:], strict=True)
        ]
    )
    rows = np.repeat(np.arange(len(away_m)), np.diff(bounds))
    after = np.clip(first, 1, width - 1)
    before_m, after_m = away_m[rows, after - 1], away_m[rows, after]
    below = up_m[rows, after - 1] - elevation_tan * before_m
    above = up_m[rows, after] - elevation_tan * after_m
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -below / (above - below)
    # Past a hole the surface begins at the crossing.
    found = np.where(np.isfinite(share), before_m + share * (after_m - before_m), after_m)
    return np.where(first < width, found, np.nan)


def _carried_over(
    field: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    azimuth_rad: Float64Array,
    elevation_tan: Float64Array,
    near_m: Float64Array,
) -> Float64Array:
    """Refine distances at which rays meet the surface by Newton's method, where it converges."""
    eye_row, eye_col = field.to_grid(easting_m=eye.easting_m, northing_m=eye.northing_m)
    down = -np.cos(azimuth_rad) / field.spacing_north_m
    right = np.sin(azimuth_rad) / field.spacing_east_m

    def over(away_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return how far the terrain is above the rays, and its change with the distance."""
        row, col = eye_row + down * away_m, eye_col + right * away_m
        inside, (first, third, last), south, east = field.triangles(row, col)
        # Rises a sample southwards and eastwards.
        rise_south = np.where(east >= south, last - third, third - first)
        rise_east = np.where(east >= south, third - first, last - third)
        height_m = np.where(inside, first + south * rise_south + east * rise_east, np.nan)
        up_m = height_m - eye.eye_elevation_m - curvature.drop_m(away_m)
        falls = 2.0 * curvature.drop_per_m2 * away_m
        slope = rise_south * down + rise_east * right - falls - elevation_tan
        return up_m - elevation_tan * away_m, slope

    away_m, reach_m = near_m, _REACH_SAMPLES * field.spacing_m
    for _ in range(_NEWTON_STEPS):
        over_m, slope = over(away_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            # A ray enters the terrain only where the terrain rises more steeply than the ray.
            away_m = np.where(slope > 0.0, away_m - over_m / slope, np.nan)
    over_m, _ = over(away_m)
    is_met = (np.abs(over_m) <= _MET_RAD * away_m) & (np.abs(away_m - near_m) <= reach_m)
    return np.where(is_met & (away_m > 0.0), away_m, near_m)


def _border_m(field: HeightField, eye: Viewpoints, azimuth_rad: Float64Array) -> Float64Array:
    """Return the distance of the map's border along azimuths."""
    west, south, east, north = field.bounds_m
    at_east, at_north = float(eye.easting_m[0]), float(eye.northing_m[0])
    sine, cosine = np.sin(azimuth_rad), np.cos(azimuth_rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        sideways = np.where(sine > 0.0, east - at_east, at_east - west) / np.abs(sine)
        along = np.where(cosine > 0.0, north - at_north, at_north - south) / np.abs(cosine)
    return np.asarray(np.fmin(sideways, along))


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
        cols = ceil(_EDGE_BAND_M / terrain.spacing_east_m)
        rows = ceil(_EDGE_BAND_M / terrain.spacing_north_m)
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
            (from_middle_m[1] + distance_m * cosine) / max(high_m, _LEAST_SIDE_M),
            (from_middle_m[0] + distance_m * sine) / max(wide_m, _LEAST_SIDE_M),
        )
        is_far = np.where(is_across, sine, cosine) > 0.0
        parts = self.highest_m.shape[1]
        part = np.clip((share + 0.5) * parts, 0, parts - 1).astype(np.int32)
        part += (2 * is_far + ~is_across) * np.int32(parts)
        return np.maximum(distance_m, _LEAST_SIDE_M), self.highest_m.ravel()[part]


def _highest(band_m: FloatArray, reach: int) -> Float64Array:
    """Return the greatest height of a band (D, N) near each of P parts of its length N.

    Near means within ``reach`` samples of the part's middle. It is -inf where there are no data.
    """
    along_m = np.fmax.reduce(band_m, axis=0, initial=-np.inf)
    middle = ((np.arange(_EDGE_PARTS) + 0.5) * len(along_m) / _EDGE_PARTS).astype(np.intp)
    near = (along_m[max(at - reach, 0) : at + reach + 1].max() for at in middle)
    return np.fromiter(near, np.float64, _EDGE_PARTS)

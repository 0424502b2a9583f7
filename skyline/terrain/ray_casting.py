"""Ray casting on a height field.

Rays are intersected with the edges of the surface's triangles, up to where they first meet the
surface.

Distances are float64 and exact on the surface of triangles. A ray's ``elevation_tan`` is its rise
over its horizontal distance; the terrain drops with the square of the distance (`Curvature`).
"""

import numpy as np

from skyline.arrays import BoolArray, Float64Array, Int64Array
from skyline.geodesy.earth import Curvature
from skyline.progress import Progress
from skyline.terrain.heightfield import HeightField, heights_along
from skyline.terrain.viewpoints import Viewpoints

_CROSSINGS_AT_ONCE = 400_000
"""Crossings evaluated together: small enough to stay in the processor's cache."""


def edge_crossings_m(
    field: HeightField,
    eye: Viewpoints,
    azimuth_rad: Float64Array,
    near_m: Float64Array,
    far_m: Float64Array,
) -> tuple[Float64Array, BoolArray]:
    """Return the distances at which level rays cross edges.

    The K rays are followed from ``near_m`` to ``far_m`` (K,). The surface is a plane between two
    neighbouring crossings. Returns distances (K, C), unsorted, and a mask of the crossings among
    them; all other distances are ``near_m``.
    """
    row, col = field.to_grid(easting_m=eye.easting_m, northing_m=eye.northing_m)
    down, right = _samples_a_metre(field, azimuth_rad)
    crossings_m = []
    for start, a_metre in ((row, down), (col, right), (col - row, right - down)):
        ends = start + a_metre * np.stack([near_m, far_m])
        first = np.ceil(ends.min(axis=0))
        count = int(np.ceil(np.ptp(ends, axis=0).max())) + 1
        edge = first[:, np.newaxis] + np.arange(count)
        with np.errstate(divide="ignore", invalid="ignore"):
            crossings_m.append((edge - start) / a_metre[:, np.newaxis])
    away_m = np.concatenate(crossings_m, axis=1)
    is_between = (away_m > near_m[:, np.newaxis]) & (away_m < far_m[:, np.newaxis])
    return np.where(is_between, away_m, near_m[:, np.newaxis]), is_between


def highest_between_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    near_m: Float64Array,
    far_m: Float64Array,
) -> Float64Array:
    """Return the highest elevation angle of the terrain on each ray.

    Each of one eye's K rays is followed along its grid azimuth between two distances (K,). The
    surface is a plane between two edges, so the highest angle is at an edge. It is -90 without
    data.
    """
    away_m, is_between = edge_crossings_m(terrain, eye, grid_rad, near_m, far_m)
    up_deg = ground_elevation_deg(terrain, eye, curvature, grid_rad, away_m)
    return np.asarray(np.where(is_between, up_deg, -90.0).max(axis=1))


def ground_elevation_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    distance_m: Float64Array,
) -> Float64Array:
    """Return the ground's elevation angles (K, D) along one eye's rays.

    The rays have grid azimuths (K,); the horizontal distances are (D,) or (K, D). The angle is -90
    without data.
    """
    position_m = eye.easting_m[0], eye.northing_m[0]
    ground_m = heights_along(terrain, *position_m, grid_rad, distance_m)
    level_m = eye.eye_elevation_m[0] + curvature.drop_m(distance_m)
    up_deg = np.degrees(np.arctan((ground_m - level_m) / distance_m))
    return np.asarray(np.nan_to_num(up_deg, nan=-90.0))


def first_hits_m(
    field: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    azimuth_rad: Float64Array,
    elevation_tan: Float64Array,
    step_rad: float,
    progress: Progress | None,
) -> Float64Array:
    """Return the distances at which rays first meet the surface.

    The N rays are of one eye, and the distances horizontal. The profile of the terrain is followed
    along azimuths ``step_rad`` apart, and each ray first meets the nearest profile. From there the
    distance is carried over to the ray's own azimuth, if the surface allows it: beside a ridge's
    edge, the ray may see other terrain than the profile.

    Rays have grid azimuths and tangents of elevation angles (N,). The distances (N,) are exact for
    a ray within ``step_rad / 2`` of the given one in azimuth, and NaN for sky. ``progress`` is
    called with the number of rays that are done, and N.
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
        # A profile follows the middle of its rays' azimuths: rays of one azimuth are met exactly.
        begin = bounds[:-1] - bounds[0]
        least = np.minimum.reduceat(azimuth_rad[rays], begin)
        most = np.maximum.reduceat(azimuth_rad[rays], begin)
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
    """Return the distances at which rays meet the profiles of K azimuths.

    Rays ``bounds[k]`` to ``bounds[k + 1]`` belong to azimuth k.
    """
    # The factor keeps each point inside the border despite rounding.
    far_m = (1.0 - 1e-12) * _border_m(field, eye, azimuth_rad)
    crossing_m, _ = edge_crossings_m(field, eye, azimuth_rad, np.zeros_like(far_m), far_m)
    away_m = np.sort(np.column_stack([crossing_m, np.zeros_like(far_m), far_m]), axis=1)
    position_m = eye.easting_m[0], eye.northing_m[0]
    ground_m = heights_along(field, *position_m, azimuth_rad, away_m)
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
    before_m = away_m[rows, after - 1]
    after_m = away_m[rows, after]
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
    """Return where rays meet the surface near ``near_m``, by Newton's method.

    Where it does not converge, the distance is ``near_m``.
    """
    eye_row, eye_col = field.to_grid(easting_m=eye.easting_m, northing_m=eye.northing_m)
    down, right = _samples_a_metre(field, azimuth_rad)

    def over(away_m: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return the terrain's height above rays, and its slope with distance."""
        row = eye_row + down * away_m
        col = eye_col + right * away_m
        inside, (first, third, last), south, east = field.triangles(row, col)
        # Rises a sample southwards and eastwards.
        rise_south = np.where(east >= south, last - third, third - first)
        rise_east = np.where(east >= south, third - first, last - third)
        height_m = np.where(inside, first + south * rise_south + east * rise_east, np.nan)
        up_m = height_m - eye.eye_elevation_m - curvature.drop_m(away_m)
        falls = 2.0 * curvature.drop_per_m2 * away_m
        slope = rise_south * down + rise_east * right - falls - elevation_tan
        return up_m - elevation_tan * away_m, slope

    away_m = near_m
    for _ in range(4):
        over_m, slope = over(away_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            # A ray enters the terrain only where the terrain rises more steeply than the ray.
            away_m = np.where(slope > 0.0, away_m - over_m / slope, np.nan)
    over_m, _ = over(away_m)
    # A ray and the terrain have met if they are less than a microradian apart, as the eye sees it.
    is_met = np.abs(over_m) <= 1e-6 * away_m
    # The distance at a nearby azimuth may differ by two samples.
    is_met &= np.abs(away_m - near_m) <= 2.0 * field.spacing_m
    return np.where(is_met & (away_m > 0.0), away_m, near_m)


def _samples_a_metre(
    field: HeightField, azimuth_rad: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the rows and the columns that rays pass in a metre."""
    down = -np.cos(azimuth_rad) / field.spacing_north_m
    return down, np.sin(azimuth_rad) / field.spacing_east_m


def _border_m(field: HeightField, eye: Viewpoints, azimuth_rad: Float64Array) -> Float64Array:
    """Return the distance to the map's border along azimuths."""
    west, south, east, north = field.bounds_m
    at_east = float(eye.easting_m[0])
    at_north = float(eye.northing_m[0])
    sine = np.sin(azimuth_rad)
    cosine = np.cos(azimuth_rad)
    with np.errstate(divide="ignore", invalid="ignore"):
        sideways = np.where(sine > 0.0, east - at_east, at_east - west) / np.abs(sine)
        along = np.where(cosine > 0.0, north - at_north, at_north - south) / np.abs(cosine)
    return np.asarray(np.fmin(sideways, along))

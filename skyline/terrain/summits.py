"""Summits of a height field, and the prominence of hills.

The highest sample of a summit lies up to a sample's spacing beside the true summit. An eye beside
that sample stands on the model's slope, with the summit in front of it like a wall, although the
model cannot tell the two positions apart.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array
from skyline.terrain.heightfield import HeightField

SUMMIT_RADIUS_M = 150.0
"""Greatest distance of a summit from its named place; terrain this near to a summit does not hide
it."""
_BESIDE = 1e-8 * np.exp(1j * np.radians([22.5, 67.5, 135.0, 202.5, 247.5, 315.0]))
"""Steps from a sample into each triangle around it, in samples to the east plus i times to the
south."""


def highest_within(
    field: HeightField, easting_m: float, northing_m: float, within_m: float
) -> tuple[float, float]:
    """Return easting and northing of the highest point in a disc.

    ``within_m`` is the disc's radius. On each triangle the height is linear. The highest point in
    the disc is therefore at a sample, where an edge leaves the disc, or where the steepest way up
    from the disc's middle on a triangle's plane leaves it. Among points of equal height the nearest
    is returned; without a surface, the disc's middle.
    """
    row, col = (float(at) for at in field.to_grid(easting_m=easting_m, northing_m=northing_m))
    south_m = field.spacing_north_m
    east_m = field.spacing_east_m
    rows, cols = (
        np.arange(max(0, math.ceil(at - reach) - 1), min(count, math.floor(at + reach) + 2))
        for at, reach, count in (
            (row, within_m / south_m, field.rows),
            (col, within_m / east_m, field.cols),
        )
    )
    if not (rows.size and cols.size):
        return easting_m, northing_m
    down_m = (rows - row) * south_m
    right_m = (cols - col) * east_m
    # Points are offsets to the east plus i times offsets to the south.
    points = [np.zeros(1, np.complex128), (right_m + 1j * down_m[:, np.newaxis]).ravel()]
    diagonal_m = math.hypot(south_m, east_m)
    diagonals = np.arange(cols[0] - rows[-1], cols[-1] - rows[0] + 1) - (col - row)
    for normal, away_m in (
        (1.0 + 0.0j, right_m),
        (0.0 + 1.0j, down_m),
        (complex(south_m, -east_m) / diagonal_m, diagonals * (south_m * east_m / diagonal_m)),
    ):
        met_m = away_m[np.abs(away_m) <= within_m]
        half_m = np.sqrt(within_m**2 - met_m**2)
        points += [normal * (met_m + 1j * half_m), normal * (met_m - 1j * half_m)]
    heights = field.samples_at(rows[:, np.newaxis], cols).astype(np.float64)
    up_east = np.diff(heights, axis=1) / east_m
    up_south = np.diff(heights, axis=0) / south_m
    for up in (
        up_east[:-1] + 1j * up_south[:, 1:],  # the north-eastern triangles
        up_east[1:] + 1j * up_south[:, :-1],
    ):
        sloping = up[np.abs(up) > 0.0]
        points.append(within_m * sloping / np.abs(sloping))
    point = np.concatenate(points)
    point = point[np.abs(point) <= within_m * (1.0 + 1e-12)]
    # Rounding must not decide in which triangle a point lies: the triangle may be a hole.
    point = (point[:, np.newaxis] + east_m * _BESIDE.real + 1j * south_m * _BESIDE.imag).ravel()
    easting = easting_m + point.real
    northing = northing_m - point.imag
    # To the millimetre, since rounding must not prefer one point of level ground to another.
    height = np.nan_to_num(
        np.round(field.height_at(easting_m=easting, northing_m=northing), 3), nan=-np.inf
    )
    best = np.lexsort((np.abs(point), -height))[0]
    return float(easting[best]), float(northing[best])


def summit_near(
    terrain: HeightField, easting_m: float, northing_m: float
) -> tuple[float, float, float] | None:
    """Return easting, northing and height of the highest sample near a place.

    Returns None off the terrain, and where there is no sample.
    """
    row, col = (float(at) for at in terrain.to_grid(easting_m=easting_m, northing_m=northing_m))
    if not (0.0 <= row <= terrain.rows - 1 and 0.0 <= col <= terrain.cols - 1):
        return None
    reach_rows = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_north_m)
    reach_cols = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_east_m)
    top = max(0, math.ceil(row - reach_rows))
    left = max(0, math.ceil(col - reach_cols))
    near = terrain.part(
        slice(top, math.floor(row + reach_rows) + 1), slice(left, math.floor(col + reach_cols) + 1)
    )
    if np.isnan(near).all():
        return None
    at_row, at_col = np.unravel_index(np.nanargmax(near), near.shape)
    east, north = terrain.to_map(top + at_row, left + at_col)
    return float(east), float(north), float(near[at_row, at_col])


def summit_heights_m(
    field: HeightField, easting_m: Float64Array, northing_m: Float64Array
) -> Float64Array:
    """Return the height of the summit at each position.

    The heights (N,) are NaN where there is no summit. The highest sample within one spacing of the
    position is a summit if the ground around it falls off by twice `HeightField.height_sd_m` on all
    sides within 16 samples, before it rises by half of that deviation. Beyond holes and the border
    it may rise.
    """
    row, col = field.to_grid(easting_m=easting_m, northing_m=northing_m)
    near = np.arange(-1, 3)
    rows = np.floor(row).astype(np.int64)[:, np.newaxis] + np.repeat(near, 4)
    cols = np.floor(col).astype(np.int64)[:, np.newaxis] + np.tile(near, 4)
    within = np.hypot(rows - row[:, np.newaxis], cols - col[:, np.newaxis]) <= 1.0
    heights = np.where(within, _heights(field, rows, cols, -np.inf), -np.inf)
    each = np.arange(len(row))
    highest = heights.argmax(axis=1)
    top_row, top_col, top_m = (one[each, highest] for one in (rows, cols, heights))
    side = np.arange(-1, 2)
    around = _heights(
        field,
        top_row[:, np.newaxis] + np.repeat(side, 3),
        top_col[:, np.newaxis] + np.tile(side, 3),
        np.inf,
    )
    fall_m = 2.0 * field.height_sd_m
    level_m = 0.5 * field.height_sd_m
    summit_m = np.full(len(row), np.nan)
    for index in np.flatnonzero(np.isfinite(top_m) & (top_m + level_m >= around.max(axis=1))):
        hill = _framed(field, int(top_row[index]), int(top_col[index]), reach=16)
        if _falls_by(hill, fall_m, level_m):
            summit_m[index] = top_m[index]
    return summit_m


def prominence_m(field: HeightField, row: int, col: int) -> float:
    """Return a sample's least descent to higher ground, metres.

    Ground counts as higher if it is more than `HeightField.height_sd_m` above the sample, because
    the sample nearest to a named peak is not always the highest of its hill. Unknown ground, and
    ground more than 64 samples away, counts as higher. The descent is exact to a metre.
    """
    hill = _framed(field, row, col, reach=64)
    low_m = 0.0
    high_m = float(hill[hill.shape[0] // 2, hill.shape[1] // 2]) - float(hill.min())
    while high_m - low_m > 1.0:
        fall_m = 0.5 * (low_m + high_m)
        if _falls_by(hill, fall_m, field.height_sd_m):
            low_m = fall_m
        else:
            high_m = fall_m
    return low_m


def _heights(
    field: HeightField, rows: ArrayLike, cols: ArrayLike, missing_m: float
) -> Float64Array:
    """Return the heights of samples, ``missing_m`` for holes and off the map."""
    rows, cols = np.broadcast_arrays(rows, cols)
    inside = (rows >= 0) & (rows < field.rows) & (cols >= 0) & (cols < field.cols)
    heights = field.samples_at(np.where(inside, rows, 0), np.where(inside, cols, 0))
    return np.where(inside & ~np.isnan(heights), heights, missing_m).astype(np.float64)


def _framed(field: HeightField, row: int, col: int, reach: int) -> Float64Array:
    """Return heights around a sample, infinite in holes.

    The window reaches ``reach`` samples from the middle, with an infinite frame around it.
    """
    near = np.arange(-reach, reach + 1)
    heights = _heights(field, row + near[:, np.newaxis], col + near, np.inf)
    return np.pad(heights, 1, constant_values=np.inf)


def _falls_by(around_m: Float64Array, fall_m: float, rise_m: float) -> bool:
    """Return whether ground falls by ``fall_m`` all round a window's middle.

    On the way it may rise by ``rise_m`` above the middle.
    """
    import cv2  # noqa: PLC0415  (slow to load, seldom needed)

    middle = around_m.shape[0] // 2, around_m.shape[1] // 2
    hills = cv2.connectedComponents((around_m >= around_m[middle] - fall_m).view(np.uint8))[1]
    return bool(around_m[hills == hills[middle]].max() <= around_m[middle] + rise_m)

"""Keypoints of the paper's section 3: the vertices of polylines that approximate skylines."""

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array, IntArray

NO_KEYPOINT = 65535
"""Value that pads the rows of keypoint tables."""

DEFAULT_MAX_KEYPOINTS = 128


def polyline_vertices(
    curves: NDArray[np.floating], tolerance: float, max_vertices: int = DEFAULT_MAX_KEYPOINTS
) -> NDArray[np.uint16]:
    """Approximate curves sampled at equal steps by polylines; return the vertices' columns.

    Douglas-Peucker with the vertical distance, all curves at once: each round splits every
    segment that misses its curve by more than the tolerance at the column it misses most. The
    first and last column of every run of finite samples are vertices, so a gap splits the
    polyline and the tolerance holds in each run on its own.

    Where a curve has more than ``max_vertices``, the most significant stay. The significance of a
    vertex is the miss that made it, but never more than that of the vertex whose segment it
    splits: the rest is the polyline of a coarser tolerance. The ends of runs come first, those of
    longer runs before others.

    Curves are (N, W), W below 65535; NaN marks a gap. The tolerance is in their unit; 0 keeps every
    bend. Columns (N, max_vertices) ascend and are padded with `NO_KEYPOINT`.
    """
    count, width = curves.shape
    flat = curves.astype(np.float64).reshape(-1)
    first, last = _runs(curves)
    inner, significance = _split(flat, first, last, tolerance)
    bent = last > first
    position = np.concatenate([first, last[bent], inner])
    length = (last - first).astype(np.float64)
    rank = np.concatenate([np.full(len(first) + bent.sum(), np.inf), significance])
    run_length = np.concatenate([length, length[bent], np.zeros(len(inner))])
    order = np.lexsort((-run_length, -rank, position // width))
    return _most_significant(position[order], (count, width), max_vertices)


def _runs(curves: NDArray[np.floating]) -> tuple[IntArray, IntArray]:
    """Return the flat index of the first and last sample of every run of finite samples."""
    width = curves.shape[1]
    finite = np.pad(np.isfinite(curves), ((0, 0), (1, 1))).astype(np.int8)
    change = np.diff(finite, axis=1)
    row, column = np.nonzero(change == 1)
    first = row * width + column
    row, column = np.nonzero(change == -1)
    return first, row * width + column - 1


def _split(
    flat: Float64Array, left: IntArray, right: IntArray, tolerance: float
) -> tuple[IntArray, Float64Array]:
    """Return flat indices and significances of the vertices inside segments left..right."""
    positions, significances = [np.zeros(0, dtype=np.intp)], [np.zeros(0)]
    bound = np.full(len(left), np.inf)
    while (long := right - left > 1).any():
        left, right, bound = left[long], right[long], bound[long]
        worst, middle = _worst_miss(flat, left, right)
        missed = worst > tolerance
        left, right, middle = left[missed], right[missed], middle[missed]
        bound = np.minimum(bound, worst)[missed]
        positions.append(middle)
        significances.append(bound)
        left, right = np.concatenate([left, middle]), np.concatenate([middle, right])
        bound = np.concatenate([bound, bound])
    return np.concatenate(positions), np.concatenate(significances)


def _worst_miss(
    flat: Float64Array, left: IntArray, right: IntArray
) -> tuple[Float64Array, IntArray]:
    """Return each segment's greatest vertical distance to its chord and where it is."""
    count = right - left - 1
    start = np.cumsum(count) - count
    segment = np.repeat(np.arange(len(left)), count)
    step = np.arange(len(segment)) - start[segment] + 1
    slope = (flat[right] - flat[left]) / (right - left)
    at = left[segment] + step
    miss = np.abs(flat[at] - flat[left][segment] - slope[segment] * step)
    worst = np.maximum.reduceat(miss, start)
    hit = np.flatnonzero(miss == worst[segment])
    # Of equal misses the leftmost counts.
    hit = hit[np.diff(segment[hit], prepend=-1) > 0]
    return worst, at[hit]


def _most_significant(
    position: IntArray, shape: tuple[int, int], max_vertices: int
) -> NDArray[np.uint16]:
    """Return a padded table of columns from flat indices in (row, significance) order."""
    count, width = shape
    row = position // width
    per_row = np.bincount(row, minlength=count)
    place = np.arange(len(row)) - (np.cumsum(per_row) - per_row)[row]
    kept = place < max_vertices
    table = np.full((count, max_vertices), NO_KEYPOINT, dtype=np.uint16)
    table[row[kept], place[kept]] = position[kept] % width
    return np.sort(table, axis=1)

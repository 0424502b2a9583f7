"""Heights between samples, by cubic convolution (Keys 1981, a = -1/2)."""

import numpy as np

from skyline.arrays import Float32Array, Float64Array

_AROUND = (1, 2)
"""Of the four rows and columns of a cubic, those next to the position."""
# Positions this near the outermost source samples are on them, but for rounding.
_SLACK = 1e-6


def cubic(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Float32Array:
    """Return heights at fractional rows and columns, NaN outside and on holes.

    Parameters
    ----------
    heights_m : (rows, cols) float32
        NaN marks holes.
    row, col : float64, of one shape

    Returns
    -------
    float32 of that shape
        None is above or below the four samples around its position. Where one of the 4 x 4 samples
        is a hole it is interpolated bilinearly, and where the nearest is, it is a hole.
    """
    rows, cols = heights_m.shape
    # A source of a single row has no inside; its samples stand for their pixels.
    row_margin, col_margin = (0.5 if n == 1 else _SLACK for n in (rows, cols))
    inside = (row >= -row_margin) & (row <= rows - 1 + row_margin)
    inside &= (col >= -col_margin) & (col <= cols - 1 + col_margin)
    row = np.clip(np.where(inside, row, 0.0), 0.0, rows - 1)
    col = np.clip(np.where(inside, col, 0.0), 0.0, cols - 1)
    top, left = row.astype(np.int64), col.astype(np.int64)
    row_weights, col_weights = _keys_weights(row - top), _keys_weights(col - left)
    flat = heights_m.reshape(-1)
    warped = np.zeros(row.shape, dtype=np.float32)
    lowest, highest = np.full_like(warped, np.inf), np.full_like(warped, -np.inf)
    beside = [np.clip(left + (j - 1), 0, cols - 1) for j in range(4)]
    for i in range(4):
        line = np.clip(top + (i - 1), 0, rows - 1) * cols
        along = np.zeros(row.shape, dtype=np.float32)
        for j in range(4):
            sample = flat.take(line + beside[j])
            along += col_weights[j] * sample
            if i in _AROUND and j in _AROUND:
                np.minimum(lowest, sample, out=lowest)
                np.maximum(highest, sample, out=highest)
        warped += row_weights[i] * along
    np.clip(warped, lowest, highest, out=warped)
    partial = (top < 1) | (top > rows - 3) | (left < 1) | (left > cols - 3) | np.isnan(warped)
    partial &= inside
    warped[partial] = _bilinear(heights_m, row[partial], col[partial])
    warped[~inside] = np.nan
    return warped


def _keys_weights(t: Float64Array) -> list[Float32Array]:
    """Return the weights of the samples at -1, 0, 1 and 2 for a position t in [0, 1)."""
    return [
        (((2.0 - t) * t - 1.0) * t * 0.5).astype(np.float32),
        (((3.0 * t - 5.0) * t * t + 2.0) * 0.5).astype(np.float32),
        (((4.0 - 3.0 * t) * t + 1.0) * t * 0.5).astype(np.float32),
        ((t - 1.0) * t * t * 0.5).astype(np.float32),
    ]


def _bilinear(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Float64Array:
    rows, cols = heights_m.shape
    top, left = row.astype(np.int64), col.astype(np.int64)
    south, east = row - top, col - left
    total = np.zeros(row.shape)
    known_weight = np.zeros(row.shape)
    for below, row_weight in ((0, 1.0 - south), (1, south)):
        for right, col_weight in ((0, 1.0 - east), (1, east)):
            sample = heights_m[
                np.minimum(top + below, rows - 1), np.minimum(left + right, cols - 1)
            ]
            weight = np.where(np.isnan(sample), 0.0, row_weight * col_weight)
            total += weight * np.nan_to_num(sample)
            known_weight += weight
    nearest = heights_m[np.rint(row).astype(np.int64), np.rint(col).astype(np.int64)]
    known = ~np.isnan(nearest)
    return np.where(known, total / np.where(known, known_weight, 1.0), np.nan)

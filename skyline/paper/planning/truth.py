"""What predictions are held to: a stored skyline against the one rendered at another eye."""

import numpy as np

from skyline.arrays import Float32Array, Float64Array, FloatArray
from skyline.errors import InputError
from skyline.paper.planning.reprojection import (
    IDENTITY,
    Projected,
    displacements_m,
    equation_4,
    least_squares,
    median_depth_m,
)
from skyline.paper.planning.warp_fit import WarpFit
from skyline.views import Views

_FIT = WarpFit(rounds=6)
_COLUMNS = (20, 40, 80, 160, 320)
"""Columns of the coarser curves a warp is found on first: a rough skyline has many valleys."""

_AT_ONCE = 64


def true_errors_px(stored: Views, rendered: Views) -> Float32Array:
    """Return mean distances (N,) in px of stored skylines from rendered ones after the best warp.

    The warp is affine, and bounded as `WarpFit` says. The distance is vertical, over the columns
    that land in frame; it is infinite where these are fewer than half of them.

    Raises `InputError` for views that differ in number, width or heading.

    Parameters
    ----------
    stored, rendered : Views
        N views each, row by row of one heading and one width.
    """
    if len(stored) != len(rendered) or stored.width != rendered.width:
        raise InputError(
            f"{len(stored)} stored views of {stored.width} columns are compared with "
            f"{len(rendered)} rendered ones of {rendered.width}; expected as many of one width"
        )
    if (stored.heading != rendered.heading).any():
        raise InputError("stored and rendered views look along different headings")
    errors = np.empty(len(stored), dtype=np.float32)
    for begin in range(0, len(stored), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        errors[part] = _errors_px(stored[part], rendered[part])
    return errors


def _errors_px(stored: Views, rendered: Views) -> Float64Array:
    best = np.full(len(stored), np.inf)
    for warp in np.moveaxis(_starts(stored, rendered), 1, 0):
        start = warp[:, np.newaxis]
        for columns in (*(c for c in _COLUMNS if c < stored.width), stored.width):
            distances, found = _FIT.distances_px(
                block_means(stored.elevation_tan, columns),
                block_means(rendered.elevation_tan, columns),
                start,
                stored.width,
            )
            start = found[:, np.newaxis]
        best = np.minimum(best, distances)
    return best


def _starts(stored: Views, rendered: Views) -> Float64Array:
    """Return the identity, Equation 4's warp and the least squares of the points, (N, 3, 2, 3)."""
    moved = displacements_m(
        stored,
        rendered.easting_m[:, np.newaxis],
        rendered.northing_m[:, np.newaxis],
        rendered.eye_elevation_m[:, np.newaxis],
    )
    projected = Projected.of(stored, moved, stored.width)
    by_points = least_squares(projected.points_uv, projected.there_uv, projected.usable)
    by_depth = equation_4(median_depth_m(stored.depth_m), moved)
    return np.concatenate([np.broadcast_to(IDENTITY, by_depth.shape), by_depth, by_points], axis=1)


def block_means(rows: FloatArray, blocks: int) -> Float32Array:
    """Return means (..., min(blocks, W)) over runs of the columns of rows (..., W).

    Runs are as equal as can be. NaN is unknown: left out, and the mean where all of a run is.
    """
    width = rows.shape[-1]
    if width <= blocks:
        return rows.astype(np.float32)
    starts = np.arange(blocks) * width // blocks
    known = np.isfinite(rows)
    count = np.add.reduceat(known, starts, axis=-1, dtype=np.float32)
    total = np.add.reduceat(np.where(known, rows, 0.0), starts, axis=-1)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan).astype(np.float32)

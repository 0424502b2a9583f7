"""Predicted views: what a stored view says is seen from displaced eyes, without rendering.

The points of a stored skyline lie on polylines in space: a column's point is joined to its
neighbour's where both belong to the same surface. From a displaced eye every point projects
elsewhere, and what is seen is the upper envelope of the displaced polylines, sampled at the column
centres. A straight segment stays straight in the image, so sampling it is linear interpolation.

What enters a displaced frame from the side is mostly near terrain that the view itself does not
show. The views of the two neighbouring headings from the same eye, its flanks, do.

The drop by curvature and refraction is taken over from the stored view. Moving by t changes it,
seen from the new eye, by at most |t| (1 - k) / R in v: 0.013 px for 300 m.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, FloatArray, IntArray
from skyline.camera import HEADINGS, columns_u
from skyline.errors import InputError
from skyline.paper.reprojection import displacements_m
from skyline.skylines import FLAG_NO_DATA, Views
from skyline.terrain.viewpoints import Viewpoints

NO_VIEW = -1

MAX_DEPTH_RATIO = 1.5
"""Neighbouring columns whose depths differ by more are two surfaces, one behind the other.

Measured on Davos (4,800 displaced skylines): at 1.5 the segments that bridge an occlusion raise
0.1 % of the columns by over 1 px, at 4 0.8 %, without a limit 3.6 %; below 1.5 more and more of
the true skyline is missing, at 1.05 2 % of the columns."""

MIN_DEPTH_M = 1.0
"""What comes nearer than this to the eye's own plane, or behind it, is not seen."""

_POINTS_AT_ONCE = 1 << 18
"""Points projected together, which bounds the memory in use."""


def predict(stored: Views, source: NDArray[np.integer], targets: Viewpoints) -> Views:
    """Predict the views of other eyes along the headings of stored views.

    Stored views of the two neighbouring headings from the same eye add what they know. A column of
    which nothing is known is NaN and flagged `FLAG_NO_DATA`.

    Raises `InputError` for sources and targets that differ in number, or a source that is no row.

    Parameters
    ----------
    source : (M,) int
        The stored view that each prediction is made from; it gives the heading.
    targets : Viewpoints
        M eyes; their views are in this order.
    """
    source = np.asarray(source)
    if source.shape != (len(targets),):
        raise InputError(
            f"sources have shape {source.shape}; expected ({len(targets)},), one stored view for "
            "each target"
        )
    if source.size and (source.min() < 0 or source.max() >= len(stored)):
        raise InputError(
            f"sources run from {source.min()} to {source.max()}; expected rows of the "
            f"{len(stored)} stored views"
        )
    sides = flanks(stored)
    tan = np.empty((len(source), stored.width), dtype=np.float32)
    depth = np.empty_like(tan)
    for view in np.unique(source).tolist():
        rows = np.flatnonzero(source == view)
        there = displacements_m(
            stored[view : view + 1],
            targets.easting_m[np.newaxis, rows],
            targets.northing_m[np.newaxis, rows],
            targets.eye_elevation_m[np.newaxis, rows],
        )[0]
        lines = polylines(stored, view, sides[view], reach_m(there))
        some = max(1, _POINTS_AT_ONCE // max(1, len(lines.up_m)))
        for begin in range(0, len(rows), some):
            part = slice(begin, begin + some)
            tan[rows[part]], depth[rows[part]] = seen_from(lines, there[part], stored.width)
    return Views(
        targets.easting_m,
        targets.northing_m,
        targets.eye_elevation_m,
        stored.heading[source],
        tan,
        depth,
        np.where(np.isnan(tan), FLAG_NO_DATA, 0).astype(np.uint8),
    )


def reach_m(displacements_m: NDArray[np.floating]) -> float:
    """Return how far displacements (C, 3) go along the ground at most, NaN left out; 0 for none."""
    right, _, forward = np.asarray(displacements_m, dtype=np.float64).T
    return float(np.fmax.reduce(np.hypot(right, forward), initial=0.0))


def flanks(views: Views) -> IntArray:
    """Return the views (N, 2) that look left and right from the same eye.

    These are the rows of the views with heading - 1 and heading + 1, of several the first, and
    `NO_VIEW` where there is none.
    """
    eyes = np.stack([views.easting_m, views.northing_m, views.eye_elevation_m], axis=1)
    eye = np.unique(eyes, axis=0, return_inverse=True)[1].reshape(-1)
    heading = views.heading.astype(np.intp)
    seen, first = np.unique(eye * len(HEADINGS) + heading, return_index=True)
    table = np.full((len(views), len(HEADINGS)), NO_VIEW, dtype=np.intp)
    table.ravel()[seen] = first
    return np.stack([table[eye, (heading - 1) % 4], table[eye, (heading + 1) % 4]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Polylines:
    """M points of some polylines, one after the other, in the axes of one view."""

    right_m: Float32Array
    up_m: Float32Array
    forward_m: Float32Array
    """``right_m``, ``up_m``, ``forward_m``: (M,) float32. From the eye."""
    joined: BoolArray
    """(M,) bool. Whether a point is joined to the next one; the last is not."""


def polylines(views: Views, view: int, sides: IntArray, reach_m: float) -> Polylines:
    """Return what may be seen from within reach of a view's eye.

    Terrain is left out that stays outside the frame wherever the eye goes.

    Parameters
    ----------
    sides : (2,) int
        The views to its left and right; see `flanks`.
    reach_m : float
        Along the ground.
    """
    # Right and forward of a point at u and depth 1 in the view to the left, itself, to the right.
    u = columns_u(views.width).astype(np.float32)
    ones = np.ones_like(u)
    turns = [(sides[0], (-ones, u)), (view, (u, ones)), (sides[1], (ones, -u))]
    shown = [(index, turn) for index, turn in turns if index != NO_VIEW]
    tan = np.concatenate([views.elevation_tan[index] for index, _ in shown]).astype(np.float32)
    depth = np.concatenate([views.depth_m[index] for index, _ in shown]).astype(np.float32)
    right_m, forward_m = np.concatenate([turn for _, turn in shown], axis=1) * depth
    known = np.isfinite(tan) & np.isfinite(depth)
    # The frame's sides are diagonals, so an eye moves at most sqrt(2) reach against them.
    wanted = known & (np.abs(right_m) - forward_m <= np.sqrt(2.0) * reach_m)
    ratio = depth[1:] / depth[:-1]
    joined = np.zeros(tan.shape, dtype=bool)
    joined[:-1] = (
        (known[1:] & known[:-1])
        & (wanted[1:] | wanted[:-1])
        & (ratio <= MAX_DEPTH_RATIO)
        & (ratio >= 1.0 / MAX_DEPTH_RATIO)
    )
    kept = joined.copy()
    kept[1:] |= joined[:-1]
    return Polylines(right_m[kept], (tan * depth)[kept], forward_m[kept], joined[kept])


def seen_from(
    lines: Polylines, displacements_m: FloatArray, columns: int
) -> tuple[Float32Array, Float32Array]:
    """Return the skylines of polylines from displaced eyes.

    Parameters
    ----------
    displacements_m : (C, 3) floating
        Right, up, forward; an eye with a NaN sees nothing.
    columns : int
        Columns Q of the curves that are returned.

    Returns
    -------
    elevation_tan, depth_m : (C, Q) float32
        At the column centres, NaN where no polyline passes.
    """
    right, up, forward = displacements_m.astype(np.float32).T[:, :, np.newaxis]
    # An eye that is nowhere has everything behind it.
    behind = lines.forward_m - np.where(np.isfinite(up), forward, np.float32(np.inf))
    nearness = 1.0 / np.where(behind > MIN_DEPTH_M, behind, np.float32(np.nan))
    position = (lines.right_m - right) * nearness
    position *= np.float32(columns / 2.0)
    position += np.float32((columns - 1) / 2.0)
    start, segment, column, along = _crossings(position, lines.joined, columns)

    def at_columns(values: FloatArray) -> FloatArray:
        flat = values.ravel()
        begin = flat[start]
        rise = flat[start + 1] - begin
        return begin[segment] + along * rise[segment]

    cell = (start // max(len(lines.joined), 1))[segment] * columns + column
    elevation_tan = at_columns((lines.up_m - up) * nearness)
    tan = np.full(len(displacements_m) * columns, -np.inf, dtype=np.float32)
    np.maximum.at(tan, cell, elevation_tan)
    highest = elevation_tan == tan[cell]
    depth = np.full_like(tan, np.nan)
    np.fmin.at(depth, cell[highest], (1.0 / at_columns(nearness))[highest])
    tan[np.isneginf(tan)] = np.nan
    shape = (len(displacements_m), columns)
    return tan.reshape(shape), depth.reshape(shape)


def _crossings(
    position: Float32Array, joined: BoolArray, columns: int
) -> tuple[IntArray, IntArray, IntArray, Float32Array]:
    """Return where the segments between points pass column centres in the images of C eyes.

    ``position`` (C, M) is the points' columns; ``joined`` (M,) says which are joined to the next.
    Returned are the first point of each passing segment, its eye times M plus its index (P,); and
    of each place where one passes a column, the segment, the column and how far along the segment
    that is in the image (S,).
    """
    flat = position.ravel()
    first = np.ceil(np.maximum(np.minimum(flat[:-1], flat[1:]), 0.0))
    last = np.floor(np.minimum(np.maximum(flat[:-1], flat[1:]), np.float32(columns - 1)))
    passes = np.zeros(position.shape, dtype=bool)
    passes.ravel()[:-1] = first <= last
    passes &= joined
    start = np.flatnonzero(passes)
    first = first[start]
    count = (last[start] - first).astype(np.intp) + 1
    segment = np.repeat(np.arange(len(start)), count)
    skipped = np.cumsum(count) - count - first.astype(np.intp)
    column = np.arange(len(segment)) - skipped[segment]
    span = flat[start + 1] - flat[start]
    # A segment seen end on counts as its beginning.
    rate = np.divide(1.0, span, out=np.zeros_like(span), where=np.abs(span) > 1e-6)
    return (
        start,
        segment,
        column,
        (column.astype(np.float32) - flat[start][segment]) * rate[segment],
    )

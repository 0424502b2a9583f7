"""Skylines as polylines in space, and the curve a displaced eye sees of them.

The points of a stored skyline, or of each of its distance shells, lie on polylines in space: a
column's point is joined to its neighbour's where both belong to the same surface. From a
displaced eye every point projects elsewhere, and what is seen is the upper envelope of the
displaced polylines, sampled at the column centres. A straight segment stays straight in the
image, so sampling it is linear interpolation.

What enters a displaced frame from the side is mostly near terrain that the view itself does not
show. The views of the two neighbouring headings from the same eye, its flanks, do.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, FloatArray, IntArray
from skyline.camera import HEADINGS, columns_u
from skyline.views import Views

NO_VIEW = -1

MAX_DEPTH_RATIO = 1.5
"""Neighbouring columns whose depths differ by more are two surfaces, one behind the other.

Measured on Davos (4,800 displaced skylines): at 1.5 the segments that bridge an occlusion raise
0.1 % of the columns by over 1 px, at 4 0.8 %, without a limit 3.6 %; below 1.5 more and more of
the true skyline is missing, at 1.05 2 % of the columns."""

MIN_DEPTH_M = 1.0
"""What comes nearer than this to the eye's own plane, or behind it, is not seen."""

_STEEPNESS = 0.5
"""How steep in the image a skyline is taken to be where an eye moves sideways along it."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How far some eyes are from a view's own, at most."""

    horizontal_m: float
    vertical_m: float

    @classmethod
    def of(cls, displacements_m: NDArray[np.floating]) -> "Reach":
        """Return the reach of displacements (C, 3), NaN left out; 0 for none."""
        right, up, forward = np.asarray(displacements_m, dtype=np.float64).T
        horizontal = np.fmax.reduce(np.hypot(right, forward), initial=0.0)
        return cls(float(horizontal), float(np.fmax.reduce(np.abs(up), initial=0.0)))


def flanks(views: Views) -> IntArray:
    """Return the views that look left and right from the same eye.

    Returns
    -------
    (N, 2) intp
        Index of the view with heading - 1 and of that with heading + 1, `NO_VIEW` where there is
        none. Of several, the first.
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
    """M points of some polylines, one after the other, in the axes of one view.

    Attributes
    ----------
    right_m, up_m, forward_m : (M,) float32
        From the eye.
    joined : (M,) bool
        Whether a point is joined to the next one; the last is not.
    layer : (M,) intp
        The shell a point belongs to; 0 for a skyline.
    """

    right_m: Float32Array
    up_m: Float32Array
    forward_m: Float32Array
    joined: BoolArray
    layer: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Scenery:
    """What N views know of the terrain around their eyes, in few columns.

    Attributes
    ----------
    elevation_tan, depth_m : (N, K, Q) float32
        Of each of K layers: the distance shells, or the skyline alone. NaN is unknown.
    flanks : (N, 2) intp
        The views to the left and right of each, `NO_VIEW` where there is none.
    """

    elevation_tan: Float32Array
    depth_m: Float32Array
    flanks: IntArray

    @classmethod
    def of(cls, views: Views, columns: int, use_shells: bool) -> "Scenery":
        """Reduce views to at most ``columns`` columns."""
        if use_shells and views.shells is not None:
            tan, depth = views.shells.elevation_tan, views.shells.depth_m
        else:
            tan, depth = views.elevation_tan[:, np.newaxis], views.depth_m[:, np.newaxis]
        return cls(block_means(tan, columns), block_means(depth, columns), flanks(views))

    @property
    def layers(self) -> int:
        """Number of layers K."""
        return int(self.elevation_tan.shape[1])

    @property
    def columns(self) -> int:
        """Number of columns Q."""
        return int(self.elevation_tan.shape[2])

    def polylines(self, view: int, reach: "Reach") -> Polylines:
        """Return what may be seen from within reach of a view's eye.

        Terrain is left out that stays outside the frame wherever the eye goes, and terrain that
        the rest of its column hides by more than moving so far can undo.
        """
        left, right = self.flanks[view]
        sides = [(view, _own)]
        if left != NO_VIEW:
            sides.insert(0, (int(left), _left))
        if right != NO_VIEW:
            sides.append((int(right), _right))
        tan = np.concatenate([self.elevation_tan[index] for index, _ in sides], axis=1)
        depth = np.concatenate([self.depth_m[index] for index, _ in sides], axis=1)
        u = columns_u(self.columns).astype(np.float32)
        ground = [turn(u, self.depth_m[index]) for index, turn in sides]
        right_m, forward_m = (np.concatenate(part, axis=1) for part in zip(*ground, strict=True))

        known = np.isfinite(tan) & np.isfinite(depth)
        # The frame's sides are diagonals, so an eye moves at most sqrt(2) reach against them.
        in_frame = np.abs(right_m) - forward_m <= np.sqrt(2.0) * reach.horizontal_m
        wanted = known & in_frame & surfacing(np.where(known, tan, np.nan), depth, reach)
        ratio = depth[:, 1:] / depth[:, :-1]
        joined = np.zeros(tan.shape, dtype=bool)
        joined[:, :-1] = (
            (known[:, 1:] & known[:, :-1])
            & (wanted[:, 1:] | wanted[:, :-1])
            & (ratio <= MAX_DEPTH_RATIO)
            & (ratio >= 1.0 / MAX_DEPTH_RATIO)
        )
        kept = joined.copy()
        kept[:, 1:] |= joined[:, :-1]
        return Polylines(
            right_m[kept],
            (tan * depth)[kept],
            forward_m[kept],
            joined[kept],
            np.nonzero(kept)[0],
        )


def block_means(rows: FloatArray, blocks: int) -> Float32Array:
    """Return means over runs of columns, unknown ones left out.

    Parameters
    ----------
    rows : (..., W) floating
        NaN is unknown.
    blocks : int
        Number of runs, as equal as can be.

    Returns
    -------
    (..., min(blocks, W)) float32, NaN where all of a run is unknown
    """
    width = rows.shape[-1]
    if width <= blocks:
        return rows.astype(np.float32)
    starts = np.arange(blocks) * width // blocks
    known = np.isfinite(rows)
    count = np.add.reduceat(known, starts, axis=-1, dtype=np.float32)
    total = np.add.reduceat(np.where(known, rows, 0.0), starts, axis=-1)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan).astype(np.float32)


def seen_from(polylines: Polylines, displacements_m: FloatArray, columns: int) -> Float32Array:
    """Return the skylines of polylines from displaced eyes.

    Parameters
    ----------
    polylines : Polylines
    displacements_m : (C, 3) floating
        Right, up, forward; an eye with a NaN sees nothing.
    columns : int
        Columns Q of the curves that are returned.

    Returns
    -------
    (C, Q) float32
        elevation_tan at the column centres, NaN where no polyline passes.
    """
    image = Image.of(polylines, displacements_m, columns)
    envelope = np.full(len(displacements_m) * columns, -np.inf, dtype=np.float32)
    np.maximum.at(envelope, image.cell(), image.elevation_tan())
    envelope[np.isneginf(envelope)] = np.nan
    return envelope.reshape(len(displacements_m), columns)


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """Where the segments of polylines pass column centres in the images of C displaced eyes.

    There are P passing segments, and S places where one passes a column.

    Attributes
    ----------
    start : (P,) intp
        The segment's first point: its eye times M plus its index.
    segment : (S,) intp
        Which of the segments passes.
    eye, column : (S,) intp
    along : (S,) float32
        How far along the segment, in the image.
    height_tan, nearness_per_m : (C, M) float32
        Image-plane ordinate and inverse depth of the points.
    columns : int
    """

    start: IntArray
    segment: IntArray
    eye: IntArray
    column: IntArray
    along: Float32Array
    height_tan: Float32Array
    nearness_per_m: Float32Array
    columns: int

    @classmethod
    def of(cls, polylines: Polylines, displacements_m: FloatArray, columns: int) -> "Image":
        """Project polylines for displaced eyes (C, 3)."""
        right, up, forward = displacements_m.astype(np.float32).T[:, :, np.newaxis]
        # An eye that is nowhere has everything behind it.
        depth = polylines.forward_m - np.where(np.isfinite(up), forward, np.float32(np.inf))
        nearness = 1.0 / np.where(depth > MIN_DEPTH_M, depth, np.float32(np.nan))
        position = (polylines.right_m - right) * nearness
        position *= np.float32(columns / 2.0)
        position += np.float32((columns - 1) / 2.0)

        flat = position.ravel()
        first = np.ceil(np.maximum(np.minimum(flat[:-1], flat[1:]), 0.0))
        last = np.floor(np.minimum(np.maximum(flat[:-1], flat[1:]), np.float32(columns - 1)))
        passes = np.zeros(position.shape, dtype=bool)
        passes.ravel()[:-1] = first <= last
        passes &= polylines.joined
        start = np.flatnonzero(passes)

        first = first[start]
        count = (last[start] - first).astype(np.intp) + 1
        segment = np.repeat(np.arange(len(start)), count)
        skipped = np.cumsum(count) - count - first.astype(np.intp)
        column = np.arange(len(segment)) - skipped[segment]
        span = flat[start + 1] - flat[start]
        # A segment seen end on counts as its beginning.
        rate = np.divide(1.0, span, out=np.zeros_like(span), where=np.abs(span) > 1e-6)
        along = (column.astype(np.float32) - flat[start][segment]) * rate[segment]
        return cls(
            start,
            segment,
            (start // max(len(polylines.joined), 1))[segment],
            column,
            along,
            np.asarray((polylines.up_m - up) * nearness, dtype=np.float32),
            np.asarray(nearness, dtype=np.float32),
            columns,
        )

    def cell(self, layer: IntArray | int = 0, layers: int = 1) -> IntArray:
        """Return the cells (S,) of an array (C, layers, columns) that the places fall in."""
        return np.asarray((self.eye * layers + layer) * self.columns + self.column)

    def point(self) -> IntArray:
        """Return the first point of the passing segment, (S,)."""
        return np.asarray((self.start % max(self.height_tan.shape[1], 1))[self.segment])

    def elevation_tan(self) -> Float32Array:
        """Return the ordinates at the column centres, (S,)."""
        return self._between(self.height_tan)

    def depth_m(self) -> Float32Array:
        """Return the depths at the column centres, (S,)."""
        return np.asarray(1.0 / self._between(self.nearness_per_m), dtype=np.float32)

    def _between(self, values: Float32Array) -> Float32Array:
        flat = values.ravel()
        begin = flat[self.start]
        rise = flat[self.start + 1] - begin
        return np.asarray(begin[self.segment] + self.along * rise[self.segment], dtype=np.float32)


def surfacing(tan: Float32Array, depth_m: Float32Array, reach: Reach) -> BoolArray:
    """Return which points (K, Q), NaN where unknown, could rise over the rest of their column.

    Moving by t changes the v of a point at depth z by (v t_forward - t_up) / z, and shifts it
    sideways along what is in front of it.
    """
    highest = np.where(np.isnan(tan), -np.inf, tan).argmax(axis=0)
    column = np.arange(tan.shape[1])
    nearness = 1.0 / depth_m
    against = nearness[highest, column]
    gain_m = reach.vertical_m + reach.horizontal_m * (np.abs(tan) + _STEEPNESS)
    return np.asarray(tan + gain_m * (nearness + against) >= tan[highest, column])


def _own(u: Float32Array, depth_m: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Return right and forward of points seen straight on."""
    return u * depth_m, depth_m


def _left(u: Float32Array, depth_m: Float32Array) -> tuple[Float32Array, Float32Array]:
    return -depth_m, u * depth_m


def _right(u: Float32Array, depth_m: Float32Array) -> tuple[Float32Array, Float32Array]:
    return depth_m, -u * depth_m

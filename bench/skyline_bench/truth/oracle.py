"""The oracle: the float64 skyline of the exact surface.

It is slow and plain, and the reference for all others. The vertical half-plane of a column meets
the surface's edges where its ground ray crosses the three families of grid lines: the columns of
samples, the rows, and the north-west to south-east diagonals. Between two samples of an edge the
height is linear, and v is monotonic along the half-plane inside a triangle, so the greatest v over
all crossings is the skyline. No edge in front of the eye is left out.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array, Int64Array
from skyline.geodesy.earth import Curvature
from skyline.skylines import (
    DEFAULT_WIDTH,
    FLAG_HOLE,
    FLAG_NO_DATA,
    FLAG_TRUNCATED,
    HEADINGS,
    Views,
    check_width,
    columns_u,
    raised_to_dip,
    rotation,
)
from skyline.terrain.heightfield import HeightField
from skyline.terrain.triangles import Triangles
from skyline.terrain.viewpoints import Viewpoints, in_four_views

_CROSSINGS_AT_ONCE = 400_000
"""Crossings evaluated together: small enough to stay in the processor's cache."""


@dataclass(frozen=True, slots=True, eq=False)
class _Crossings:
    """Where R ground rays cross L lines of one family.

    Arrays are (R, L). The edge crossed joins sample (row, col) to (row + row_step, col + col_step),
    and ``fraction`` is how far along it. ``near`` and ``far`` are whether the triangle on the eye's
    side of the edge, and the one beyond, belong to the surface; both are False off the map.
    """

    depth_m: Float64Array
    row: Int64Array
    col: Int64Array
    fraction: Float64Array
    row_step: int
    col_step: int
    near: BoolArray
    far: BoolArray


def skyline(
    field: HeightField,
    viewpoints: Viewpoints,
    width: int = DEFAULT_WIDTH,
    curvature: Curvature | None = None,
) -> Views:
    """Compute exact skylines in all four headings; see `skyline_at`.

    A view has ``width`` columns W. The curvature is by default the Earth's with k = 0.13.
    """
    u = columns_u(check_width(width))
    return skyline_at(field, viewpoints, u, curvature or Curvature())


def skyline_at(
    field: HeightField, viewpoints: Viewpoints, u: Float64Array, curvature: Curvature
) -> Views:
    """Compute exact skylines in all four headings, in columns at any abscissas.

    The eyes (N) are at or above the surface. Abscissas ``u`` (W,) increase and are of magnitude at
    most 1. Of the 4 N views, the four headings of a viewpoint follow one another.
    """
    kinds = (np.float64, np.float64, np.uint8)
    eyes, heading = in_four_views(viewpoints)
    places = eyes.easting_m, eyes.northing_m, eyes.eye_elevation_m
    seen = _seen(field, viewpoints, u, curvature, _Scene.skyline, kinds)
    return raised_to_dip(Views(*places, heading, *seen), u, field.height_range_m[0], curvature)


def rivals(
    field: HeightField, viewpoints: Viewpoints, u: Float64Array, curvature: Curvature
) -> list[Float64Array]:
    """Compute the rivals that decide which columns are flagged.

    Abscissas are as in `skyline_at`. The rivals are the greatest v (4 N, W) over the crossings
    beyond which the surface goes on, and over those where it ends; -inf where there are none. The
    greater of the two is the skyline.
    """
    return _seen(field, viewpoints, u, curvature, _Scene.rivals, (np.float64, np.float64))


def _seen(
    field: HeightField,
    viewpoints: Viewpoints,
    u: Float64Array,
    curvature: Curvature,
    look: Callable[["_Scene", Float64Array], tuple[NDArray[Any], ...]],
    kinds: Sequence[type[np.generic]],
) -> list[NDArray[Any]]:
    """Return the four views of each eye.

    The arrays are (4 N, W) each.
    """
    triangles = Triangles.of(field.heights_m)
    seen = [np.empty((4 * len(viewpoints), len(u)), dtype=kind) for kind in kinds]
    for index in range(len(viewpoints)):
        scene = _Scene(field, triangles, viewpoints, index, curvature)
        for heading in HEADINGS:
            for whole, part in zip(seen, look(scene, directions_at(heading, u)), strict=True):
                whole[4 * index + heading] = part
    return seen


def directions_at(heading: int, u: Float64Array) -> Float64Array:
    """Return the ground directions (W, 2) at abscissas u (W,).

    They are metres east and north for each metre of forward depth.
    """
    turn = rotation(heading)
    right = turn[0, [0, 2]]
    forward = turn[2, [0, 2]]
    return np.asarray(forward + u[:, np.newaxis] * right, dtype=np.float64)


class _Scene:
    """The surface as one eye sees it.

    Heights are relative to the eye, less the drop of curvature.
    """

    def __init__(
        self,
        field: HeightField,
        triangles: Triangles,
        viewpoints: Viewpoints,
        index: int,
        curvature: Curvature,
    ) -> None:
        self.field = field
        self.triangles = triangles
        row, col = field.to_grid(
            easting_m=viewpoints.easting_m[index], northing_m=viewpoints.northing_m[index]
        )
        self.eye_row = float(row)
        self.eye_col = float(col)
        north = (self.eye_row - np.arange(field.rows)) * field.spacing_north_m
        east = (np.arange(field.cols) - self.eye_col) * field.spacing_east_m
        distance_squared = north[:, np.newaxis] ** 2 + east**2
        self.up_m = (
            field.heights_m.astype(np.float64)
            - viewpoints.eye_elevation_m[index]
            - curvature.drop_per_m2 * distance_squared
        )

    def skyline(
        self, directions: Float64Array
    ) -> tuple[Float64Array, Float64Array, NDArray[np.uint8]]:
        """Return ordinates v, depths and flags of columns.

        ``directions`` is (W, 2), east and north per metre of forward depth.
        """
        width = len(directions)
        tan = np.full(width, -np.inf)
        depth = np.full(width, np.nan)
        truncated = np.zeros(width, dtype=bool)
        hole = np.zeros(width, dtype=bool)
        for part, crossings in self._crossings(directions):
            v = self._v(crossings)
            rays = np.arange(len(v))
            best = v.argmax(axis=1)
            raised = v[rays, best] > tan[part]
            tan[part] = np.where(raised, v[rays, best], tan[part])
            depth[part] = np.where(raised, crossings.depth_m[rays, best], depth[part])
            truncated[part] = np.where(raised, ~crossings.far[rays, best], truncated[part])
            if self.field.has_holes:
                hole[part] |= (~crossings.near & crossings.far).any(axis=1)
        missing = np.isnan(depth)
        tan[missing] = np.nan
        flags = (
            np.where(truncated & ~missing, FLAG_TRUNCATED, 0)
            + np.where(hole, FLAG_HOLE, 0)
            + np.where(missing, FLAG_NO_DATA, 0)
        )
        return tan, depth, flags.astype(np.uint8)

    def rivals(self, directions: Float64Array) -> tuple[Float64Array, Float64Array]:
        """Return `rivals` of the columns with these ground directions."""
        inner, border = np.full((2, len(directions)), -np.inf)
        for part, crossings in self._crossings(directions):
            v = self._v(crossings)
            for best, among in ((inner, crossings.far), (border, ~crossings.far)):
                greatest = np.where(among, v, -np.inf).max(axis=1)
                best[part] = np.maximum(best[part], greatest)
        return inner, border

    def _crossings(self, directions: Float64Array) -> Iterator[tuple[slice, _Crossings]]:
        """Yield spans of columns, and their crossings by family.

        The columns have the given ground directions.
        """
        # Grid steps per metre of depth; columns head east, rows south, diagonals col - row.
        col_rate = directions[:, 0] / self.field.spacing_east_m
        row_rate = -directions[:, 1] / self.field.spacing_north_m
        for part in _runs(col_rate, row_rate, self.field.rows + self.field.cols):
            for crossings in self._families(col_rate[part], row_rate[part]):
                yield part, crossings

    def _families(self, col_rate: Float64Array, row_rate: Float64Array) -> Iterator[_Crossings]:
        """Yield the crossings with each family.

        The rays' rates must not differ in sign.
        """
        rows = self.field.rows
        cols = self.field.cols
        north_east = self.triangles.north_east
        south_west = self.triangles.south_west

        lines = _lines_ahead(self.eye_col, col_rate, 0, cols)
        if lines.size:
            depth = (lines - self.eye_col) / col_rate[:, np.newaxis]
            row, fraction = _split(self.eye_row + depth * row_rate[:, np.newaxis], rows)
            col = np.broadcast_to(lines, row.shape)
            west = north_east[row + 1, col]
            east = south_west[row + 1, col + 1]
            near, far = (west, east) if col_rate[0] > 0.0 else (east, west)
            yield _Crossings(depth, row, col, fraction, 1, 0, near, far)

        lines = _lines_ahead(self.eye_row, row_rate, 0, rows)
        if lines.size:
            depth = (lines - self.eye_row) / row_rate[:, np.newaxis]
            col, fraction = _split(self.eye_col + depth * col_rate[:, np.newaxis], cols)
            row = np.broadcast_to(lines, col.shape)
            north = south_west[row, col + 1]
            south = north_east[row + 1, col + 1]
            near, far = (north, south) if row_rate[0] > 0.0 else (south, north)
            yield _Crossings(depth, row, col, fraction, 0, 1, near, far)

        across = col_rate - row_rate
        lines = _lines_ahead(self.eye_col - self.eye_row, across, 1 - rows, cols)
        if lines.size:
            depth = (lines - (self.eye_col - self.eye_row)) / across[:, np.newaxis]
            row, fraction = _split(self.eye_row + depth * row_rate[:, np.newaxis], rows)
            col = np.clip(row + lines, -1, cols - 1)
            beyond = north_east[row + 1, col + 1]
            before = south_west[row + 1, col + 1]
            near, far = (before, beyond) if across[0] > 0.0 else (beyond, before)
            yield _Crossings(depth, row, col, fraction, 1, 1, near, far)

    def _v(self, crossings: _Crossings) -> Float64Array:
        """Return v of every crossing, -inf where there is no edge."""
        row = np.maximum(crossings.row, 0)
        col = np.maximum(crossings.col, 0)
        first = self.up_m[row, col]
        second = self.up_m[
            np.minimum(row + crossings.row_step, self.field.rows - 1),
            np.minimum(col + crossings.col_step, self.field.cols - 1),
        ]
        # A dangling edge, whose triangles both miss a sample, is not part of the surface.
        exists = crossings.near | crossings.far
        up = first + crossings.fraction * (second - first)
        return np.where(exists, up / crossings.depth_m, -np.inf)


def _split(position: Float64Array, samples: int) -> tuple[Int64Array, Float64Array]:
    """Split positions on a grid line into samples and fractions.

    These are the edge's first sample and the fraction along the edge. The first sample is -1 where
    the position is off the map.
    """
    first = np.minimum(np.floor(position), max(samples - 2, 0))
    on_map = (position >= 0.0) & (position <= samples - 1)
    return np.where(on_map, first, -1.0).astype(np.int64), position - first


def _lines_ahead(eye: float, rate: Float64Array, first: int, stop: int) -> Int64Array:
    """Return the lines of a family that lie ahead of the eye.

    They lie strictly ahead, and are among ``first`` to ``stop`` - 1.
    """
    if rate[0] > 0.0:
        return np.arange(max(first, int(np.floor(eye)) + 1), stop)
    if rate[0] < 0.0:
        return np.arange(first, min(stop, int(np.ceil(eye))))
    return np.arange(0)


def _runs(col_rate: Float64Array, row_rate: Float64Array, lines: int) -> Iterator[slice]:
    """Yield spans of columns whose rays head the same way.

    They are short enough for one evaluation.
    """
    way = np.sign(np.stack([col_rate, row_rate, col_rate - row_rate]))
    turns = np.flatnonzero((np.diff(way, axis=1) != 0.0).any(axis=0)) + 1
    bounds = [0, *turns.tolist(), len(col_rate)]
    longest = max(1, _CROSSINGS_AT_ONCE // lines)
    for start, end in itertools.pairwise(bounds):
        for begin in range(start, end, longest):
            yield slice(begin, min(begin + longest, end))

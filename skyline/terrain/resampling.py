"""Resampling of heights to a square grid in metres.

The source grid may be in any CRS, and summits are kept.

GDAL's ``WarpedVRT`` overshoots: 4 to 18 % of the summits of Davos, California and Everest came out
more than 1 m too high. Here no sample is higher than the source's samples around it.
"""

import math
from collections.abc import Callable
from dataclasses import asdict
from functools import cached_property
from typing import Any

import numpy as np
from pyproj import CRS, Transformer

from skyline.arrays import Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy.crs import transformer
from skyline.geodesy.map_frame import Frame
from skyline.terrain.grid import MAX_SAMPLES, STRIP_SAMPLES, Grid, full_turn, row_strips
from skyline.terrain.lazy_heights import block_counts, reduced, spans_of

POSITION_TOLERANCE = 1e-3
"""Greatest error of a position in the source, in samples."""

_COARSE = 32
"""Samples along a side of the squares whose extremes bound the heights of a block."""
_NODES = 9
"""Positions along a side of a block from which the block's bounds are found. Between two of them,
at most 128 samples apart, a parallel bends by 128^2 s tan(latitude) / 8 R samples of s metres on a
sphere of radius R: by less than the margin of two up to 89 degrees at 100 m, and up to 80 at 1
km."""
_Positions = Callable[[Float64Array, Float64Array], tuple[Float64Array, Float64Array]]
"""Takes rows (n,) and columns (m,) of the target; returns rows and columns (n, m) in the source."""


def ground_spacing_m(grid: Grid, crs: CRS, frame: Frame) -> tuple[float, float]:
    """Return the metres between samples at a grid's centre.

    The first number is along rows, the second along columns. ``frame`` is local, with its origin at
    the centre.
    """
    x, y = grid.centre
    half_east = 0.5 * grid.step_east
    half_north = 0.5 * grid.step_north
    easting, northing = transformer(crs, frame.crs).transform(
        [x - half_east, x + half_east, x, x], [y, y, y - half_north, y + half_north]
    )
    return (
        math.hypot(easting[1] - easting[0], northing[1] - northing[0]),
        math.hypot(easting[3] - easting[2], northing[3] - northing[2]),
    )


def square_spacing_m(ground_spacing: tuple[float, float]) -> float:
    """Return the round spacing of a warped grid, in metres.

    It is the finer of the source's two spacings, but no finer than half of the coarser, rounded
    down to a multiple of 5 in its second digit (one per cent short of a multiple counts as that
    multiple). A sample of 1 arc-second measures 21 x 31 m at 46.8 N, so the spacing is 20 m. A
    sample of 3 arc-seconds gives 90 m at the equator, 70 m at 37.5 N, and 45 m from 60 degrees on.
    """
    finer = max(min(ground_spacing), 0.5 * max(ground_spacing))
    step = 5.0 * 10.0 ** (math.floor(math.log10(finer)) - 1)
    return round(math.floor(1.01 * finer / step) * step, 12)


class Warp:
    """The resampling of heights to a square grid in a frame.

    The source grid is in another CRS. The methods are `cubic` and `keep_summits`. Eastings and
    northings of the target are whole multiples of the spacing. The target covers the box around the
    source; samples outside the source's outermost samples are NaN.

    Raises `InputError` for a source CRS that cannot be transformed, or a target too large.
    """

    def __init__(self, grid: Grid, crs: CRS, frame: Frame, spacing_m: float) -> None:
        self._grid = grid
        self._crs = crs
        self._frame = frame
        self._spacing_m = spacing_m
        self._to_frame = transformer(crs, frame.crs)
        self.target = _target_grid(grid, self._to_frame, spacing_m)
        """The grid of the result."""

    @cached_property
    def _positions(self) -> _Positions:
        return _positions(self._grid, self.target, self._crs, self._frame)

    def to_dict(self) -> dict[str, Any]:
        """Return the warp as JSON can hold it."""
        grid = asdict(self._grid)
        return {"grid": grid, "crs": self._crs.to_wkt(), "spacing_m": self._spacing_m}

    def block(self, heights_m: Float32Array, rows: slice, cols: slice) -> Float32Array:
        """Return a block of the target, made from the source's heights."""
        target = self.target
        # The sample nearest to a summit may lie across the block's border, so one more is made on
        # each side, and summits are looked for as far as there, beyond the target's border, too.
        row, col = self._positions(
            *(np.arange(span.start - 1, span.stop + 1, dtype=np.float64) for span in (rows, cols))
        )
        source = _span(row, self._grid.rows), _span(col, self._grid.cols)
        wide = (
            slice(max(rows.start - 1, 0), min(rows.stop + 1, target.rows)),
            slice(max(cols.start - 1, 0), min(cols.stop + 1, target.cols)),
        )
        inside = tuple(
            slice(within.start - span.start + 1, within.stop - span.start + 1)
            for within, span in zip(wide, (rows, cols), strict=True)
        )
        part = cubic(heights_m, row[inside], col[inside])
        if not np.isnan(part).all():
            some = heights_m[source], self._grid.part(*source)
            keep_summits(part, target.part(*wide), *some, self._to_frame)
        top = rows.start - wide[0].start
        left = cols.start - wide[1].start
        return part[top:, left:][: rows.stop - rows.start, : cols.stop - cols.start]

    def bounds_m(self, heights_m: Float32Array) -> Float32Array:
        """Return bounds (2, R, C) around the heights of each block.

        Resampling goes neither below nor above the samples around a position. Where a block has no
        sample at all, the bounds are infinite, and the lowest is above the highest.
        """
        target = self.target
        coarse = [reduced(one, heights_m, _COARSE, _COARSE) for one in (np.fmin, np.fmax)]
        bounds = np.empty((2, *block_counts((target.rows, target.cols))), dtype=np.float32)
        bounds[0] = np.inf
        bounds[1] = -np.inf
        # A block's extreme source rows and columns lie on its border. Between nodes they may lie
        # farther out than at the nodes, but by less than the margin. A summit may lie a sample
        # beyond the block, so the block's first and last nodes are the samples beside it.
        row, col = self._positions(
            *(
                np.concatenate(
                    [
                        [-1],
                        *(np.linspace(one.start, one.stop - 1, _NODES) for one in along),
                        [count],
                    ]
                )
                for along, count in zip(
                    spans_of((target.rows, target.cols)), (target.rows, target.cols), strict=True
                )
            )
        )
        for at in np.ndindex(bounds.shape[1:]):
            nodes = tuple(slice(_NODES * one, _NODES * (one + 1) + 2) for one in at)
            over = tuple(
                slice(span.start // _COARSE, -(-span.stop // _COARSE))
                for span in (_span(row[nodes], self._grid.rows), _span(col[nodes], self._grid.cols))
            )
            if all(span.stop > span.start for span in over):
                bounds[0][at] = np.fmin.reduce(coarse[0][over], axis=None, initial=np.inf)
                bounds[1][at] = np.fmax.reduce(coarse[1][over], axis=None, initial=-np.inf)
        return bounds


def _span(at: Float64Array, count: int) -> slice:
    """Return the slice of ``count`` samples from which positions are computed."""
    first, last = np.clip([at.min() - 2, at.max() + 4], 0, count).astype(np.int64).tolist()
    return slice(first, last)


def _target_grid(grid: Grid, to_frame: Transformer, spacing_m: float) -> Grid:
    """Return the target's grid, of whole multiples of the spacing."""
    west, south, east, north = to_frame.transform_bounds(
        grid.west, grid.south, grid.east, grid.north, densify_pts=127
    )
    if not np.isfinite([west, south, east, north]).all():
        raise InputError(
            f"the DEM reaches from {grid.west:.6g}, {grid.south:.6g} to {grid.east:.6g}, "
            f"{grid.north:.6g}, more than one local frame can map; give a smaller area"
        )
    # The frame's origin is the grid's centre, so there is always a sample to keep.
    left = math.ceil(west / spacing_m)
    right = math.floor(east / spacing_m)
    bottom = math.ceil(south / spacing_m)
    top = math.floor(north / spacing_m)
    rows = max(top - bottom + 1, 1)
    cols = max(right - left + 1, 1)
    if rows * cols > MAX_SAMPLES:
        raise InputError(
            f"the warped DEM would have {rows} x {cols} samples, more than {MAX_SAMPLES}; give a "
            "smaller area or a coarser DEM"
        )
    return Grid(left * spacing_m, top * spacing_m, spacing_m, spacing_m, rows, cols)


def _positions(grid: Grid, target: Grid, crs: CRS, frame: Frame) -> _Positions:
    """Return a function from target samples to source positions.

    It interpolates between nodes where that is exact to `POSITION_TOLERANCE`.
    """
    from scipy.interpolate import RectBivariateSpline  # noqa: PLC0415  (slow to load, seldom needed)

    to_source = transformer(frame.crs, crs)
    turn = full_turn(crs)

    def exact(rows: Float64Array, cols: Float64Array) -> tuple[Float64Array, Float64Array]:
        easting, northing = np.meshgrid(*target.at(rows, cols))
        x, y = to_source.transform(easting, northing)
        if turn is not None:
            x = x + turn * np.rint((grid.centre[0] - x) / turn)
        return grid.index(x, y)

    node_rows = _nodes(target.rows)
    node_cols = _nodes(target.cols)
    row_spline, col_spline = (
        RectBivariateSpline(node_rows, node_cols, nodes) for nodes in exact(node_rows, node_cols)
    )

    def interpolated(rows: Float64Array, cols: Float64Array) -> tuple[Float64Array, Float64Array]:
        return row_spline(rows, cols), col_spline(rows, cols)

    between = [0.5 * (nodes[1:] + nodes[:-1]) for nodes in (node_rows, node_cols)]
    error = np.subtract(interpolated(*between), exact(*between))
    # At a pole longitude jumps, and no spline follows.
    return interpolated if np.abs(error).max() < POSITION_TOLERANCE else exact


def _nodes(count: int) -> Float64Array:
    """Return nodes at most 32 samples apart, from -1 to ``count``."""
    return np.linspace(-1.0, count, max(4, count // 32 + 2))


def cubic(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Float32Array:
    """Return heights by cubic convolution (Keys 1981, a = -1/2).

    Positions are fractional rows and columns. No height is above or below the four samples around
    its position. Where one of the 4 x 4 samples is a hole (NaN), the height is interpolated
    bilinearly. The height is NaN outside the grid, and where the nearest sample is a hole.
    """
    rows, cols = heights_m.shape
    # Positions within a margin of the outermost samples lie on them, up to rounding. A source of a
    # single row has no inside; its samples stand for their pixels.
    row_margin, col_margin = (0.5 if n == 1 else 1e-6 for n in (rows, cols))
    inside = (row >= -row_margin) & (row <= rows - 1 + row_margin)
    inside &= (col >= -col_margin) & (col <= cols - 1 + col_margin)
    row = np.clip(np.where(inside, row, 0.0), 0.0, rows - 1)
    col = np.clip(np.where(inside, col, 0.0), 0.0, cols - 1)
    top = row.astype(np.int64)
    left = col.astype(np.int64)
    row_weights = _keys_weights(row - top)
    col_weights = _keys_weights(col - left)
    flat = heights_m.reshape(-1)
    warped = np.zeros(row.shape, dtype=np.float32)
    lowest = np.full_like(warped, np.inf)
    highest = np.full_like(warped, -np.inf)
    beside = [np.clip(left + (j - 1), 0, cols - 1) for j in range(4)]
    for i in range(4):
        line = np.clip(top + (i - 1), 0, rows - 1) * cols
        along = np.zeros(row.shape, dtype=np.float32)
        for j in range(4):
            sample = flat.take(line + beside[j])
            along += col_weights[j] * sample
            if i in (1, 2) and j in (1, 2):
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
    """Return weights of samples -1 to 2 for t in [0, 1)."""
    return [
        (((2.0 - t) * t - 1.0) * t * 0.5).astype(np.float32),
        (((3.0 * t - 5.0) * t * t + 2.0) * 0.5).astype(np.float32),
        (((4.0 - 3.0 * t) * t + 1.0) * t * 0.5).astype(np.float32),
        ((t - 1.0) * t * t * 0.5).astype(np.float32),
    ]


def _bilinear(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Float64Array:
    """Interpolate between known samples; NaN where the nearest sample is a hole."""
    rows, cols = heights_m.shape
    top = row.astype(np.int64)
    left = col.astype(np.int64)
    south = row - top
    east = col - left
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


def local_maxima(
    heights_m: Float32Array, strip_samples: int = STRIP_SAMPLES
) -> tuple[Int64Array, Int64Array]:
    """Return row and column of samples that no neighbour overtops.

    Rows and columns (n,) are in order; a sample has eight neighbours. Samples at the border, beside
    a hole (NaN) or within a level place are left out. ``strip_samples`` limits the memory, and
    changes nothing else.
    """
    found = []
    for strip in row_strips(heights_m, strip_samples):
        top = max(strip.start - 1, 0)
        block = heights_m[top : strip.stop + 1]
        own = block[1:-1, 1:-1]
        # Four neighbours rule most samples out.
        likely = (own >= block[:-2, 1:-1]) & (own >= block[2:, 1:-1])
        likely &= (own >= block[1:-1, :-2]) & (own >= block[1:-1, 2:])
        row, col = np.nonzero(likely)
        height = own[row, col]
        around = np.stack([block[row + i // 3, col + i % 3] for i in range(9) if i != 4])
        summit = (around <= height).all(axis=0) & (around < height).any(axis=0)
        found.append((row[summit] + top + 1, col[summit] + 1))
    row, col = (np.concatenate(part) for part in zip(*found, strict=True))
    return row, col


def keep_summits(
    warped_m: Float32Array,
    target: Grid,
    heights_m: Float32Array,
    grid: Grid,
    to_target: Transformer,
) -> None:
    """Lift a warped grid's samples to the heights of local maxima.

    The sample nearest to each maximum, a corner of the cell in which it lies, is lifted in place;
    holes stay holes. So every summit is as high as it was, at most 0.71 of the target's spacing
    aside. ``heights_m`` are on ``grid``; ``to_target`` leads from its CRS to the CRS of ``target``.
    """
    row, col = local_maxima(heights_m)
    nearest = _nearest_known(warped_m, *target.index(*to_target.transform(*grid.at(row, col))))
    np.maximum.at(warped_m.reshape(-1), nearest[nearest >= 0], heights_m[row, col][nearest >= 0])


def _nearest_known(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Int64Array:
    """Return the flat index of each position's nearest known corner, or -1."""
    rows, cols = heights_m.shape
    top = np.floor(row).astype(np.int64)
    left = np.floor(col).astype(np.int64)
    nearest = np.full(row.shape, -1, dtype=np.int64)
    least = np.full(row.shape, np.inf)
    for corner_row in (top, top + 1):
        for corner_col in (left, left + 1):
            inside = (corner_row >= 0) & (corner_row < rows)
            inside &= (corner_col >= 0) & (corner_col < cols)
            at = np.where(inside, corner_row * cols + corner_col, 0)
            known = inside & ~np.isnan(heights_m.reshape(-1)[at])
            apart = np.where(known, (row - corner_row) ** 2 + (col - corner_col) ** 2, np.inf)
            nearest = np.where(apart < least, at, nearest)
            least = np.minimum(apart, least)
    return nearest

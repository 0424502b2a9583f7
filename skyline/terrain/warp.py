"""Samples of one CRS to a square metric grid of another, once, with all summits.

rasterio's own ``reproject`` finds its positions to an eighth of a sample, and before its version
1.5 no option betters that: 5 m rms on 3 arc-second tiles of California. Here positions are good
to `POSITION_TOLERANCE` samples, and holes and the antimeridian are treated in plain sight.
"""

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.terrain.blocks import BLOCK, block_edges
from skyline.terrain.cubic import cubic
from skyline.terrain.mosaic import MAX_SAMPLES
from skyline.terrain.summits import keep_summits
from skyline.terrain.tiles import Grid, full_turn

POSITION_TOLERANCE = 1e-3
"""Greatest error of a position in the source, in samples."""

_NODE_STEP = 32
_EDGE_POINTS = 129
_BLOCKS_AT_ONCE = 16
_THREADS = 4
_BENT = 3
"""Source samples by which the edge of a block may bend out of the box round its corners."""

Positions = Callable[[Float64Array, Float64Array], tuple[Float64Array, Float64Array]]
"""From rows (n,) and columns (m,) of the target to rows and columns (n, m) in the source."""


def local_frame(grid: Grid, crs: CRS) -> Frame:
    """Return the local conformal frame centred on a grid."""
    lon, lat = _transformer(crs, CRS.from_epsg(4326)).transform(*grid.centre)
    return Frame.local((lon + 180.0) % 360.0 - 180.0, lat)


def ground_spacing_m(grid: Grid, crs: CRS, frame: Frame) -> tuple[float, float]:
    """Return the spacing of a grid at its centre, along rows and along columns, in metres.

    ``frame`` is the local frame centred there, where map metres are metres on the ground.
    """
    x, y = grid.centre
    half_east, half_north = 0.5 * grid.step_east, 0.5 * grid.step_north
    easting, northing = _transformer(crs, frame.crs).transform(
        [x - half_east, x + half_east, x, x], [y, y, y - half_north, y + half_north]
    )
    return (
        math.hypot(easting[1] - easting[0], northing[1] - northing[0]),
        math.hypot(easting[3] - easting[2], northing[3] - northing[2]),
    )


def square_spacing_m(ground_spacing: tuple[float, float]) -> float:
    """Return the round spacing of a warped grid, in metres.

    The finer of the source's two spacings, but no finer than half of the coarser, rounded down to
    a multiple of 5 in its second digit (one per cent short of a multiple counts as that multiple).
    A sample of 1 arc-second measures 21 x 31 m at 46.8 N, so it gives 20 m. One of 3 arc-seconds
    gives 90 m at the equator, 70 m at 37.5 N, and 45 m from 60 degrees on.
    """
    finer = max(min(ground_spacing), 0.5 * max(ground_spacing))
    step = 5.0 * 10.0 ** (math.floor(math.log10(finer)) - 1)
    return round(math.floor(1.01 * finer / step) * step, 12)


class Warp:
    """Resamples heights to a frame by cubic convolution (Keys 1981, a = -1/2), with all summits.

    No sample of the target is above or below the four samples of the source around it: a cubic
    overshoots between two samples that are as high as each other. Then the sample nearest to each
    local maximum of the source is lifted to it (`skyline.terrain.summits`).

    The target's samples have eastings and northings that are whole multiples of the spacing. It
    covers the box around the source; its samples outside the source's outermost samples are NaN.
    A target sample whose nearest source sample is a hole is a hole; one that has a hole among its
    4 x 4 source samples but not nearest is interpolated bilinearly from those that are known.

    Raises `InputError` for a source CRS that cannot be transformed, or a target too large.

    Parameters
    ----------
    heights_m : (rows, cols) float32
        On ``grid``, in the units of ``crs``; NaN marks holes.
    crs : CRS
        The source's.
    frame : Frame
        The target's.

    Attributes
    ----------
    target : Grid
        In metres of the frame.
    """

    def __init__(
        self, heights_m: Float32Array, grid: Grid, crs: CRS, frame: Frame, spacing_m: float
    ) -> None:
        self._source_m, self._grid = heights_m, grid
        self._to_frame = _transformer(crs, frame.crs)
        self.target = _target_grid(grid, self._to_frame, spacing_m)
        self._positions, self._smooth = _positions(grid, self.target, crs, frame)

    def highest_m(self) -> Float32Array:
        """Return a height that no sample exceeds for each block of the target, (R, C)."""
        edges = [block_edges(count) for count in (self.target.rows, self.target.cols)]
        highest = np.full([len(edge) - 1 for edge in edges], np.inf, np.float32)
        if self._smooth:
            nodes = self._positions(*(edge.astype(np.float64) for edge in edges))
            rows, cols = (
                _spans(
                    np.minimum.reduce(_corners(at)), np.maximum.reduce(_corners(at)), _BENT, count
                )
                for at, count in zip(nodes, self._source_m.shape, strict=True)
            )
            for block in np.ndindex(highest.shape):
                part = self._source_m[slice(*rows[:, *block]), slice(*cols[:, *block])]
                highest[block] = np.fmax.reduce(part, axis=None, initial=-np.inf)
        return highest

    def heights_m(self) -> Float32Array:
        """Return the target's samples (rows, cols)."""
        blocks = [len(block_edges(count)) - 1 for count in (self.target.rows, self.target.cols)]
        return self.blocks_m(np.ones(blocks, np.bool_))[0]

    def blocks_m(self, wanted: BoolArray) -> tuple[Float32Array, Grid]:
        """Return the least part of the target with all blocks (R, C) wanted; the rest is NaN.

        If none are wanted it is all of the target.
        """
        target = self.target
        spans = [np.flatnonzero(wanted.any(axis)) for axis in (1, 0)]
        rows, cols = (
            slice(int(span[0]) * BLOCK, min((int(span[-1]) + 1) * BLOCK + 1, count))
            if span.size
            else slice(0, count)
            for span, count in zip(spans, (target.rows, target.cols), strict=True)
        )
        part = target.part(rows, cols)
        warped = np.empty((part.rows, part.cols), dtype=np.float32)
        if not wanted.all():
            warped.fill(np.nan)

        def fill(window: tuple[slice, slice]) -> None:
            row, col = window
            here = (
                slice(row.start - rows.start, row.stop - rows.start),
                slice(col.start - cols.start, col.stop - cols.start),
            )
            warped[here] = self._part(window)

        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(fill, _windows(wanted)))
        return warped, part

    def _part(self, inner: tuple[slice, slice]) -> Float32Array:
        """Return a part of the target."""
        # The sample nearest to a summit may lie across the border: so one more is known there.
        begin = [max(span.start - 1, 0) for span in inner]
        end = min(inner[0].stop + 1, self.target.rows), min(inner[1].stop + 1, self.target.cols)
        outer = tuple(map(slice, begin, end))
        row, col = self._positions(
            *(np.arange(span.start, span.stop, dtype=np.float64) for span in outer)
        )
        warped = cubic(self._source_m, row, col)
        if not np.isnan(warped).all():
            source = [
                slice(*_spans(at.min(), at.max(), 2, count).tolist())
                for at, count in zip((row, col), self._source_m.shape, strict=True)
            ]
            keep_summits(
                warped,
                self.target.part(*outer),
                self._source_m[*source],
                self._grid.part(*source),
                self._to_frame,
            )
        rows, cols = (
            slice(s.start - o.start, s.stop - o.start) for s, o in zip(inner, outer, strict=True)
        )
        return warped[rows, cols]


def _corners(at: Float64Array) -> list[Float64Array]:
    """Return what nodes have at the four corners of each cell between them."""
    return [at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]]


def _spans(lowest: ArrayLike, highest: ArrayLike, margin: int, count: int) -> Int64Array:
    """Return the first sample and the one past the last, (2, ...), of spans of positions."""
    ends = np.stack([np.subtract(lowest, margin), np.add(highest, margin + 2)])
    return np.asarray(np.clip(ends, 0, count).astype(np.int64))


def _windows(wanted: BoolArray) -> Iterator[tuple[slice, slice]]:
    """Yield rows and columns of samples of all blocks that are wanted, many blocks at once."""
    for row, line in enumerate(wanted):
        ends = np.flatnonzero(np.diff(line, prepend=False, append=False)).tolist()
        for start, stop in zip(ends[::2], ends[1::2], strict=True):
            for left in range(start, stop, _BLOCKS_AT_ONCE):
                right = min(left + _BLOCKS_AT_ONCE, stop)
                yield (
                    slice(row * BLOCK, (row + 1) * BLOCK + 1),
                    slice(left * BLOCK, right * BLOCK + 1),
                )


def _transformer(source: CRS, target: CRS) -> Transformer:
    try:
        return Transformer.from_crs(source, target, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"coordinates of {source.name!r} cannot be transformed to {target.name!r} "
            f"({' '.join(str(error).split())}); give a DEM in a CRS of the Earth, or one that is "
            "metric and conformal already"
        ) from error


def _target_grid(grid: Grid, to_frame: Transformer, spacing_m: float) -> Grid:
    along = np.linspace(0.0, 1.0, _EDGE_POINTS)
    x = grid.west + along * (grid.east - grid.west)
    y = grid.south + along * (grid.north - grid.south)
    easting, northing = to_frame.transform(
        np.concatenate([x, x, np.full_like(y, grid.west), np.full_like(y, grid.east)]),
        np.concatenate([np.full_like(x, grid.south), np.full_like(x, grid.north), y, y]),
    )
    if not (np.isfinite(easting).all() and np.isfinite(northing).all()):
        raise InputError(
            f"the DEM reaches from {grid.west:.6g}, {grid.south:.6g} to {grid.east:.6g}, "
            f"{grid.north:.6g}, beyond what one local frame can map; give a smaller area"
        )
    # The frame's origin is the grid's centre, so there is always a sample to keep.
    left, right = math.ceil(min(easting) / spacing_m), math.floor(max(easting) / spacing_m)
    bottom, top = math.ceil(min(northing) / spacing_m), math.floor(max(northing) / spacing_m)
    rows, cols = max(top - bottom + 1, 1), max(right - left + 1, 1)
    if rows * cols > MAX_SAMPLES:
        raise InputError(
            f"the warped DEM would have {rows} x {cols} samples, more than {MAX_SAMPLES}; give a "
            "smaller area or a coarser DEM"
        )
    return Grid(left * spacing_m, top * spacing_m, spacing_m, spacing_m, rows, cols)


def _positions(grid: Grid, target: Grid, crs: CRS, frame: Frame) -> tuple[Positions, bool]:
    """Return positions in the source, and whether nodes they are interpolated between suffice."""
    from scipy.interpolate import RectBivariateSpline  # noqa: PLC0415  (a fifth of a second, seldom needed)

    to_source = _transformer(frame.crs, crs)
    turn = full_turn(crs)

    def exact(rows: Float64Array, cols: Float64Array) -> tuple[Float64Array, Float64Array]:
        easting, northing = np.meshgrid(
            target.west + cols * target.step_east, target.north - rows * target.step_north
        )
        x, y = to_source.transform(easting, northing)
        if turn is not None:
            x = x + turn * np.rint((grid.centre[0] - x) / turn)
        return (grid.north - y) / grid.step_north, (x - grid.west) / grid.step_east

    node_rows, node_cols = _nodes(target.rows), _nodes(target.cols)
    row_spline, col_spline = (
        RectBivariateSpline(node_rows, node_cols, nodes) for nodes in exact(node_rows, node_cols)
    )

    def interpolated(rows: Float64Array, cols: Float64Array) -> tuple[Float64Array, Float64Array]:
        return row_spline(rows, cols), col_spline(rows, cols)

    between = 0.5 * (node_rows[1:] + node_rows[:-1]), 0.5 * (node_cols[1:] + node_cols[:-1])
    error = np.subtract(interpolated(*between), exact(*between))
    # At a pole longitude jumps, and no spline follows.
    smooth = bool(np.abs(error).max() < POSITION_TOLERANCE)
    return (interpolated if smooth else exact), smooth


def _nodes(count: int) -> Float64Array:
    return np.linspace(-1.0, count, max(4, count // _NODE_STEP + 2))

"""The mesh of a height field for rays: its triangles, and the tree of slabs over it.

The tree bounds the terrain from above for rays that march over it. Seen along one axis, the field
is cut across into strips (rows of cells) and these into slabs of 2, 16, 128, 1024 strips. A ray
drifts sideways by its slope, in cells per strip, so it meets only part of a slab. The tree groups
rays by bins of slope, and by the block of columns in which they enter a band of eight slabs. For
each group it holds, for each of the eight slabs, the greatest height near any ray of the group.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array, FloatArray

Samples = NDArray[Any]
"""float32 heights or uint8 marks."""

SlabLevel = tuple[Samples, int]
"""One level of the tree: the greatest values (bins, bands, blocks, SLABS), `EMPTY` (0 of marks)
where a ray meets no sample; and the number of blocks left of the block that begins at column 0."""

SLABS = 8
"""Slabs in a band: the children of a node of the tree."""

LEAF_STRIPS = 2
"""Strips in a slab of the finest level."""

MAX_LEVELS = 4

EMPTY = np.float32(-3e38)
"""The height of a hole, and the bound where there is no sample at all."""

_SLACK_SLOPE = 1e-5
_SLACK_CELLS = 0.02
"""Margin of a bound, in cells: far more than a ray's error in float32 over the longest field."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Masks of the triangles that belong to the surface, padded by one cell that does not."""

    north_east: BoolArray
    south_west: BoolArray
    """``north_east``, ``south_west``: (rows + 1, cols + 1) bool. Cell (row, col) has its north-west
    sample at [row, col] of the heights and its two triangles at [row + 1, col + 1] here; the
    padding stands for cells off the map."""

    @classmethod
    def of(cls, heights_m: FloatArray) -> "Triangles":
        """Find the triangles whose three samples are all known."""
        present = ~np.isnan(heights_m)
        diagonal = present[:-1, :-1] & present[1:, 1:]
        return cls(np.pad(diagonal & present[:-1, 1:], 1), np.pad(diagonal & present[1:, :-1], 1))

    @property
    def samples(self) -> BoolArray:
        """Mask of the samples that are a corner of some triangle, (rows, cols)."""
        north_east, south_west = self.north_east, self.south_west
        both = north_east | south_west
        return np.asarray(
            both[:-1, :-1] | both[1:, 1:] | north_east[1:, :-1] | south_west[:-1, 1:], dtype=bool
        )

    @property
    def _edges(self) -> tuple[tuple[tuple[int, int], BoolArray, BoolArray], ...]:
        """All edges along rows, along columns and across cells.

        Each kind has the step in rows and columns from an edge's first sample to its second, and
        masks of the edges with a triangle on their right and on their left (seen from above, north
        up).
        """
        north_east, south_west = self.north_east, self.south_west
        return (
            ((0, 1), north_east[1:, 1:-1], south_west[:-1, 1:-1]),
            ((1, 0), north_east[1:-1, :-1], south_west[1:-1, 1:]),
            ((1, 1), south_west[1:-1, 1:-1], north_east[1:-1, 1:-1]),
        )

    def entries(self, north: bool, east: bool) -> BoolArray:
        """Return a mask of samples (rows, cols): ends of edges where a ray may enter the surface.

        The ray goes ``north`` rather than south, and ``east`` rather than west.
        """
        rows, cols = self.north_east.shape
        marks = np.zeros((rows - 1, cols - 1), dtype=bool)
        # Going north-west or south-east, either way across a diagonal is possible.
        to_left = north, east, north or east
        to_right = not north, not east, not (north and east)
        for (step, right, left), leftward, rightward in zip(
            self._edges, to_left, to_right, strict=True
        ):
            edges = left ^ right
            if not (leftward and rightward):
                edges &= left if leftward else right
            for row, col in ((0, 0), step):
                marks[row : row + edges.shape[0], col : col + edges.shape[1]] |= edges
        return marks

    @property
    def has_dangling_edges(self) -> bool:
        """True if samples of triangles are neighbours along an edge without a triangle."""
        there = self.samples
        return any(
            bool((there[: len(left), : left.shape[1]] & there[row:, col:] & ~(left | right)).any())
            for (row, col), right, left in self._edges
        )


def level_count(strips: int) -> int:
    """Return the number of levels for a field with this number of strips along its longer axis."""
    levels = 1
    while LEAF_STRIPS * SLABS**levels < strips:
        levels += 1
    return levels


def slab_levels(values: Samples, slopes: Float64Array, levels: int) -> Iterator[SlabLevel]:
    """Build the tree of values (lines, columns) seen along the first axis, finest level first.

    Values are heights, `EMPTY` for holes, or marks, 0 for none; strips lie between lines.
    ``slopes`` (bins + 1,) are increasing bounds of the bins of rays' slopes, columns per line.
    ``levels`` is `level_count` of the longer axis.
    """
    slabs = max(-(-(len(values) - 1) // LEAF_STRIPS), 1)
    lines = _padded(values, 0, slabs * LEAF_STRIPS + 1)
    maxima = lines[LEAF_STRIPS::LEAF_STRIPS].copy()
    for line in range(LEAF_STRIPS):
        np.maximum(maxima, lines[line : slabs * LEAF_STRIPS : LEAF_STRIPS], out=maxima)
    slab, step = LEAF_STRIPS, 0
    for level in range(levels):
        if level:
            maxima, step = _coarsened(maxima, step, slab), slab
            slab *= SLABS
        yield _bin_level(maxima, step, slab, values.shape[1], slopes)


def _coarsened(maxima: Samples, step: int, wanted: int) -> Samples:
    """Join SLABS slabs into one, and columns into spans of ``wanted`` cells.

    Columns are single samples (step 0) or spans of ``step`` cells, a power of two.
    """
    slabs = -(-len(maxima) // SLABS)
    joined: Samples = _padded(maxima, 0, slabs * SLABS).reshape(slabs, SLABS, -1).max(axis=1)
    if step == 0:
        beside = _padded(joined, 1, joined.shape[1] + 1)
        joined, step = np.maximum(beside[:, :-1], beside[:, 1:]), 1
    while step < wanted:
        joined = _padded(joined, 1, -(-joined.shape[1] // 2) * 2)
        joined, step = np.maximum(joined[:, ::2], joined[:, 1::2]), 2 * step
    return joined


def _bin_level(
    source: Samples, step: int, slab: int, columns: int, slopes: Float64Array
) -> SlabLevel:
    """Return the level of the slabs whose maxima are in ``source``, laid out as by `_coarsened`."""
    bands = -(-len(source) // SLABS)
    values = _padded(source, 0, bands * SLABS).reshape(bands, SLABS, -1)
    first_block = int(np.ceil(SLABS * np.abs(slopes).max())) + 1
    blocks = -(-columns // slab) + 2 * first_block
    maxima = np.empty((len(slopes) - 1, bands, blocks, SLABS), dtype=values.dtype)
    width = max(step, 1)
    ratio = slab // width
    for index, (lower, upper) in enumerate(itertools.pairwise(slopes)):
        least, most = lower - _SLACK_SLOPE, upper + _SLACK_SLOPE
        for child in range(SLABS):
            # Cells swept between the child's two ends by rays that start within one block.
            low = min(least * child, least * (child + 1)) * slab - _SLACK_CELLS
            high = slab + max(most * child, most * (child + 1)) * slab + _SLACK_CELLS
            # The columns that these touch: a single sample lies at an end of cells.
            first, past = int(np.floor(low / width)), int(np.ceil(high / width)) + (step == 0)
            maxima[index, :, :, child] = _sliding_max(
                values[:, child], first - first_block * ratio, ratio, blocks, past - first
            )
    return maxima, first_block


def _sliding_max(values: Samples, start: int, stride: int, count: int, span: int) -> Samples:
    """Return (rows, count): the greatest of ``span`` columns from start, start + stride, ..."""
    need = (count - 1) * stride + span
    held = np.full((len(values), need), _nothing(values), dtype=values.dtype)
    first, stop = max(start, 0), min(start + need, values.shape[1])
    if stop > first:
        held[:, first - start : stop - start] = values[:, first:stop]
    stop = (count - 1) * stride + 1
    greatest = held[:, :stop:stride].copy()
    for shift in range(1, span):
        np.maximum(greatest, held[:, shift : shift + stop : stride], out=greatest)
    return greatest


def _padded(values: Samples, axis: int, length: int) -> Samples:
    if length <= values.shape[axis]:
        return values
    widths = np.zeros((2, 2), dtype=np.int64)
    widths[axis, 1] = length - values.shape[axis]
    return np.pad(values, widths, constant_values=_nothing(values))


def _nothing(values: Samples) -> np.float32 | int:
    return EMPTY if values.dtype == np.float32 else 0

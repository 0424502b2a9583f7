"""The tree of slabs, which bounds terrain heights along rays.

It lets rays that march over a height field skip terrain that they cannot meet. Seen along one axis,
the field is cut across into strips (rows of cells), and these are joined into slabs of 2, 16, 128,
1024 strips. A ray drifts sideways by its slope, in cells per strip, so it meets only part of a
slab. The tree groups rays by bins of slope, and by the block of columns in which they enter a band
of eight slabs. For each group and each of the eight slabs it holds the greatest height near any ray
of the group.

Heights are given as codes, whole numbers that grow with the heights: the greatest code belongs to
the greatest height, and 16-bit codes are compared four times as fast as heights.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array, IntArray, UInt8Array

Codes = NDArray[np.uint16]
"""uint16 codes of heights, 0 where there is nothing."""

SLABS = 8
"""Slabs in a band: the children of a node of the tree."""

LEAF_STRIPS = 2
"""Strips in a slab of the finest level."""

MAX_LEVELS = 4
"""The most levels that the shader reads, which cover 8192 strips."""

_SLACK_SLOPE = 1e-5
"""Margin of a bin's slopes, columns per line: more than a ray's rounding in float32."""
_SLACK_CELLS = 0.02
"""Margin of a bound, in cells: far more than a ray's error in float32 over the longest field."""


def level_count(strips: int) -> int:
    """Return the number of levels for ``strips`` strips along the longer axis."""
    levels = 1
    while LEAF_STRIPS * SLABS**levels < strips:
        levels += 1
    return levels


def blocks_before(slopes: Float64Array) -> int:
    """Return the number of blocks that begin before column 0."""
    return int(np.ceil(SLABS * np.abs(slopes).max())) + 1


def level_shapes(
    lines: int, columns: int, slopes: Float64Array, levels: int
) -> list[tuple[int, int, int]]:
    """Return the bins, bands and blocks of each level.

    See `fill_levels`.
    """
    slabs = max(-(-(lines - 1) // LEAF_STRIPS), 1)
    shapes = []
    for level in range(levels):
        bands = -(-slabs // SLABS)
        blocks = -(-columns // (LEAF_STRIPS * SLABS**level)) + 2 * blocks_before(slopes)
        shapes.append((len(slopes) - 1, bands, blocks))
        slabs = bands
    return shapes


def fill_levels(codes: Codes, slopes: Float64Array, levels: Sequence[Codes]) -> None:
    """Write the levels of the tree, the finest first.

    Codes are (lines, columns). Rays run along the first axis, and strips lie between lines.
    ``slopes`` (bins + 1,) are increasing bounds of the bins of rays' slopes, columns per line.
    ``levels`` are arrays (bins, bands, blocks, SLABS), as many as the `level_count` of the longer
    axis, of the `level_shapes`. They take the greatest codes, 0 where a ray meets no sample.
    """
    slabs = max(-(-(len(codes) - 1) // LEAF_STRIPS), 1)
    lines = _padded(codes, 0, slabs * LEAF_STRIPS + 1)
    maxima = lines[LEAF_STRIPS::LEAF_STRIPS].copy()
    for line in range(LEAF_STRIPS):
        np.maximum(maxima, lines[line : slabs * LEAF_STRIPS : LEAF_STRIPS], out=maxima)
    slab = LEAF_STRIPS
    step = 0
    for number, level in enumerate(levels):
        if number:
            maxima = _coarsened(maxima, step, slab)
            step = slab
            slab *= SLABS
        _fill_level(maxima, step, slab, slopes, level)


def _coarsened(maxima: Codes, step: int, wanted: int) -> Codes:
    """Return the maxima of larger slabs and wider columns.

    `SLABS` slabs are joined into one. Columns of ``maxima`` are single samples (step 0) or spans of
    ``step`` cells, a power of two; columns of the result are spans of ``wanted`` cells.
    """
    slabs = -(-len(maxima) // SLABS)
    joined: Codes = _padded(maxima, 0, slabs * SLABS).reshape(slabs, SLABS, -1).max(axis=1)
    if step == 0:
        beside = _padded(joined, 1, joined.shape[1] + 1)
        joined = np.maximum(beside[:, :-1], beside[:, 1:])
        step = 1
    while step < wanted:
        joined = _padded(joined, 1, -(-joined.shape[1] // 2) * 2)
        joined = np.maximum(joined[:, ::2], joined[:, 1::2])
        step *= 2
    return joined


def _fill_level(source: Codes, step: int, slab: int, slopes: Float64Array, level: Codes) -> None:
    """Write the level of slabs from their maxima, a result of `_coarsened`."""
    _, bands, blocks, _ = level.shape
    first_block = blocks_before(slopes)
    width = max(step, 1)
    ratio = slab // width
    by_child = _padded(source, 0, bands * SLABS).reshape(bands, SLABS, -1).swapaxes(0, 1)
    # No span begins farther before column 0, or ends farther past the last block.
    padded = np.zeros((SLABS, bands, (blocks + 2 * first_block + 2) * ratio), source.dtype)
    padded[..., 2 * first_block * ratio :][..., : by_child.shape[2]] = by_child
    spans = _Spans(padded, ratio, blocks)
    for index, bin_slopes in enumerate(itertools.pairwise(slopes)):
        for child, (first, past) in enumerate(_swept(bin_slopes, step, slab)):
            start = first + first_block * ratio
            spans.write_maxima(child, start, past - first, level[index, :, :, child])


def _swept(slopes: tuple[float, float], step: int, slab: int) -> list[tuple[int, int]]:
    """Return the columns swept by a bin's rays in a band's slabs.

    The rays start within one block. The columns are the first and the one past the last, from the
    block's beginning. They are single samples (step 0) or spans of ``step`` cells.
    """
    least = slopes[0] - _SLACK_SLOPE
    most = slopes[1] + _SLACK_SLOPE
    width = max(step, 1)
    swept = []
    for child in range(SLABS):
        # Rays sweep these cells between the child's two ends.
        low = min(least * child, least * (child + 1)) * slab - _SLACK_CELLS
        high = slab + max(most * child, most * (child + 1)) * slab + _SLACK_CELLS
        # The columns that these touch: a single sample lies at an end of cells.
        swept.append((int(np.floor(low / width)), int(np.ceil(high / width)) + (step == 0)))
    return swept


def fill_mark_levels(marks: BoolArray, slopes: Float64Array, levels: Sequence[UInt8Array]) -> None:
    """Write the levels of the tree of a few marks (lines, columns).

    ``levels`` are zeros (bins, bands, blocks). A bit is set for each slab in which a ray meets a
    mark, the lowest bit for the first slab. Work grows with the number of marks, which is small
    where holes have short rims.
    """
    line, column = np.nonzero(marks)
    slabs = max(-(-(len(marks) - 1) // LEAF_STRIPS), 1)
    # A line between two slabs belongs to both.
    is_shared = (line % LEAF_STRIPS == 0) & (line > 0)
    slab_of = np.concatenate([line // LEAF_STRIPS, line[is_shared] // LEAF_STRIPS - 1])
    column = np.concatenate([column, column[is_shared]])[slab_of < slabs]
    slab_of = slab_of[slab_of < slabs]
    slab = LEAF_STRIPS
    step = 0
    for number, level in enumerate(levels):
        if number:
            if step == 0:
                # A sample lies at an end of two cells.
                slab_of = np.concatenate([slab_of, slab_of[column > 0]])
                column = np.concatenate([column, column[column > 0] - 1])
            column //= slab // max(step, 1)
            slab_of, column = np.unique(np.stack([slab_of // SLABS, column]), axis=1)
            step = slab
            slab *= SLABS
        _mark_level(slab_of, column, step, slab, slopes, level)


def _mark_level(
    slab_of: IntArray,
    column: IntArray,
    step: int,
    slab: int,
    slopes: Float64Array,
    level: UInt8Array,
) -> None:
    """Set the bits of slabs where rays meet a mark."""
    ratio = slab // max(step, 1)
    blocks = level.shape[2]
    band, child = np.divmod(slab_of, SLABS)
    bit = np.left_shift(np.uint8(1), child.astype(np.uint8))
    for index, bin_slopes in enumerate(itertools.pairwise(slopes)):
        first, past = np.array(_swept(bin_slopes, step, slab)).T
        # The last block whose rays meet the mark, and the last before the first such block.
        last = (column - first[child]) // ratio + blocks_before(slopes)
        before = (column - past[child]) // ratio + blocks_before(slopes)
        for back in range(int((last - before).max(initial=0))):
            block = last - back
            meets = (block > before) & (block >= 0) & (block < blocks)
            np.bitwise_or.at(level[index], (band[meets], block[meets]), bit[meets])


class _Spans:
    """The greatest codes of spans of columns, which begin ``stride`` columns apart.

    A span is covered by two spans of the greatest power of two that fits into it.
    """

    def __init__(self, codes: Codes, stride: int, count: int) -> None:
        """Take codes, and the number of spans wanted.

        Codes are (..., columns); the columns are a multiple of ``stride``.
        """
        self._codes = codes
        self._stride = stride
        self._count = count
        self._tables: dict[tuple[int, int], Codes] = {}

    def write_maxima(self, line: int, start: int, span: int, out: Codes) -> None:
        """Write the maxima (..., count) of a line's spans.

        They begin at start, start + stride and so on.
        """
        power = span.bit_length() - 1
        first, last = (self._maxima(power, line, at) for at in (start, start + span - (1 << power)))
        np.maximum(first, last, out=out)

    def _maxima(self, power: int, line: int, start: int) -> Codes:
        """Return the maxima (..., count) of spans of 2**power columns."""
        slot, phase = divmod(start, self._stride)
        return self._table(power, phase)[line, ..., slot : slot + self._count]

    def _table(self, power: int, phase: int) -> Codes:
        """Return the maxima of 2**power columns from each column of a phase.

        They are contiguous.
        """
        table = self._tables.get((power, phase))
        if table is None:
            if power == 0:
                table = np.ascontiguousarray(self._codes[..., phase :: self._stride])
            else:
                ahead, beside = divmod(phase + (1 << (power - 1)), self._stride)
                table = self._table(power - 1, phase).copy()
                half = table.shape[-1] - ahead
                other = self._table(power - 1, beside)[..., ahead:]
                np.maximum(table[..., :half], other, out=table[..., :half])
            self._tables[power, phase] = table
        return table


def _padded(codes: Codes, axis: int, length: int) -> Codes:
    """Return codes with zeros appended along an axis, up to a length."""
    if length <= codes.shape[axis]:
        return codes
    widths = np.zeros((2, 2), dtype=np.int64)
    widths[axis, 1] = length - codes.shape[axis]
    return np.pad(codes, widths)

"""The tree of slabs, which bounds terrain heights along rays.

It lets rays that march over a height field skip terrain that they cannot meet. Seen along one axis,
the field is cut across into strips (rows of cells), and these are joined into slabs of 2, 16, 128,
1024 strips. A ray drifts sideways by its slope, in cells per strip, so it meets only part of a
slab. The tree groups rays by bins of slope, and by the block of columns in which they enter a band
of eight slabs. For each group and each of the eight slabs it holds the greatest height near any ray
of the group.
"""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array

Samples = NDArray[Any]
"""float32 heights or uint8 marks."""

SlabLevel = tuple[Samples, int]
"""One level of the tree: the greatest values (bins, bands, blocks, SLABS), and the number of blocks
before the block that begins at column 0. Where a ray meets no sample, heights are `EMPTY` and marks
are 0."""

SLABS = 8
"""Slabs in a band: the children of a node of the tree."""

LEAF_STRIPS = 2
"""Strips in a slab of the finest level."""

MAX_LEVELS = 4
"""The most levels that the shader reads, which cover 8192 strips."""

EMPTY = np.float32(-3e38)
"""The height of a hole, and the bound where there is no sample at all."""

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


def slab_levels(values: Samples, slopes: Float64Array, levels: int) -> Iterator[SlabLevel]:
    """Yield the levels of the tree, the finest first.

    Values are (lines, columns). Rays run along the first axis, and strips lie between lines. Values
    are heights, `EMPTY` for holes, or marks, 0 for none. ``slopes`` (bins + 1,) are increasing
    bounds of the bins of rays' slopes, columns per line. ``levels`` is the `level_count` of the
    longer axis.
    """
    slabs = max(-(-(len(values) - 1) // LEAF_STRIPS), 1)
    lines = _padded(values, 0, slabs * LEAF_STRIPS + 1)
    maxima = lines[LEAF_STRIPS::LEAF_STRIPS].copy()
    for line in range(LEAF_STRIPS):
        np.maximum(maxima, lines[line : slabs * LEAF_STRIPS : LEAF_STRIPS], out=maxima)
    slab = LEAF_STRIPS
    step = 0
    for level in range(levels):
        if level:
            maxima = _coarsened(maxima, step, slab)
            step = slab
            slab *= SLABS
        yield _bin_level(maxima, step, slab, values.shape[1], slopes)


def _coarsened(maxima: Samples, step: int, wanted: int) -> Samples:
    """Return the maxima of larger slabs and wider columns.

    `SLABS` slabs are joined into one. Columns of ``maxima`` are single samples (step 0) or spans of
    ``step`` cells, a power of two; columns of the result are spans of ``wanted`` cells.
    """
    slabs = -(-len(maxima) // SLABS)
    joined: Samples = _padded(maxima, 0, slabs * SLABS).reshape(slabs, SLABS, -1).max(axis=1)
    if step == 0:
        beside = _padded(joined, 1, joined.shape[1] + 1)
        joined = np.maximum(beside[:, :-1], beside[:, 1:])
        step = 1
    while step < wanted:
        joined = _padded(joined, 1, -(-joined.shape[1] // 2) * 2)
        joined = np.maximum(joined[:, ::2], joined[:, 1::2])
        step *= 2
    return joined


def _bin_level(
    source: Samples, step: int, slab: int, columns: int, slopes: Float64Array
) -> SlabLevel:
    """Return the level of slabs from their maxima, a result of `_coarsened`."""
    bands = -(-len(source) // SLABS)
    values = _padded(source, 0, bands * SLABS).reshape(bands, SLABS, -1)
    first_block = int(np.ceil(SLABS * np.abs(slopes).max())) + 1
    blocks = -(-columns // slab) + 2 * first_block
    maxima = np.empty((len(slopes) - 1, bands, blocks, SLABS), dtype=values.dtype)
    width = max(step, 1)
    ratio = slab // width
    for index, (lower, upper) in enumerate(itertools.pairwise(slopes)):
        least = lower - _SLACK_SLOPE
        most = upper + _SLACK_SLOPE
        for child in range(SLABS):
            # Rays that start within one block sweep these cells between the child's two ends.
            low = min(least * child, least * (child + 1)) * slab - _SLACK_CELLS
            high = slab + max(most * child, most * (child + 1)) * slab + _SLACK_CELLS
            # The columns that these touch: a single sample lies at an end of cells.
            first = int(np.floor(low / width))
            past = int(np.ceil(high / width)) + (step == 0)
            maxima[index, :, :, child] = _sliding_max(
                values[:, child], first - first_block * ratio, ratio, blocks, past - first
            )
    return maxima, first_block


def _sliding_max(values: Samples, start: int, stride: int, count: int, span: int) -> Samples:
    """Return maxima (rows, count) of spans at start, start + stride, ..."""
    need = (count - 1) * stride + span
    held = np.full((len(values), need), _nothing(values), dtype=values.dtype)
    first = max(start, 0)
    stop = min(start + need, values.shape[1])
    if stop > first:
        held[:, first - start : stop - start] = values[:, first:stop]
    stop = (count - 1) * stride + 1
    greatest = held[:, :stop:stride].copy()
    for shift in range(1, span):
        np.maximum(greatest, held[:, shift : shift + stop : stride], out=greatest)
    return greatest


def _padded(values: Samples, axis: int, length: int) -> Samples:
    """Return values with nothing appended along an axis, up to a length."""
    if length <= values.shape[axis]:
        return values
    widths = np.zeros((2, 2), dtype=np.int64)
    widths[axis, 1] = length - values.shape[axis]
    return np.pad(values, widths, constant_values=_nothing(values))


def _nothing(values: Samples) -> np.float32 | int:
    """Return the value that stands for no sample."""
    return EMPTY if values.dtype == np.float32 else 0

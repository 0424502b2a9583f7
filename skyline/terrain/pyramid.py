"""The tree of slabs: upper bounds of the terrain for rays that walk over it.

Seen along one axis, the field is cut across into strips (rows of cells) and these into slabs of
2, 16, 128, 1024 strips. A ray drifts sideways by its slope, in cells a strip, so it meets only
part of a slab. For each range (bin) of slopes and each block of columns in which a ray crosses
the first line of a band of eight slabs, the tree holds the greatest height among the samples
that such a ray can come near in each of the eight: the tightest bound that a single fetch can give.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]

SLABS = 8
"""Slabs in a band: the children of a node of the tree."""

LEAF_STRIPS = 2
"""Strips in a slab of the finest level."""

MAX_LEVELS = 4
MAX_STRIPS = LEAF_STRIPS * SLABS**MAX_LEVELS

EMPTY = np.float32(-3e38)
"""The bound where there is no sample at all."""

_SLACK_CELLS = 0.02
"""Far more than float32 can misplace a ray in MAX_STRIPS strips."""


@dataclass(frozen=True, slots=True, eq=False)
class SlabLevel:
    """One level of the tree.

    Attributes
    ----------
    maxima : (bins, bands, blocks, SLABS) float32
        Greatest height; `EMPTY` where a ray meets no sample.
    first_block : int
        Blocks left of the one that begins at column 0.
    """

    maxima: Float32Array
    first_block: int


def level_count(strips: int) -> int:
    """Return how many levels a field needs whose longer axis has so many strips."""
    levels = 1
    while LEAF_STRIPS * SLABS**levels < strips:
        levels += 1
    return levels


def slab_levels(
    heights: Float32Array, slope_max: float, bins: int, levels: int
) -> Iterator[SlabLevel]:
    """Build the tree of a field seen along its first axis, finest level first.

    Parameters
    ----------
    heights : (lines, columns) float32
        Samples, `EMPTY` for holes. Strips lie between lines.
    slope_max : float
        Greatest slope of a ray either way, columns a line.
    bins : int
        Ranges that slopes from -slope_max to slope_max are put in.
    levels : int
        As `level_count` says for the longer axis.

    Yields
    ------
    SlabLevel
    """
    slab = LEAF_STRIPS
    source = _Maxima(_slab_maxima(heights, slab), 0)
    for level in range(levels):
        if level:
            slab *= SLABS
            source = source.coarsened(max(slab // SLABS, 1))
        yield _bin_level(source, slab, heights.shape[1], slope_max, bins)


@dataclass(frozen=True, slots=True, eq=False)
class _Maxima:
    """Maxima of slabs; columns are single samples (step 0) or spans of ``step`` cells."""

    values: Float32Array
    step: int

    def coarsened(self, step: int) -> "_Maxima":
        """Join SLABS slabs to one, and columns to spans of ``step`` cells, a power of two."""
        slabs = -(-len(self.values) // SLABS)
        values = _padded(self.values, 0, slabs * SLABS)
        values = values.reshape(slabs, SLABS, -1).max(axis=1)
        width = self.step
        if width == 0:
            beside = _padded(values, 1, values.shape[1] + 1)
            values, width = np.maximum(beside[:, :-1], beside[:, 1:]), 1
        while width < step:
            values = _padded(values, 1, -(-values.shape[1] // 2) * 2)
            values, width = np.maximum(values[:, ::2], values[:, 1::2]), 2 * width
        return _Maxima(values, width)

    def spans(self, low: float, high: float) -> tuple[int, int]:
        """Return the first and last column that cells from ``low`` to ``high`` touch."""
        if self.step == 0:
            return int(np.floor(low)), int(np.ceil(high))
        return int(np.floor(low / self.step)), int(np.ceil(high / self.step)) - 1


def _slab_maxima(heights: Float32Array, slab: int) -> Float32Array:
    """Return (slabs, columns): the greatest sample of each slab, both its end lines included."""
    slabs = max(-(-(len(heights) - 1) // slab), 1)
    lines = _padded(heights, 0, slabs * slab + 1)
    maxima = lines[slab::slab].copy()
    for line in range(slab):
        np.maximum(maxima, lines[line : slabs * slab : slab], out=maxima)
    return maxima


def _bin_level(source: _Maxima, slab: int, columns: int, slope_max: float, bins: int) -> SlabLevel:
    bands = -(-len(source.values) // SLABS)
    values = _padded(source.values, 0, bands * SLABS).reshape(bands, SLABS, -1)
    first_block = int(np.ceil(SLABS * slope_max)) + 1
    blocks = -(-columns // slab) + 2 * first_block
    maxima = np.empty((bins, bands, blocks, SLABS), dtype=np.float32)
    slopes = np.linspace(-slope_max, slope_max, bins + 1)
    ratio = slab // max(source.step, 1)
    for index in range(bins):
        least, most = slopes[index] - 1e-5, slopes[index + 1] + 1e-5
        for child in range(SLABS):
            # Cells swept between the child's two ends by rays that start within one block.
            low = min(least * child, least * (child + 1)) * slab - _SLACK_CELLS
            high = slab + max(most * child, most * (child + 1)) * slab + _SLACK_CELLS
            first, last = source.spans(low, high)
            maxima[index, :, :, child] = _sliding_max(
                values[:, child], first - first_block * ratio, ratio, blocks, last - first + 1
            )
    return SlabLevel(maxima, first_block)


def _sliding_max(
    values: Float32Array, start: int, stride: int, count: int, span: int
) -> Float32Array:
    """Return (rows, count): the greatest of ``span`` columns from start, start + stride, ..."""
    need = (count - 1) * stride + span
    held = np.full((len(values), need), EMPTY, dtype=np.float32)
    first, stop = max(start, 0), min(start + need, values.shape[1])
    if stop > first:
        held[:, first - start : stop - start] = values[:, first:stop]
    # Doubling: maxima of 1, 2, 4, ... neighbours, and two of those for the whole span.
    reach = 1
    while 2 * reach <= span:
        np.maximum(held[:, :-reach], held[:, reach:], out=held[:, :-reach])
        reach *= 2
    stop = (count - 1) * stride + 1
    return np.maximum(held[:, 0:stop:stride], held[:, span - reach : span - reach + stop : stride])


def _padded(values: Float32Array, axis: int, length: int) -> Float32Array:
    missing = length - values.shape[axis]
    if missing <= 0:
        return values
    shape = list(values.shape)
    shape[axis] = missing
    return np.concatenate([values, np.full(shape, EMPTY, dtype=np.float32)], axis=axis)

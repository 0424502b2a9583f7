"""Heights that are made block by block, when they are first needed.

A skyline sees a small part of a large model. The samples of a model that is warped are therefore
made where someone looks, and kept in memory or in a file (`skyline.terrain.field_files`).
"""

import errno
import itertools
import os
import threading
import weakref
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Int64Array, UInt32Array

_ROWS = 64
"""Rows of a block: with `_COLS` few enough for a thread's cache while the block is made."""
_COLS = 1024
"""Columns of a block."""
_THREADS = 4
"""Threads that make blocks: NumPy lets them run side by side."""

Shape = tuple[int, int]
MakeBlock = Callable[[slice, slice], Float32Array]
"""Returns the samples of the block at some rows and columns."""


def block_counts(shape: Shape) -> Shape:
    """Return the numbers of blocks along a grid's sides."""
    return -(-shape[0] // _ROWS), -(-shape[1] // _COLS)


def block_slices(shape: Shape, down: int, right: int) -> tuple[slice, slice]:
    """Return the rows and the columns of one block of a grid."""
    top = down * _ROWS
    left = right * _COLS
    return slice(top, min(top + _ROWS, shape[0])), slice(left, min(left + _COLS, shape[1]))


def spans_of(shape: Shape) -> tuple[list[slice], list[slice]]:
    """Return the rows and the columns of all blocks of a grid."""
    down, right = block_counts(shape)
    rows = [block_slices(shape, at, 0)[0] for at in range(down)]
    cols = [block_slices(shape, 0, at)[1] for at in range(right)]
    return rows, cols


def checksum(samples: Float32Array) -> int:
    """Return the checksum of samples, which is never 0."""
    return zlib.crc32(np.ascontiguousarray(samples).data) or 1


def bounds_of(heights_m: Float32Array) -> Float32Array:
    """Return the lowest and the highest height (2, R, C) of each block.

    They are infinite where there is no height.
    """
    bounds = np.stack([reduced(one, heights_m, _ROWS, _COLS) for one in (np.fmin, np.fmax)])
    bounds[0][np.isnan(bounds[0])] = np.inf
    bounds[1][np.isnan(bounds[1])] = -np.inf
    return bounds


def reduced(reduce: np.ufunc, values: Float32Array, rows: int, cols: int) -> Float32Array:
    """Reduce each square of rows and columns to one value.

    The last squares may be smaller.
    """
    lines = values[::rows].copy()
    for line in range(1, rows):
        beside = values[line::rows]
        reduce(lines[: len(beside)], beside, out=lines[: len(beside)])
    squares: Float32Array = reduce.reduceat(lines, np.arange(0, values.shape[1], cols), axis=1)
    return squares


class Blocks:
    """The samples of a grid in blocks, some of which are known.

    They are in memory or in a file.
    """

    def __init__(self, values: Float32Array) -> None:
        """Take the array (rows, cols) of the samples, of which no block is known."""
        self.values = values
        self.is_known: BoolArray = np.zeros(block_counts(self._shape), dtype=np.bool_)
        """Which blocks (R, C) hold their samples; the others may hold anything."""
        self._sums: UInt32Array | None = None
        self._file: int | None = None
        self._offset = 0
        self._lock = threading.Lock()

    @classmethod
    def in_memory(cls, shape: Shape) -> "Blocks":
        """Return a grid in memory, of which no block is known."""
        return cls(np.empty(shape, dtype=np.float32))

    @classmethod
    def in_file(
        cls, file: BinaryIO, offset: int, values: Float32Array, sums: UInt32Array
    ) -> "Blocks":
        """Return the grid that is mapped from an offset of a file.

        ``sums`` are the checksums of its blocks, 0 for those that have yet to be made. A block is
        known once its checksum was compared, so that a file whose writing was cut short gives no
        wrong height.
        """
        blocks = cls(values)
        blocks._sums = sums
        blocks._file = os.dup(file.fileno())
        blocks._offset = offset
        weakref.finalize(blocks, os.close, blocks._file)
        return blocks

    def lacks(self, down: int, right: int) -> bool:
        """Return whether a block has yet to be made."""
        if not self.is_known[down, right] and self._sums is not None and self._sums[down, right]:
            found = checksum(self.values[block_slices(self._shape, down, right)])
            self.is_known[down, right] = found == self._sums[down, right]
        return not self.is_known[down, right]

    def put(self, down: int, right: int, samples: Float32Array) -> None:
        """Keep the samples of a block.

        All samples go to memory once the file takes no more.
        """
        rows, cols = block_slices(self._shape, down, right)
        with self._lock:
            if self._file is not None and self._sums is not None:
                try:
                    self._write(self._file, rows, cols, samples)
                    self._sums[down, right] = checksum(samples)
                except (OSError, ValueError):
                    self.values = np.array(self.values)
                    self._file = None
            if self._file is None:
                self.values[rows, cols] = samples
            self.is_known[down, right] = True

    def _write(self, file: int, rows: slice, cols: slice, samples: Float32Array) -> None:
        """Write samples; through a map, a full disk would end the process."""
        for row, line in zip(range(rows.start, rows.stop), samples, strict=True):
            at = self._offset + 4 * (row * self._shape[1] + cols.start)
            if os.pwrite(file, np.ascontiguousarray(line).data, at) < line.nbytes:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    @property
    def _shape(self) -> Shape:
        rows, cols = self.values.shape
        return rows, cols


def _nothing_left(rows: slice, cols: slice) -> Float32Array:
    raise AssertionError(f"the block at {rows}, {cols} was made")


class LazyHeights:
    """The heights of a grid, made block by block by ``make``.

    ``bounds_m`` are the lowest and the highest that each block may hold (2, R, C). ``noted`` (1,)
    takes the digest of the field as text.
    """

    def __init__(
        self,
        blocks: Blocks,
        make: MakeBlock,
        bounds_m: Float32Array,
        noted: NDArray[np.bytes_] | None = None,
    ) -> None:
        self._blocks = blocks
        self._make = make
        self._bounds_m = bounds_m
        self._noted = np.zeros(1, "S64") if noted is None else noted

    @property
    def digest(self) -> str:
        """The digest of the field, empty until it is noted."""
        return bytes(self._noted[0]).decode()

    def note_digest(self, digest: str) -> None:
        """Note the digest of the field.

        Later runs know it where the heights are in a file.
        """
        with suppress(ValueError):  # The file must not be written.
            self._noted[0] = digest.encode()

    @property
    def shape(self) -> Shape:
        """Rows and columns."""
        rows, cols = self._blocks.values.shape
        return rows, cols

    def part(self, rows: slice, cols: slice) -> Float32Array:
        """Return the heights at some rows and columns, read-only."""
        self._ensure(self._touched(rows, cols))
        return self._seen()[rows, cols]

    def at(self, row: Int64Array, col: Int64Array) -> Float32Array:
        """Return the heights at rows and columns, which broadcast."""
        down, right = np.broadcast_arrays(row // _ROWS, col // _COLS)
        unknown = ~self._blocks.is_known[down, right]
        if unknown.any():
            wanted = np.unique(np.stack([down[unknown], right[unknown]]), axis=1)
            self._ensure([(int(one), int(other)) for one, other in wanted.T])
        return self._blocks.values[row, col]

    def whole(self) -> Float32Array:
        """Return all heights, read-only."""
        heights_m = self.part(slice(0, self.shape[0]), slice(0, self.shape[1]))
        self._make = _nothing_left  # What the blocks were made from may go.
        return heights_m

    def highest_m(self, rows: slice, cols: slice) -> float:
        """Return a bound above the heights of a part.

        It is -inf where there is no height.
        """
        touched = tuple(np.transpose(self._touched(rows, cols)))
        return float(self._bounds_m[1][touched].max(initial=-np.inf))

    def range_m(self) -> tuple[float, float]:
        """Return the lowest and the highest height.

        They are inf and -inf where there is none.
        """
        return self._extreme(0, 1.0), self._extreme(1, -1.0)

    def _extreme(self, which: int, sign: float) -> float:
        """Return the least of the heights times a sign, times the sign."""
        bounds = sign * self._bounds_m[which]
        least = np.inf
        # The blocks that may hold it come first; most others need not be made.
        for index in np.argsort(bounds, axis=None):
            at = np.unravel_index(index, bounds.shape)
            if not bounds[at] < least:
                break
            block = self.part(*block_slices(self.shape, int(at[0]), int(at[1])))
            least = min(least, float(np.fmin.reduce(sign * block, axis=None, initial=np.inf)))
        return sign * least

    def _touched(self, rows: slice, cols: slice) -> list[tuple[int, int]]:
        down = range(rows.start // _ROWS, -(-rows.stop // _ROWS))
        right = range(cols.start // _COLS, -(-cols.stop // _COLS))
        return list(itertools.product(down, right))

    def _ensure(self, wanted: list[tuple[int, int]]) -> None:
        """Make the blocks that are lacking."""
        missing = [at for at in wanted if self._blocks.lacks(*at)]
        if not missing:
            return

        def make(at: tuple[int, int]) -> None:
            self._blocks.put(*at, self._make(*block_slices(self.shape, *at)))

        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(make, missing))

    def _seen(self) -> Float32Array:
        seen = self._blocks.values.view(np.ndarray)
        seen.setflags(write=False)
        return seen

"""Heights that are made block by block, when they are first needed.

A skyline shows a small part of a large model. The samples of a warped model are therefore made only
where a skyline needs them, and kept in memory or in a file (`skyline.terrain.field_files`).
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

from skyline.arrays import BoolArray, Float32Array, Int64Array, UInt32Array

_ROWS = 64
"""Rows of a block: with `_COLS`, few enough for a thread's cache while the block is made."""
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
    """Return the lowest and highest heights (2, R, C) of each block.

    Infinite where a block has no height.
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
    """The samples of a grid in blocks, in memory or a file.

    Not all blocks need to be known.
    """

    def __init__(self, values: Float32Array) -> None:
        """Take the samples (rows, cols); no block is known yet."""
        self.values = values
        self.is_known: BoolArray = np.zeros(block_counts(self._shape), dtype=np.bool_)
        """Which blocks (R, C) hold their samples; the others may hold anything."""
        self._sums: UInt32Array = np.zeros(self.is_known.shape, dtype=np.uint32)
        """Checksums (R, C) of the blocks in the file, 0 for the others."""
        self._file: int | None = None
        self._offset = 0
        self._sums_offset = 0
        self._lock = threading.Lock()

    @classmethod
    def in_memory(cls, shape: Shape) -> "Blocks":
        """Return a grid in memory without known blocks."""
        return cls(np.empty(shape, dtype=np.float32))

    @classmethod
    def in_file(cls, file: BinaryIO, shape: Shape, offset: int, sums_offset: int) -> "Blocks":
        """Return the grid with samples and checksums at offsets of a file.

        A block without a checksum has yet to be made. Any other is known once its checksum has been
        compared, so a file whose writing was interrupted gives no wrong height.
        """
        blocks = cls(np.memmap(file, np.float32, "r", offset, shape))
        sums = os.pread(file.fileno(), blocks._sums.nbytes, sums_offset)
        blocks._sums = np.frombuffer(sums, np.uint32).reshape(blocks._sums.shape).copy()
        blocks._file = os.dup(file.fileno())
        blocks._offset = offset
        blocks._sums_offset = sums_offset
        weakref.finalize(blocks, os.close, blocks._file)
        return blocks

    def lacks(self, down: int, right: int) -> bool:
        """Return whether a block has yet to be made."""
        if not self.is_known[down, right] and self._sums[down, right]:
            found = checksum(self.values[block_slices(self._shape, down, right)])
            self.is_known[down, right] = found == self._sums[down, right]
        return not self.is_known[down, right]

    def put(self, down: int, right: int, samples: Float32Array) -> None:
        """Keep the samples of a block.

        If the file takes no more, all samples move to memory.
        """
        with self._lock:
            if self._file is not None:
                try:
                    self._write(self._file, down, right, samples)
                except OSError:
                    self._move_to_memory()
            if self._file is None:
                self.values[block_slices(self._shape, down, right)] = samples
            self.is_known[down, right] = True

    def note(self, offset: int, content: bytes) -> None:
        """Write a note at an offset of the file, if possible."""
        if self._file is not None:
            with suppress(OSError):
                write_at(self._file, offset, content)

    def _write(self, file: int, down: int, right: int, samples: Float32Array) -> None:
        """Write the samples of a block, then their checksum."""
        rows, cols = block_slices(self._shape, down, right)
        for row, line in zip(range(rows.start, rows.stop), samples, strict=True):
            at = self._offset + 4 * (row * self._shape[1] + cols.start)
            write_at(file, at, line.tobytes())
        total = np.uint32(checksum(samples))
        at = self._sums_offset + 4 * (down * self._sums.shape[1] + right)
        write_at(file, at, total.tobytes())
        self._sums[down, right] = total

    def _move_to_memory(self) -> None:
        """Move the known blocks to memory; the file may lack the others."""
        values = np.empty(self._shape, dtype=np.float32)
        for down, right in np.argwhere(self.is_known | (self._sums > 0)):
            block = block_slices(self._shape, down, right)
            values[block] = self.values[block]
        self.values = values
        self._file = None

    @property
    def _shape(self) -> Shape:
        rows, cols = self.values.shape
        return rows, cols


def write_at(file: int, offset: int, content: bytes) -> None:
    """Write at an offset of an open file.

    Raises `OSError` where the disk is full; through a map, that would end the process.
    """
    if os.pwrite(file, content, offset) < len(content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def _nothing_left(rows: slice, cols: slice) -> Float32Array:
    raise AssertionError(f"the block at {rows}, {cols} was made")


class LazyHeights:
    """The heights of a grid, made block by block by ``make``.

    ``bounds_m`` are the lowest and the highest that each block may hold (2, R, C). ``digest`` is
    the digest of the field, if it is known; ``keep_digest`` is called once it is.
    """

    def __init__(
        self,
        blocks: Blocks,
        make: MakeBlock,
        bounds_m: Float32Array,
        digest: str = "",
        keep_digest: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._blocks = blocks
        self._make = make
        self._bounds_m = bounds_m
        self.digest = digest
        """The digest of the field, empty until it is noted."""
        self._keep_digest = keep_digest

    def note_digest(self, digest: str) -> None:
        """Note the field's digest, in its file too if it has one."""
        self.digest = digest
        self._keep_digest(digest)

    @property
    def shape(self) -> Shape:
        """Rows and columns."""
        rows, cols = self._blocks.values.shape
        return rows, cols

    def part(self, rows: slice, cols: slice) -> Float32Array:
        """Return the heights at some rows and columns, read-only."""
        self._ensure(self._touched(rows, cols))
        return self._read_only()[rows, cols]

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
        """Return the lowest height, or the highest for a sign of -1."""
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
        """Make the missing blocks."""
        make = self._make  # Another thread may let it go once all blocks are made.
        missing = [at for at in wanted if self._blocks.lacks(*at)]
        if not missing:
            return

        def put(at: tuple[int, int]) -> None:
            self._blocks.put(*at, make(*block_slices(self.shape, *at)))

        with ThreadPoolExecutor(_THREADS) as pool:
            list(pool.map(put, missing))

    def _read_only(self) -> Float32Array:
        values = self._blocks.values.view(np.ndarray)
        values.setflags(write=False)
        return values

"""A checksum per row, over the bytes of the row as they are stored.

HDF5 guards its own structures (object headers, chunk indexes, the superblock) with checksums, and
each chunk of rows here with another (Fletcher-32), which readers verify as they read. Those see a
chunk that changed, but not one that was never written: a hole in a file reads as zeros, and the
Fletcher-32 of zeros is zero. The checksum of a row sees that, says which rows are whole when
others are not, and goes with the row from store to store.
"""

import zlib

import numpy as np
from numpy.typing import NDArray

from skyline.store.header import CHECKSUM, PLACE_CHECKSUM
from skyline.store.rows import Columns

_AT_ONCE_BYTES = 1 << 22
"""Rows are laid out anew for one call each; this many bytes of them at a time."""


def row_checksums(columns: Columns) -> NDArray[np.uint32]:
    """Return CRC-32s, (N,), over each row's little-endian bytes, datasets in order of name.

    Columns are (N, ...) stored rows by dataset; their checksums among them are passed over.
    """
    names = [name for name in sorted(columns) if name not in (CHECKSUM, PLACE_CHECKSUM)]
    count = len(columns[names[0]])
    sums = np.zeros(count, dtype=np.uint32)
    if not count:
        return sums
    plain = [np.ascontiguousarray(columns[name]).reshape(count, -1) for name in names]
    held = [values.view(np.uint8) for values in plain]
    step = max(_AT_ONCE_BYTES // sum(values.shape[1] for values in held), 1)
    for first in range(0, count, step):
        together = np.concatenate([values[first : first + step] for values in held], axis=1)
        sums[first : first + step] = checksums_of_bytes(together)
    return sums


def checksums_of_bytes(rows: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Return the CRC-32 of each row (N, B) of bytes."""
    width, flat = rows.shape[1], rows.tobytes()
    sums = (zlib.crc32(flat[start : start + width]) for start in range(0, len(flat), width))
    return np.fromiter(sums, dtype=np.uint32, count=len(rows))

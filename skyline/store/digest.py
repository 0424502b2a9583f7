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

from skyline.store.header import CHECKSUM
from skyline.store.rows import Columns


def row_checksums(columns: Columns) -> NDArray[np.uint32]:
    """Return CRC-32s, (N,), over each row's little-endian bytes, datasets in order of name.

    Parameters
    ----------
    columns : mapping of str to (N, ...) array
        Stored rows by dataset; `CHECKSUM` among them is passed over.
    """
    guarded = [columns[name] for name in sorted(columns) if name != CHECKSUM]
    count = len(guarded[0])
    sums = [0] * count
    for values in guarded if count else ():
        rows = np.ascontiguousarray(values).reshape(count, -1).view(np.uint8)
        sums = [zlib.crc32(row.tobytes(), so_far) for row, so_far in zip(rows, sums, strict=True)]
    return np.array(sums, dtype=np.uint32)

"""The places of a store, mapped: screened where they lie in the file, and taken by row.

Chunks of places are neither packed nor shuffled, so a place's bytes lie in the file as they are,
where HDF5's index of chunks says. The index is read once, when the store is opened; after that
HDF5 has no part, and any number of threads may read at the same time.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from skyline.errors import InputError, StoreError
from skyline.places import Places
from skyline.store.header import PLACE_CHECKSUM, StoreHeader
from skyline.store.lock import REBUILD
from skyline.store.rows import checksums_of_bytes

Offsets = dict[str, NDArray[np.int64]]
"""Where the chunks of each dataset begin in the file, by the dataset's name."""

_TAKEN_AT_ONCE = 4096


class PlaceMap:
    """The committed places of a store, a `skyline.places.PlaceSource`; see `Store.places`.

    It holds the file by itself, so the store may be closed, replaced or removed. Pages that are
    read belong to the system's cache. Memory of its own is the offsets: 72 bytes for 1024 places.

    A file that somebody cuts short is found out before each block and each batch of rows. Where
    it happens while one of them is being read, the system ends the process (SIGBUS), as with any
    mapped file. Stores are replaced, never cut short, by everything in `skyline.store`.
    """

    def __init__(self, path: Path, file: int, header: StoreHeader, places: int, at: Offsets):
        """Map the first ``places`` of a file, given as a descriptor, that lie ``at`` offsets."""
        self._path = path
        self._header = header
        self._places = places
        self._at = at
        self._types = header.specs
        # In the order in which their checksums are taken.
        self._fields = sorted(header.fields.items(), key=lambda item: item[1])
        self._record = np.dtype([(name, self._types[name]) for _, name in self._fields])
        ends = [
            int(offsets.max()) + header.chunk_rows * self._types[name].itemsize
            for name, offsets in at.items()
            if places
        ]
        self._end = max(ends, default=0)
        # A map of nothing is refused; an empty store has a superblock.
        self._map = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
        self._check_length(len(self._map))
        data = np.frombuffer(self._map, dtype=np.uint8)
        # A view of the bytes from each offset on: indexed by offsets, it gathers rows in one call.
        self._rows = {
            name: sliding_window_view(data, row.itemsize) for name, row in self._types.items()
        }

    def __len__(self) -> int:
        """Return the number of places."""
        return self._places

    def blocks(self) -> Iterator[Places]:
        """Yield all places in order, 1024 at a time (the last time fewer).

        The arrays are read-only and lie in the file: nothing is read before it is looked at, and
        nothing is verified (see `take`, and `check_store` for all of a store).

        Raises
        ------
        StoreError
            The file was cut short since the store was opened.
        """
        size = self._header.chunk_rows
        for chunk in range(-(-self._places // size)):
            self._check_length(self._map.size())
            rows = min(size, self._places - chunk * size)
            fields: Any = {
                field: np.ndarray((rows,), self._types[name], self._map, self._at[name][chunk])
                for field, name in self._fields
            }
            yield Places(**fields)

    def take(self, rows: NDArray[np.integer[Any]]) -> Places:
        """Return copies of the places ``rows`` (M,), in order, each held to its checksum.

        Raises
        ------
        InputError
            A row that is not there.
        StoreError
            A place that is not as it was written, or a file that was cut short.
        """
        wanted: NDArray[np.intp] = np.asarray(rows, dtype=np.intp)
        if wanted.ndim != 1 or not ((wanted >= 0) & (wanted < self._places)).all():
            raise InputError(
                f"rows to take from store {self._path} are not a list of numbers from 0 to "
                f"{self._places - 1}"
            )
        taken: Any = {
            field: np.empty(len(wanted), self._types[name]) for field, name in self._fields
        }
        # In the order of the file, so that a disk is read forwards and each page once.
        order = np.argsort(wanted, kind="stable")
        for first in range(0, len(wanted), _TAKEN_AT_ONCE):
            self._check_length(self._map.size())
            to = order[first : first + _TAKEN_AT_ONCE]
            gathered = self._gathered(wanted[to])
            for field, name in self._fields:
                taken[field][to] = gathered[name]
        return Places(**taken)

    def _gathered(self, rows: NDArray[np.intp]) -> NDArray[np.void]:
        """Return some places (M,), each by the names of its datasets; verified."""
        chunk, row = np.divmod(rows, self._header.chunk_rows)
        bytes_of = [
            self._rows[name][self._at[name][chunk] + row * self._types[name].itemsize]
            for name in (*(self._record.names or ()), PLACE_CHECKSUM)
        ]
        together = np.concatenate(bytes_of[:-1], axis=1)
        wrong = checksums_of_bytes(together) != bytes_of[-1].view("<u4")[:, 0]
        if wrong.any():
            raise StoreError(
                f"store {self._path} is damaged: place {rows[wrong][0]} does not have its "
                "checksum; `skyline store check` says what else, `skyline store repair` saves "
                "what is whole"
            )
        return together.view(self._record)[:, 0]

    def _check_length(self, size: int) -> None:
        if size < self._end:
            raise StoreError(
                f"store {self._path} is truncated: {size} bytes, of which places need "
                f"{self._end}; {REBUILD}"
            )

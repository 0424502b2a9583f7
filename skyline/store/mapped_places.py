"""Reading places from files of stores that are mapped into memory."""

import mmap
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from skyline.arrays import Int64Array, IntArray, UInt8Array
from skyline.errors import InputError, StoreError
from skyline.store.layout import PLACES_A_CHUNK, REBUILD, StoreHeader, checksums_of_bytes
from skyline.store.places import Places

_Read = TypeVar("_Read")

Offsets = dict[str, Int64Array]
"""Byte in the file at which each chunk begins, by dataset."""


class PlaceMap:
    """The places of a store; see `Store.places`.

    It keeps the file open, so the store may be closed, replaced or removed. Pages that are read
    belong to the system's cache; the map itself takes 72 bytes for 1024 places.

    The file's length is checked before each block and each batch of rows. If a file is truncated
    while one of them is being read, the system ends the process (SIGBUS), as with any mapped file.
    `skyline.store.write` replaces stores and never truncates one.
    """

    def __init__(self, path: Path, file: int, header: StoreHeader, places: int, at: Offsets):
        """Map places in a file descriptor; their chunks begin ``at`` offsets."""
        self._path = path
        self._header = header
        self._places = places
        self._at = at
        self._size = header.chunk_rows(places)
        self._types = header.specs
        # Checksums are computed over the datasets in order of name.
        self._fields = {name: field for field, name in header.fields.items()}
        self._record = np.dtype([(name, self._types[name]) for name in sorted(self._fields)])
        self._end = max(
            int(offsets.max(initial=0)) + self._size * self._types[name].itemsize
            for name, offsets in at.items()
        )
        # The system maps no empty file, but even an empty store has a superblock.
        self._map = mmap.mmap(file, 0, access=mmap.ACCESS_READ)
        self._check_length()
        data = np.frombuffer(self._map, dtype=np.uint8)
        # A view of the bytes from each offset on: indexed by offsets, it gathers rows in one call.
        self._rows = {
            name: sliding_window_view(data, row.itemsize) for name, row in self._types.items()
        }

    def __repr__(self) -> str:
        return f"PlaceMap({len(self)} places)"

    def __len__(self) -> int:
        """Return the number of places."""
        return self._places

    def blocks(self, first: int = 0, stop: int | None = None) -> Iterator[Places]:
        """Yield all places in order, at most 1024 at a time.

        The arrays are read-only and lie in the file, which is read when an array is. No checksum is
        compared: `take` does that, and `check_store` for the whole store.

        Parameters
        ----------
        first, stop : int, optional
            Only the places of these rows; ``first`` is a multiple of 1024, as is ``stop`` unless it
            is the number of places.

        Raises
        ------
        StoreError
            The file was cut short since the store was opened.
        """
        size = self._size
        stop = self._places if stop is None else stop
        for chunk in range(first // size, -(-stop // size)):
            self._check_length()
            rows = min(size, self._places - chunk * size)
            fields: Any = {
                field: np.ndarray((rows,), self._types[name], self._map, self._at[name][chunk])
                for name, field in self._fields.items()
            }
            yield Places(**fields)

    def phases(self, rows: IntArray) -> UInt8Array:
        """Return copies of the phases (M, 180) of existing places, unchecked.

        Raises
        ------
        StoreError
            The file was cut short since the store was opened.
        """
        self._check_length()
        return self._bytes_of(self._header.fields["phase"], rows)

    def take(self, rows: NDArray[np.integer[Any]]) -> Places:
        """Return copies of places (M,) in order, compared with their checksums.

        Raises
        ------
        InputError
            A row does not exist.
        StoreError
            A place differs from its checksum, or the file was cut short.
        """
        given = np.asarray(rows)
        wanted: IntArray = given.astype(np.intp)
        # A mask is no list of rows, though its values are numbers.
        is_list = given.ndim == 1 and (given.dtype.kind in "iu" or not given.size)
        if not is_list or not ((wanted >= 0) & (wanted < self._places)).all():
            raise InputError(
                f"rows to take from store {self._path} are not a list of numbers from 0 to "
                f"{self._places - 1}"
            )
        taken: Any = {
            field: np.empty(len(wanted), self._types[name]) for name, field in self._fields.items()
        }
        # Rows are read in the order of the file: a disk is read forwards, and each page once.
        at_once = 4096
        order = np.argsort(wanted, kind="stable")
        for first in range(0, len(wanted), at_once):
            self._check_length()
            to = order[first : first + at_once]
            gathered = self._gathered(wanted[to])
            for name, field in self._fields.items():
                taken[field][to] = gathered[name]
        return Places(**taken)

    def _unverified(self, rows: IntArray) -> Places:
        """Return copies of existing places (M,), without comparing checksums.

        Raises
        ------
        StoreError
            The file was cut short since the store was opened.
        """
        self._check_length()
        read: Any = {
            field: self._bytes_of(name, rows)
            .view(self._types[name].base)
            .reshape(len(rows), *self._types[name].shape)
            for name, field in self._fields.items()
        }
        return Places(**read)

    def _gathered(self, rows: IntArray) -> NDArray[np.void]:
        """Return places (M,) by dataset, compared with their checksums."""
        bytes_of = [
            self._bytes_of(name, rows) for name in (*sorted(self._fields), self._header.checksum)
        ]
        together = np.concatenate(bytes_of[:-1], axis=1)
        wrong = checksums_of_bytes(together) != bytes_of[-1].view("<u4")[:, 0]
        if wrong.any():
            raise StoreError(
                f"store {self._path} is damaged: place {rows[wrong][0]} does not match its "
                "checksum; `skyline store check` lists all damage, `skyline store repair` "
                "saves the whole rows"
            )
        return together.view(self._record)[:, 0]

    def _bytes_of(self, name: str, rows: IntArray) -> UInt8Array:
        """Return the bytes of some rows of a dataset, (M, row)."""
        chunk, row = np.divmod(rows, self._size)
        found: UInt8Array = self._rows[name][
            self._at[name][chunk] + row * self._types[name].itemsize
        ]
        return found

    def _check_length(self) -> None:
        if (size := self._map.size()) < self._end:
            raise StoreError(
                f"store {self._path} is truncated: {size} bytes, of which places need "
                f"{self._end}; {REBUILD}"
            )


class JoinedPlaces(PlaceMap):
    """The places of several stores, in the order of a merged store.

    Nothing is copied to a file; the order takes 8 bytes a place.

    Parameters
    ----------
    maps : sequence of PlaceMap
    order : (N,) intp
        Rows of the joined places. They are counted through all maps, one after another.
    """

    def __init__(self, maps: Sequence[PlaceMap], order: IntArray) -> None:
        self._maps = maps
        self._order = order
        self._starts = np.cumsum([0, *(len(one) for one in maps)])

    def __len__(self) -> int:
        """Return the number of places."""
        return len(self._order)

    def blocks(self, first: int = 0, stop: int | None = None) -> Iterator[Places]:
        """Yield all places in order, as one store does; see `PlaceMap.blocks`.

        The blocks are copies. They are as long as those of one store: a product of matrices may
        round differently in blocks of another length.
        """
        stop = len(self) if stop is None else stop
        for start in range(first, stop, PLACES_A_CHUNK):
            rows = np.arange(start, min(start + PLACES_A_CHUNK, stop))
            yield self._read(rows, PlaceMap._unverified, Places.concatenate)

    def phases(self, rows: IntArray) -> UInt8Array:
        """Return copies of the phases (M, 180) of places; as `PlaceMap.phases`."""
        return self._read(rows, PlaceMap.phases, np.concatenate)

    def take(self, rows: NDArray[np.integer[Any]]) -> Places:
        """Return copies of places ``rows`` (M,) in order; as `PlaceMap.take`."""
        return self._read(np.asarray(rows, dtype=np.intp), PlaceMap.take, Places.concatenate)

    def _read(
        self,
        rows: IntArray,
        read: Callable[[PlaceMap, IntArray], _Read],
        concatenate: Callable[[list[_Read]], _Read],
    ) -> _Read:
        """Read joined rows (M,) from their maps, and return them in order."""
        found = self._order[rows]
        of = np.searchsorted(self._starts, found, side="right") - 1
        parts = []
        at = []
        for number, one in enumerate(self._maps):
            mine = np.flatnonzero(of == number)
            if len(mine) or not number:
                parts.append(read(one, found[mine] - self._starts[number]))
                at.append(mine)
        back: Any = np.argsort(np.concatenate(at), kind="stable")
        together: Any = concatenate(parts)
        joined: _Read = together[back]
        return joined


class PartOfPlaces:
    """A part of mapped places, with rows of its own; as `PlaceMap`.

    ``first`` and ``stop`` are as for `PlaceMap.blocks`.
    """

    def __init__(self, places: PlaceMap, first: int, stop: int) -> None:
        self._places = places
        self._first = first
        self._stop = stop

    def __len__(self) -> int:
        return self._stop - self._first

    def blocks(self) -> Iterator[Places]:
        """Yield the places in order; see `PlaceMap.blocks`."""
        return self._places.blocks(self._first, self._stop)

    def phases(self, rows: IntArray) -> UInt8Array:
        """Return copies of the phases (M, 180) of places; see `PlaceMap.phases`."""
        return self._places.phases(self._first + rows)

    def take(self, rows: IntArray) -> Places:
        """Return copies of places (M,); see `PlaceMap.take`."""
        return self._places.take(self._first + rows)


PlaceSource = PlaceMap | PartOfPlaces | Places
"""Places in files or in memory."""

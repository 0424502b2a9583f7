"""The rows that a store's writer has committed, read while it may be at work."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.errors import StoreError
from skyline.store.checks import checked_dataset, read_committed, read_header
from skyline.store.digest import row_checksums
from skyline.store.explain import REBUILD, explained
from skyline.store.header import PLACES
from skyline.store.place_map import Offsets, PlaceMap
from skyline.store.rows import stored_places
from skyline.store.superblock import WholeFile

_T = TypeVar("_T")

_READ_AGAIN = 5
_READ_AGAIN_PAUSE_S = 0.02


class CommittedRows:
    """The datasets of a store in an open file, which is closed with them.

    Attributes
    ----------
    count : int
        Number of complete rows when it was opened.
    """

    def __init__(self, path: Path, raw: WholeFile) -> None:
        """Check and open the store in an open file; raises `StoreError`."""
        self.path = path
        self._raw = raw
        with explained(path, "it cannot be opened"), ExitStack() as resources:
            self._file = resources.enter_context(h5py.File(raw, "r"))
            self.header = read_header(path, self._file)
            # Counted before the datasets are opened: a writer at work may lengthen them.
            self.committed = read_committed(path, self._file)
            self._datasets = self._open_datasets()
            self._check_committed()
            resources.pop_all()

    @property
    def longest(self) -> int:
        """Rows of the longest dataset: more than are committed while a writer is at work."""
        return max(len(dataset) for dataset in self._datasets.values())

    @property
    def in_use(self) -> bool:
        """Whether a writer had the store open when it was opened, or was killed at work."""
        return self._raw.superblock.in_use

    def close(self) -> None:
        """Let go of the file; closing twice is fine."""
        self._file.close()
        self._raw.close()

    def _read(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        """Return rows of a dataset in the order wanted; raises `StoreError`."""
        try:
            return self._reading(lambda: self._read_once(name, rows))
        except StoreError:
            if not (self.header.holds == PLACES and self.in_use):
                raise
        # Places are appended to a last chunk where it lies. A kill that tears this leaves HDF5's
        # checksum of the chunk wrong, but committed rows as they were, which their own show.
        columns = stored_places(self.header, self._map_places().take(rows))
        return columns[name] if name in columns else row_checksums(columns)

    def _map_places(self) -> PlaceMap:
        """Map the rows of a store of places; raises `StoreError`."""
        offsets = self._reading(self._chunk_offsets)
        with explained(self.path, "it cannot be mapped"):
            return PlaceMap(self.path, self._raw.fileno(), self.header, self.committed, offsets)

    def _damaged(self, what: str) -> StoreError:
        """Return the error that says in which way the store is damaged."""
        return StoreError(f"store {self.path} is damaged: {what}; {REBUILD}")

    def _reading(self, read: Callable[[], _T]) -> _T:
        """Return ``read()``, on a file opened anew where a writer has changed it meanwhile."""
        if self._raw.closed:
            raise StoreError(f"store {self.path} is closed; open it again to read it")
        try:
            return read()
        except StoreError:
            if not self._raw.refresh():
                raise

        def read_anew() -> _T:
            with explained(self.path, "it cannot be opened again"):
                self._file.close()
                self._file = h5py.File(self._raw, "r")
                self._datasets = self._open_datasets()
            return read()

        return patiently(self._raw, read_anew)

    def _read_once(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        with explained(self.path, f"{name} cannot be read"):
            dataset = self._datasets[name]
            if len(rows) == 0:
                return np.zeros((0, *dataset.shape[1:]), dataset.dtype)
            if (np.diff(rows) == 1).all():
                return np.asarray(dataset[rows[0] : rows[-1] + 1])
            # HDF5 wants rows ascending and once each.
            ascending, position = np.unique(rows, return_inverse=True)
            return np.asarray(dataset[ascending])[position]

    def _chunk_offsets(self) -> Offsets:
        """Return where the chunks of committed rows begin, of every dataset."""
        size = self.header.chunk_rows
        found = {}
        for name, dataset in self._datasets.items():
            with explained(self.path, f"the chunks of {name} cannot be read"):
                at = np.zeros(-(-self.committed // size), dtype=np.int64)
                for chunk, offset in _chunks(dataset, len(at)):
                    at[chunk] = offset
            # HDF5's own structures come first in a file.
            if not (at > 0).all():
                lost = int(np.flatnonzero(at <= 0)[0]) * size
                raise self._damaged(f"{name} holds no row {lost}, which is committed")
            found[name] = at
        return found

    def _open_datasets(self) -> dict[str, h5py.Dataset]:
        return {
            name: checked_dataset(self.path, self._file, name, spec, self.header)
            for name, spec in self.header.specs.items()
        }

    def _check_committed(self) -> None:
        # Not by what HDF5 says the datasets take: it visits every chunk that a damaged index names.
        rows = min(len(dataset) for dataset in self._datasets.values())
        if self.committed > min(rows, self._raw.size):
            raise self._damaged(f"it says {self.committed} rows are committed and holds {rows}")
        for name, dataset in self._datasets.items():
            place = (max(self.committed - 1, 0),) + (0,) * (dataset.ndim - 1)
            if self.committed and dataset.id.get_chunk_info_by_coord(place).byte_offset is None:
                raise self._damaged(f"{name} holds no row {place[0]}, which is committed")


def patiently(raw: WholeFile, read: Callable[[], _T]) -> _T:
    """Return ``read()``, tried again where a writer at work may have changed what it read."""
    for _ in range(_READ_AGAIN):
        try:
            return read()
        except StoreError:
            if not raw.refresh():
                raise
            time.sleep(_READ_AGAIN_PAUSE_S)
    return read()


def _chunks(dataset: h5py.Dataset, count: int) -> list[tuple[int, int]]:
    """Return number and offset of the first ``count`` chunks of rows, those that are there."""
    rows, found = dataset.chunks[0], []
    if not hasattr(dataset.id, "chunk_iter"):
        for chunk in range(count):
            place = (chunk * rows,) + (0,) * (dataset.ndim - 1)
            found.append((chunk, dataset.id.get_chunk_info_by_coord(place).byte_offset or 0))
        return found

    def visit(info: Any) -> bool | None:
        chunk = info.chunk_offset[0] // rows
        if chunk >= count:
            return True  # and no further: an index may name chunks that were never committed
        found.append((chunk, info.byte_offset or 0))
        return None

    if count:
        dataset.id.chunk_iter(visit)
    return found

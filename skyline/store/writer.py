"""Appending rows to a store so that a kill at any instant loses no committed one."""

import io
import logging
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Self

import h5py
import numpy as np

from skyline.errors import StoreError
from skyline.places import Places
from skyline.store.built import Built
from skyline.store.header import (
    BUILT,
    COMMITTED,
    PLACES,
    RENDERINGS,
    SCHEMA,
    SCHEMA_VERSION,
    KeypointColumns,
    StoreHeader,
    check_holds,
    refuse_mismatch,
)
from skyline.store.lock import RESUME, complete_or_absent, explained, new_store, writer_lock
from skyline.store.reader import Store, open_store
from skyline.store.rows import Columns, row_checksums, stored_places, stored_rows
from skyline.views import Views

_log = logging.getLogger(__name__)

_LIBVER = ("v110", "v110")
"""SWMR needs the file format of HDF5 1.10; pinned, so that every release since reads it."""

_PACKING = {
    "exact": {"shuffle": True, "compression": "gzip", "compression_opts": 1},
    "compact": {"shuffle": True, "compression": "gzip", "compression_opts": 4},
    "places": {},
}
"""Davos at W = 640, bytes of a skyline and its depths: exact 2.7 kB instead of 5.1 (level 4: 2 %
less, half as fast to read); compact 0.55 kB (level 1: 7 % more, level 9: 4 % less at five times
the cost). Packing takes 0.1 ms a row and unpacking 0.03 ms, less than rendering the row.
Places are bytes already that would hardly pack, and plain chunks can be mapped."""

_ALIGNED_BYTES, _ALIGNED_FROM = 64, 1024
"""Chunks of places begin at whole cache lines, for half a byte a place."""


class StoreWriter:
    """Appends rows to a store; made by `create_store` and `open_for_append`.

    Rows are committed in whole chunks (32 renderings or 1024 places), the rest on `flush` and
    `close`: a packed chunk that is written twice leaves its first copy behind as dead bytes.
    Leaving the ``with`` block commits what was appended also when an exception, such as Ctrl-C,
    ends it.

    Attributes
    ----------
    header : StoreHeader
        What the store is built from and how.
    committed : int
        Number of rows that a reader sees and a kill cannot take away.
    built : Built
        How much of its build the store holds, as `note_built` was called last.
    """

    def __init__(
        self, path: Path, header: StoreHeader, file: h5py.File, resources: ExitStack
    ) -> None:
        """Take over a checked store; ``resources`` closes the file and releases the lock."""
        self._path = path
        self.header = header
        self._file = file
        self._resources = resources
        self._datasets = {name: self._file[name] for name in header.specs}
        self._marker = self._file[COMMITTED]
        self.committed = int(self._marker[()])
        self._built = self._file.get(BUILT)  # None in a store of an older release.
        self.built = Built() if self._built is None else Built(*self._built[()].tolist())
        self._noted: list[tuple[int, Built]] = []
        self._pending: list[Columns] = []
        self._failed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        try:
            self.close()
        except StoreError as close_error:
            if error is None:
                raise
            _log.warning("%s", close_error)

    def __len__(self) -> int:
        """Rows appended so far, committed or not."""
        return self.committed + sum(len(columns[self.header.checksum]) for columns in self._pending)

    def append(self, views: Views, keypoint_columns: KeypointColumns) -> None:
        """Add renderings.

        Parameters
        ----------
        views : Views
            N views of the store's width.
        keypoint_columns : (N, K) uint16
            Columns of the skylines' polyline vertices, padded with `NO_KEYPOINT`.

        Raises
        ------
        InputError
            Shapes or values that do not fit the store, or one of places; nothing is added.
        StoreError
            The rows cannot be written (disk full, for one). Committed rows are safe.
        """
        self._check_usable()
        check_holds(self._path, self.header, RENDERINGS)
        self.append_stored(stored_rows(self.header, views, keypoint_columns))

    def append_places(self, places: Places, *, all_or_none: bool = False) -> None:
        """Add places to a store of places; raises as `append`.

        With ``all_or_none`` they are committed at once, and a kill leaves all of them or none.
        """
        self._check_usable()
        check_holds(self._path, self.header, PLACES)
        self.append_stored(stored_places(self.header, places), all_or_none=all_or_none)

    def append_stored(self, columns: Columns, *, all_or_none: bool = False) -> None:
        """Add rows of a store with the same header, as `Store.stored` reads them."""
        self._check_usable()
        self._pending.append({**columns, self.header.checksum: row_checksums(columns)})
        left = 0 if all_or_none else len(self) % self.header.chunk_rows
        self._commit(len(self) - left)

    def note_built(self, built: Built) -> None:
        """Note how much of its build the store holds with the rows appended so far.

        It is written once these are committed, so that a kill leaves a store that claims too
        little rather than too much. Raises as `append`.
        """
        self._check_usable()
        self.built = built
        self._noted.append((len(self), built))
        self._write_built()

    def flush(self) -> None:
        """Commit every appended row now; raises as `append`."""
        self._check_usable()
        self._commit(len(self))

    def close(self) -> None:
        """Commit what is left and let go of the file and its lock; closing twice is fine."""
        if not self._file:
            return
        with explained(self._path, "it cannot be completed", RESUME), self._resources:
            if not self._failed:
                self.flush()

    def _check_usable(self) -> None:
        if not self._file or self._failed:
            state = "had a failed write" if self._failed else "is closed"
            raise StoreError(f"the writer of {self._path} {state}; open the store for append again")

    def _commit(self, stop: int) -> None:
        """Write pending rows up to row ``stop`` and count them once they are in the file."""
        start, count = self.committed, stop - self.committed
        if count <= 0:
            return
        pending = {
            name: np.concatenate([columns[name] for columns in self._pending])
            for name in self._datasets
        }
        with self._writing():
            for name, values in pending.items():
                dataset = self._datasets[name]
                if len(dataset) < stop:
                    dataset.resize(stop, axis=0)
                dataset[start:stop] = values[:count]
                dataset.flush()
            os.fsync(self._file.id.get_vfd_handle())
            self._marker[()] = stop
            self._marker.flush()
        # At once, so that an interrupt finds each row either pending or committed.
        rest = {name: values[count:] for name, values in pending.items()}
        self.committed, self._pending = stop, [rest]
        self._write_built()

    def _write_built(self) -> None:
        """Write what was noted last of rows that are all committed."""
        sure = [built for rows, built in self._noted if rows <= self.committed]
        if sure and self._built is not None:
            with self._writing():
                self._built[...] = sure[-1].done, sure[-1].total
                self._built.flush()
        del self._noted[: len(sure)]

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Do not write again where writing failed; raises `StoreError` there."""
        try:
            with explained(self._path, "rows cannot be written", RESUME):
                yield
        except StoreError:
            self._failed = True
            self._divert()
            raise

    def _divert(self) -> None:
        """Let HDF5 write the rest to nowhere; the file stays as a killed writer leaves it.

        HDF5 cannot give up: it writes what it holds when it closes the file, and where that fails
        again it crashes the process at exit.
        """
        nowhere = os.memfd_create("skyline-store")
        os.dup2(nowhere, self._file.id.get_vfd_handle())
        os.close(nowhere)


def create_store(
    path: str | os.PathLike[str],
    header: StoreHeader,
    built: Built | None = None,
    *,
    overwrite: bool = False,
) -> StoreWriter:
    """Create an empty store and open it for writing.

    The file appears under its name whole or not at all.

    Parameters
    ----------
    path : path-like
        Its folder must exist.
    built : Built, optional
        How much of its build the store holds when it is empty; by default that is not known.
    overwrite : bool
        Replace a file that is there already.

    Raises
    ------
    MissingFileError
        The folder does not exist.
    StoreError
        The file exists, is being written by another process, or the folder is not writable.
    """
    path = Path(path).resolve()
    advice = "resume it by opening it for append, remove it, or choose another name"
    with ExitStack() as resources:
        resources.enter_context(new_store(path, advice, overwrite=overwrite))
        with complete_or_absent(path) as partial:
            write_empty(partial, header, built or Built())
        file = resources.enter_context(open_to_write(path, header))
        return StoreWriter(path, header, file, resources.pop_all())


def open_for_append(path: str | os.PathLike[str], header: StoreHeader) -> StoreWriter:
    """Open a store to add rows after its committed ones.

    Parameters
    ----------
    header : StoreHeader
        What the new rows are built from and how. What it holds, the frame, DEM digest, config,
        width, number of keypoints and coding must equal the store's; its other fields are kept.

    Raises
    ------
    MissingFileError
        No such file.
    StoreMismatchError
        The store was built otherwise; both values are named.
    StoreError
        Not a store, damaged, not writable, or being written by another process.
    """
    path = Path(path).resolve()
    open_store(path).close()
    with ExitStack() as resources:
        resources.enter_context(writer_lock(path))
        with open_store(path) as store:
            stored = store.header
            refuse_mismatch(
                (stored, "there"),
                (header, "here"),
                f"store {path} was built otherwise",
                "repeat its settings or write to another file",
            )
            if store.in_use:  # by nobody, since the lock was free
                _log.warning("store %s: its writer was killed; keeping %d rows", path, len(store))
                _rewrite(path, store)
        file = resources.enter_context(open_to_write(path, stored))
        return StoreWriter(path, stored, file, resources.pop_all())


def amend_config(path: str | os.PathLike[str], settings: Mapping[str, object]) -> None:
    """Add settings that were known only when a store was complete, or replace them.

    The file is written anew and takes the old one's place whole; rows are kept to the bit.

    Raises
    ------
    InputError
        Settings that JSON cannot hold.
    StoreError
        Not a store, damaged, not writable, or being written by another process.
    """
    path = Path(path).resolve()
    with writer_lock(path), open_store(path) as store:
        config = {**store.header.config, **settings}
        if config != store.header.config:
            _rewrite(path, store, replace(store.header, config=config))


def _rewrite(path: Path, store: Store, header: StoreHeader | None = None) -> None:
    """Replace the file by one that holds the committed rows of ``store`` alone."""
    step = block_rows(store.header)
    with complete_or_absent(path) as partial:
        with new_rows(partial, header or store.header) as writer:
            for first in range(0, len(store), step):
                writer.append_stored(store.stored(slice(first, first + step)))
            writer.note_built(store.built)
        shutil.copymode(path, partial)


def write_empty(path: Path, header: StoreHeader, built: Built) -> None:
    """Write a new file that holds a store without rows."""
    # HDF5 makes the file in memory, since it crashes the process at exit if it cannot write it.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=_LIBVER) as file:
        file.attrs["schema"] = SCHEMA
        file.attrs["schema_version"] = SCHEMA_VERSION
        for name, text in header.attributes.items():
            file.attrs[name] = text
        file.attrs["header_digest"] = header.digest
        for name, row in header.specs.items():
            file.create_dataset(
                name,
                shape=(0, *row.shape),
                maxshape=(None, *row.shape),
                chunks=(header.chunk_rows, *row.shape),
                dtype=row.base,
                fletcher32=True,
                **(_PACKING[header.rows] if row.shape else {}),
            )
        # Datasets, since SWMR writes no attributes.
        file.create_dataset(COMMITTED, data=np.uint64(0))
        file.create_dataset(BUILT, data=np.array([built.done, built.total], dtype=np.uint64))
    with path.open("xb") as target:
        target.write(image.getbuffer())
        target.flush()
        os.fsync(target.fileno())


def open_to_write(path: Path, header: StoreHeader) -> h5py.File:
    """Open in SWMR mode from the first byte.

    To open for writing and then switch, as h5py does, leaves an instant at which a kill marks
    the file as no reader's at all. The lock is ours, since HDF5 takes none in this mode.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_file_locking(False, True)
    if header.holds == PLACES:
        access.set_alignment(_ALIGNED_FROM, _ALIGNED_BYTES)
    flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
    with explained(path, "it cannot be opened for writing", "check that you may write it"):
        return h5py.File(h5py.h5f.open(os.fsencode(path), flags, access))


def block_rows(header: StoreHeader) -> int:
    """Return how many rows to copy, and to commit, at a time: some megabytes, whole chunks."""
    return max(1024, 8 * header.chunk_rows)


@contextmanager
def new_rows(path: Path, header: StoreHeader) -> Iterator[StoreWriter]:
    """Write a new store file, which nobody else knows: the same rows give the same bytes."""
    write_empty(path, header, Built())
    with (
        open_to_write(path, header) as file,
        StoreWriter(path, header, file, ExitStack()) as writer,
    ):
        yield writer

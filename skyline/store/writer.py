"""Appending rows to a store so that a kill at any instant loses no committed one."""

import io
import json
import logging
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.errors import (
    InputError,
    MissingFileError,
    StoreError,
    StoreMismatchError,
)
from skyline.features import NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.store.explain import RESUME, explained
from skyline.store.header import (
    KEYPOINTS,
    SCHEMA,
    SCHEMA_VERSION,
    SHELL_SPECS,
    VIEW_SPECS,
    KeypointColumns,
    StoreHeader,
)
from skyline.store.lock import complete_or_absent, writer_lock
from skyline.store.reader import Store, open_store
from skyline.views import Shells, Views

_log = logging.getLogger(__name__)

_LIBVER = ("v110", "v110")
"""SWMR needs the file format of HDF5 1.10; pinned, so that every release since reads it."""

_WIDE_CHUNK_ROWS = 32
"""Rows a chunk of the (N, W) datasets: 80 kB at W = 640. Half costs 3 % more bytes, twice saves
2 %, and a single row is read by unpacking one chunk."""

_SCALAR_CHUNK_ROWS = 1024

_COMPRESSION = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
"""Davos at W = 640: 2.7 kB a row instead of 6.0; level 4 saves 2 % more and reads half as fast.
Packing takes 0.1 ms a row and unpacking 0.03 ms, less than rendering the row."""


class StoreWriter:
    """Appends rows to a store; made by `create_store` and `open_for_append`.

    Rows are committed in whole chunks (32 rows), the rest on `flush` and `close`: a packed chunk
    that is written twice leaves its first copy behind as dead bytes. Leaving the ``with`` block
    commits what was appended also when an exception, such as Ctrl-C, ends it.
    """

    def __init__(
        self, path: Path, header: StoreHeader, file: h5py.File, resources: ExitStack
    ) -> None:
        """Take over a checked store; ``resources`` closes the file and releases the lock."""
        self._path = path
        self._header = header
        self._file = file
        self._resources = resources
        self._datasets = {name: self._file[name] for name in header.specs}
        self._marker = self._file["committed"]
        self._committed = int(self._marker[()])
        self._chunk_rows = int(self._datasets[KEYPOINTS].chunks[0])
        self._pending = _no_rows(header)
        self._pending_keypoints = np.zeros((0, header.max_keypoints), dtype=np.uint16)
        self._failed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except StoreError as close_error:
            if error is None:
                raise
            _log.warning("%s", close_error)

    def __len__(self) -> int:
        """Rows appended so far, committed or not."""
        return self._committed + len(self._pending)

    @property
    def header(self) -> StoreHeader:
        """What the store is built from and how."""
        return self._header

    @property
    def committed(self) -> int:
        """Number of rows that a reader sees and a kill cannot take away."""
        return self._committed

    def append(self, views: Views, keypoint_columns: KeypointColumns) -> None:
        """Add rows.

        Parameters
        ----------
        views : Views
            N views of the store's width.
        keypoint_columns : (N, K) uint16
            Columns of the skylines' polyline vertices, padded with `NO_KEYPOINT`.

        Raises
        ------
        InputError
            Shapes or values that do not fit the store; nothing is added.
        StoreError
            The rows cannot be written (disk full, for one). Committed rows are safe.
        """
        self._check_usable()
        self._check_rows(views, keypoint_columns)
        self._pending = Views.concatenate([self._pending, views])
        self._pending_keypoints = np.concatenate([self._pending_keypoints, keypoint_columns])
        self._commit(len(self) - len(self) % self._chunk_rows)

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

    def _check_rows(self, views: Views, keypoint_columns: KeypointColumns) -> None:
        edges = () if views.shells is None else tuple(views.shells.edges_m.tolist())
        if edges != self._header.shell_edges_m:
            raise InputError(
                f"views to append have shells at {edges or 'no'} edges; store {self._path} has "
                f"{self._header.shell_edges_m or 'none'}: render them as the store was begun"
            )
        for name, values in self._columns(views, keypoint_columns):
            expected = (len(views), *self._header.row_shape(self._header.specs[name].per_row))
            if np.shape(values) != expected:
                raise InputError(
                    f"{name} to append has shape {np.shape(values)}; store {self._path} expects "
                    f"{expected}: use its width, {self._header.width}, and its number of "
                    f"keypoints, {self._header.max_keypoints}"
                )
        columns = np.asarray(keypoint_columns)
        if ((columns < 0) | (columns >= self._header.width) & (columns != NO_KEYPOINT)).any():
            raise InputError(
                f"keypoint columns to append lie outside 0 to {self._header.width - 1}; "
                f"pad rows with {NO_KEYPOINT}"
            )
        if not np.isin(views.heading, HEADINGS).all():
            raise InputError(f"a heading to append is not one of {HEADINGS}")

    def _commit(self, stop: int) -> None:
        """Write pending rows up to row ``stop`` and count them once they are in the file."""
        start, count = self._committed, stop - self._committed
        if count <= 0:
            return
        rows = self._columns(self._pending[:count], self._pending_keypoints[:count])
        try:
            with explained(self._path, "rows cannot be written", RESUME):
                for name, values in rows:
                    dataset = self._datasets[name]
                    if len(dataset) < stop:
                        dataset.resize(stop, axis=0)
                    dataset[start:stop] = values
                    dataset.flush()
                os.fsync(self._file.id.get_vfd_handle())
                self._marker[()] = stop
                self._marker.flush()
        except StoreError:
            self._failed = True
            self._divert()
            raise
        self._committed = stop
        self._pending = self._pending[count:]
        self._pending_keypoints = self._pending_keypoints[count:]

    def _divert(self) -> None:
        """Let HDF5 write the rest to nowhere; the file stays as a killed writer leaves it.

        HDF5 cannot give up: it writes what it holds when it closes the file, and where that fails
        again it crashes the process at exit.
        """
        nowhere = os.memfd_create("skyline-store")
        os.dup2(nowhere, self._file.id.get_vfd_handle())
        os.close(nowhere)

    @staticmethod
    def _columns(
        views: Views, keypoint_columns: KeypointColumns
    ) -> Iterator[tuple[str, NDArray[Any]]]:
        for attribute, (name, _) in VIEW_SPECS.items():
            yield name, getattr(views, attribute)
        if views.shells is not None:
            for attribute, (name, _) in SHELL_SPECS.items():
                yield name, getattr(views.shells, attribute)
        yield KEYPOINTS, keypoint_columns


def _no_rows(header: StoreHeader) -> Views:
    none = Views.empty(header.width)
    if not header.shell_edges_m:
        return none
    nothing = np.zeros((0, *header.row_shape("shells")), dtype=np.float32)
    return replace(none, shells=Shells(np.array(header.shell_edges_m), nothing, nothing))


def create_store(
    path: str | os.PathLike[str], header: StoreHeader, *, overwrite: bool = False
) -> StoreWriter:
    """Create an empty store and open it for writing.

    The file appears under its name whole or not at all.

    Parameters
    ----------
    path : path-like
        Its folder must exist.
    header : StoreHeader
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
    if not path.parent.is_dir():
        raise MissingFileError(
            f"store {path} cannot be created: folder {path.parent} does not exist; make it first"
        )
    with ExitStack() as resources:
        resources.enter_context(writer_lock(path))
        if path.is_dir() or (path.exists() and not overwrite):
            raise StoreError(
                f"store {path} cannot be created: it exists already; resume it by opening it for "
                "append, remove it, or choose another name"
            )
        with complete_or_absent(path) as partial:
            _write_empty(partial, header)
        file = resources.enter_context(_open_to_write(path))
        return StoreWriter(path, header, file, resources.pop_all())


def open_for_append(path: str | os.PathLike[str], header: StoreHeader) -> StoreWriter:
    """Open a store to add rows after its committed ones.

    Parameters
    ----------
    path : path-like
    header : StoreHeader
        What the new rows are built from and how. The frame, DEM digest, config, width and number
        of keypoints must equal the store's; the other fields of the store are kept.

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
            _refuse_mismatch(path, stored, header)
            if store.in_use:  # by nobody, since the lock was free
                _log.warning("store %s: its writer was killed; keeping %d rows", path, len(store))
                _rewrite(path, store)
        file = resources.enter_context(_open_to_write(path))
        return StoreWriter(path, stored, file, resources.pop_all())


def _refuse_mismatch(path: Path, stored: StoreHeader, wanted: StoreHeader) -> None:
    """Raise `StoreMismatchError` where rows of ``wanted`` do not belong into the store."""
    differences: list[tuple[str, object, object]] = []
    if stored.frame_wkt != wanted.frame_wkt:
        names = _frame_name(stored.frame_wkt), _frame_name(wanted.frame_wkt)
        pair = names if names[0] != names[1] else (stored.frame_wkt, wanted.frame_wkt)
        differences.append(("frame", *pair))
    for name in ("dem_digest", "width", "max_keypoints", "shell_edges_m"):
        differences.append((name, getattr(stored, name), getattr(wanted, name)))
    for key in sorted({*stored.config, *wanted.config}):
        there, here = stored.config.get(key, "absent"), wanted.config.get(key, "absent")
        differences.append((f"config {key}", there, here))
    said = [
        f"{name} is {was!r} there, {now!r} here" for name, was, now in differences if was != now
    ]
    if said:
        raise StoreMismatchError(
            f"store {path} was built otherwise: {'; '.join(said)}; "
            "repeat its settings or write to another file"
        )


def _frame_name(wkt: str) -> str:
    try:
        return Frame(wkt).name
    except RuntimeError:  # pyproj's CRSError: the text may come from anywhere
        return wkt


def _rewrite(path: Path, store: Store) -> None:
    """Replace the file by one that holds the committed rows of ``store`` alone."""
    with complete_or_absent(path) as partial:
        _write_empty(partial, store.header)
        shutil.copymode(path, partial)
        with (
            _open_to_write(partial) as file,
            StoreWriter(partial, store.header, file, ExitStack()) as writer,
        ):
            for start in range(0, len(store), 1024):
                rows = slice(start, start + 1024)
                writer.append(store.views(rows), store.keypoint_columns(rows))


def _write_empty(path: Path, header: StoreHeader) -> None:
    # HDF5 makes the file in memory, since it crashes the process at exit if it cannot write it.
    image = io.BytesIO()
    with h5py.File(image, "w", libver=_LIBVER) as file:
        _lay_out(file, header)
    with path.open("xb") as target:
        target.write(image.getbuffer())
        target.flush()
        os.fsync(target.fileno())


def _lay_out(file: h5py.File, header: StoreHeader) -> None:
    file.attrs["schema"] = SCHEMA
    file.attrs["schema_version"] = SCHEMA_VERSION
    file.attrs["frame"] = header.frame_wkt
    file.attrs["dem_digest"] = header.dem_digest
    file.attrs["dem_files"] = json.dumps(header.dem_files)
    file.attrs["config"] = json.dumps(header.config, sort_keys=True)
    file.attrs["renderer"] = header.renderer
    file.attrs["package_version"] = header.package_version
    if header.shell_edges_m:
        file.attrs["shell_edges_m"] = np.array(header.shell_edges_m)
    for name, spec in header.specs.items():
        shape = header.row_shape(spec.per_row)
        rows, packing = (_WIDE_CHUNK_ROWS, _COMPRESSION) if shape else (_SCALAR_CHUNK_ROWS, {})
        file.create_dataset(
            name,
            shape=(0, *shape),
            maxshape=(None, *shape),
            chunks=(rows, *shape),
            dtype=spec.dtype,
            **packing,
        )
    # A dataset, since SWMR writes no attributes.
    file.create_dataset("committed", data=np.uint64(0))


def _open_to_write(path: Path) -> h5py.File:
    """Open in SWMR mode from the first byte.

    To open for writing and then switch, as h5py does, leaves an instant at which a kill marks
    the file as no reader's at all. The lock is ours, since HDF5 takes none in this mode.
    """
    access = h5py.h5p.create(h5py.h5p.FILE_ACCESS)
    access.set_libver_bounds(h5py.h5f.LIBVER_V110, h5py.h5f.LIBVER_V110)
    access.set_file_locking(False, True)
    flags = h5py.h5f.ACC_RDWR | h5py.h5f.ACC_SWMR_WRITE
    with explained(path, "it cannot be opened for writing", "check that you may write it"):
        return h5py.File(h5py.h5f.open(os.fsencode(path), flags, access))

"""The HDF5 reference store: skylines and keypoints of many views, one row each (DESIGN 8).

One process writes, any number read at the same time. The writer uses HDF5's single-writer,
multiple-reader mode (SWMR), which orders its writes so that the file is whole at every instant:
a writer killed between any two writes leaves every committed row readable. Without that mode,
one kill in three between two writes damaged the file.

SWMR does not lock, so the writer holds ``STORE.lock`` beside the store. A killed writer leaves
its mark in the file (see `skyline.superblock`); the next `open_for_append` then copies the
committed rows to a fresh file, which takes the store's name once it is complete.
"""

import fcntl
import io
import json
import logging
import os
import re
import shutil
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.camera import HEADINGS, check_width
from skyline.errors import (
    InputError,
    MissingFileError,
    SkylineError,
    StoreError,
    StoreMismatchError,
)
from skyline.features import DEFAULT_MAX_KEYPOINTS, NO_KEYPOINT
from skyline.geodesy import Frame
from skyline.superblock import WholeFile
from skyline.views import Views

SCHEMA = "skyline-store"
SCHEMA_VERSION = 1

KeypointColumns = NDArray[np.uint16]
RowIndex = int | slice | NDArray[np.integer] | NDArray[np.bool_]

_T = TypeVar("_T")

_log = logging.getLogger(__name__)

_LIBVER = ("v110", "v110")
"""SWMR needs the file format of HDF5 1.10; pinned, so that every release since reads it."""

_WIDE_CHUNK_ROWS = 32
"""Rows a chunk of the (N, W) datasets: 80 kB at W = 640. Half costs 3 % more bytes, twice saves
2 %, and a single row is read by unpacking one chunk."""

_SCALAR_CHUNK_ROWS = 1024
_MAX_CHUNK_BYTES = 1 << 26

_COMPRESSION = {"shuffle": True, "compression": "gzip", "compression_opts": 1}
"""Davos at W = 640: 2.7 kB a row instead of 6.0; level 4 saves 2 % more and reads half as fast.
Packing takes 0.1 ms a row and unpacking 0.03 ms, less than rendering the row."""

_KNOWN_FILTERS = frozenset({h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE})

_READ_AGAIN = 5
_READ_AGAIN_PAUSE_S = 0.02

_RESUME = "committed rows are safe: make room, then resume it"
_REBUILD = "copy or build it again"

_UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""What h5py raises on files that are damaged or made by someone else."""


@dataclass(frozen=True, slots=True)
class _Spec:
    """A row-aligned dataset: its type, and whether a row is W or K values instead of one."""

    dtype: str
    per_row: str = "one"


_VIEW_SPECS = {
    "easting_m": ("views/easting", _Spec("<f8")),
    "northing_m": ("views/northing", _Spec("<f8")),
    "eye_elevation_m": ("views/eye_elevation_m", _Spec("<f8")),
    "heading": ("views/heading", _Spec("u1")),
    "elevation_tan": ("views/elevation_tan", _Spec("<f4", "width")),
    "depth_m": ("views/depth_m", _Spec("<f4", "width")),
    "flags": ("views/flags", _Spec("u1", "width")),
}
"""Field of `Views` -> dataset and its layout."""

_KEYPOINTS = "features/keypoint_column"

_SPECS = dict(_VIEW_SPECS.values()) | {_KEYPOINTS: _Spec("<u2", "keypoints")}


def _package_version() -> str:
    try:
        return metadata.version("skyline")
    except metadata.PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True, slots=True)
class StoreHeader:
    """What a store was built from and how; fixed when it is created.

    Attributes
    ----------
    frame_wkt : str
        Frame of the locations.
    dem_digest : str
        `HeightField.digest` of the terrain.
    dem_files : tuple of str
        Absolute paths where the DEM lay.
    config : mapping
        Settings of the build; anything JSON holds, keys are strings.
    renderer : str
        What rendered the views.
    width : int
        Columns W of a view.
    max_keypoints : int
        Keypoints K a row has room for.
    package_version : str
        Release that created the store.

    Raises
    ------
    InputError
        The width or the number of keypoints is out of range, or JSON cannot hold the config.
    """

    frame_wkt: str
    dem_digest: str
    dem_files: tuple[str, ...]
    config: Mapping[str, object]
    renderer: str
    width: int
    max_keypoints: int = DEFAULT_MAX_KEYPOINTS
    package_version: str = field(default_factory=_package_version, compare=False)

    def __post_init__(self) -> None:
        check_width(self.width)
        if not 2 <= self.max_keypoints < NO_KEYPOINT:
            raise InputError(
                f"max_keypoints is {self.max_keypoints}; expected 2 to {NO_KEYPOINT - 1} "
                f"(the default is {DEFAULT_MAX_KEYPOINTS})"
            )
        try:
            plain = json.loads(json.dumps(dict(self.config), allow_nan=False))
        except (TypeError, ValueError) as error:
            raise InputError(
                f"the store's config cannot be written as JSON ({error}); "
                "use numbers, strings, lists and mappings"
            ) from error
        # As it will be read back, so that a stored and a requested config compare equal.
        object.__setattr__(self, "config", plain)

    def row_shape(self, per_row: str) -> tuple[int, ...]:
        """Return the shape of one row of a dataset: (), (W,) or (K,)."""
        return {"one": (), "width": (self.width,), "keypoints": (self.max_keypoints,)}[per_row]


@dataclass(frozen=True, slots=True, eq=False)
class Locations:
    """Where the eyes of N views are and which way they look.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (N,) float64
        In the store's frame, above the DEM's datum.
    heading : (N,) uint8
    """

    easting_m: NDArray[np.float64]
    northing_m: NDArray[np.float64]
    eye_elevation_m: NDArray[np.float64]
    heading: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.heading)


class Store:
    """The committed rows of a store; use it as a context manager. Made by `open_store`.

    Rows committed after it was opened are not seen: the rows of one `Store` never change.
    """

    def __init__(self, path: Path, raw: WholeFile) -> None:
        """Check and open the store in an open file, which the store closes."""
        self._path = path
        self._raw = raw
        with _explained(path, "it cannot be opened"), ExitStack() as resources:
            self._file = resources.enter_context(h5py.File(raw, "r"))
            self._header = _read_header(path, self._file)
            # Counted before the datasets are opened: a writer at work may lengthen them.
            self._committed = _read_committed(path, self._file)
            self._datasets = self._open_datasets()
            self._check_committed()
            resources.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        return self._committed

    @property
    def path(self) -> Path:
        """Where the store is."""
        return self._path

    @property
    def header(self) -> StoreHeader:
        """What the store was built from and how."""
        return self._header

    @property
    def committed(self) -> int:
        """Number of complete rows when the store was opened."""
        return self._committed

    @property
    def in_use(self) -> bool:
        """Whether a writer had the store open when it was opened, or was killed at work."""
        return self._raw.superblock.in_use

    def close(self) -> None:
        """Let go of the file; closing twice is fine."""
        self._file.close()
        self._raw.close()

    def views(self, index: RowIndex = slice(None)) -> Views:
        """Read views.

        Parameters
        ----------
        index : int, slice, integer or boolean array
            Rows in the order wanted, as NumPy indexes; an int gives one view.

        Raises
        ------
        InputError
            A row that is not committed.
        StoreError
            Damaged data.
        """
        rows = self._rows(index)
        views = Views(*(self._read(name, rows) for name, _ in _VIEW_SPECS.values()))
        self._check_headings(views.heading)
        return views

    def iter_views(self, chunk_rows: int = 1024) -> Iterator[Views]:
        """Yield all views in order, ``chunk_rows`` at a time (the last time fewer)."""
        if chunk_rows < 1:
            raise InputError(f"chunk_rows is {chunk_rows}; expected at least 1")
        for start in range(0, self._committed, chunk_rows):
            yield self.views(slice(start, start + chunk_rows))

    def keypoint_columns(self, index: RowIndex = slice(None)) -> KeypointColumns:
        """Read keypoints, (N, K) uint16, padded with `NO_KEYPOINT`; as `views` otherwise."""
        columns = self._read(_KEYPOINTS, self._rows(index))
        if ((columns >= self._header.width) & (columns != NO_KEYPOINT)).any():
            raise self._damaged(f"{_KEYPOINTS} names columns beyond {self._header.width - 1}")
        return columns

    def locations(self) -> Locations:
        """Read where all views are, without their skylines."""
        rows = self._rows(slice(None))
        names = ("easting_m", "northing_m", "eye_elevation_m", "heading")
        locations = Locations(*(self._read(_VIEW_SPECS[name][0], rows) for name in names))
        self._check_headings(locations.heading)
        return locations

    def _rows(self, index: RowIndex) -> NDArray[np.intp]:
        try:
            return np.atleast_1d(np.arange(self._committed)[index])
        except IndexError as error:
            raise InputError(
                f"{error}: store {self._path} has {self._committed} committed rows"
            ) from error

    def _read(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        if self._raw.closed:
            raise StoreError(f"store {self._path} is closed; open it again to read it")
        try:
            return self._read_once(name, rows)
        except StoreError:
            if not self._raw.refresh():
                raise
        return _patiently(self._raw, lambda: self._read_anew(name, rows))

    def _read_anew(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        with _explained(self._path, "it cannot be opened again"):
            self._file.close()
            self._file = h5py.File(self._raw, "r")
            self._datasets = self._open_datasets()
        return self._read_once(name, rows)

    def _read_once(self, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        with _explained(self._path, f"{name} cannot be read"):
            dataset = self._datasets[name]
            if len(rows) == 0:
                return np.zeros((0, *dataset.shape[1:]), dataset.dtype)
            if (np.diff(rows) == 1).all():
                return np.asarray(dataset[rows[0] : rows[-1] + 1])
            # HDF5 wants rows ascending and once each.
            ascending, position = np.unique(rows, return_inverse=True)
            return np.asarray(dataset[ascending])[position]

    def _open_datasets(self) -> dict[str, h5py.Dataset]:
        return {
            name: _checked_dataset(self._path, self._file, name, spec, self._header)
            for name, spec in _SPECS.items()
        }

    def _check_committed(self) -> None:
        # Values of one number a row are not packed, so what the file has no bytes for is missing.
        rows = min(
            len(dataset)
            if dataset.ndim > 1
            else min(len(dataset), dataset.id.get_storage_size() // dataset.dtype.itemsize)
            for dataset in self._datasets.values()
        )
        if self._committed > rows:
            raise self._damaged(f"it says {self._committed} rows are committed and holds {rows}")

    def _check_headings(self, heading: NDArray[np.uint8]) -> None:
        if (heading > HEADINGS[-1]).any():
            raise self._damaged(f"it has heading {heading.max()}, beyond {HEADINGS[-1]}")

    def _damaged(self, what: str) -> StoreError:
        return StoreError(f"store {self._path} is damaged: {what}; {_REBUILD}")


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
        self._datasets = {name: self._file[name] for name in _SPECS}
        self._marker = self._file["committed"]
        self._committed = int(self._marker[()])
        self._chunk_rows = int(self._datasets[_KEYPOINTS].chunks[0])
        self._pending = Views.empty(header.width)
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
        with _explained(self._path, "it cannot be completed", _RESUME), self._resources:
            if not self._failed:
                self.flush()

    def _check_usable(self) -> None:
        if not self._file or self._failed:
            state = "had a failed write" if self._failed else "is closed"
            raise StoreError(f"the writer of {self._path} {state}; open the store for append again")

    def _check_rows(self, views: Views, keypoint_columns: KeypointColumns) -> None:
        for name, values in self._columns(views, keypoint_columns):
            expected = (len(views), *self._header.row_shape(_SPECS[name].per_row))
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
            with _explained(self._path, "rows cannot be written", _RESUME):
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
        for attribute, (name, _) in _VIEW_SPECS.items():
            yield name, getattr(views, attribute)
        yield _KEYPOINTS, keypoint_columns


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
        resources.enter_context(_writer_lock(path))
        if path.is_dir() or (path.exists() and not overwrite):
            raise StoreError(
                f"store {path} cannot be created: it exists already; resume it by opening it for "
                "append, remove it, or choose another name"
            )
        with _complete_or_absent(path) as partial:
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
        resources.enter_context(_writer_lock(path))
        with open_store(path) as store:
            stored = store.header
            _refuse_mismatch(path, stored, header)
            if store.in_use:  # by nobody, since the lock was free
                _log.warning("store %s: its writer was killed; keeping %d rows", path, len(store))
                _rewrite(path, store)
        file = resources.enter_context(_open_to_write(path))
        return StoreWriter(path, stored, file, resources.pop_all())


def open_store(path: str | os.PathLike[str]) -> Store:
    """Open a store to read its committed rows, also while another process appends to it.

    Raises
    ------
    MissingFileError
        No such file.
    StoreError
        Not a store, truncated or damaged, of a newer schema, or not readable.
    """
    path = Path(path).resolve()
    with ExitStack() as resources:
        raw = resources.enter_context(WholeFile(path))
        store = _patiently(raw, lambda: Store(path, raw))
        resources.pop_all()
    return store


def is_store(path: str | os.PathLike[str]) -> bool:
    """Whether a file is an HDF5 file with a store's schema, however damaged the rest."""
    path = Path(path)
    try:
        with WholeFile(path) as raw, h5py.File(raw, "r") as file:
            return "schema" in file.attrs
    except (SkylineError, *_UNREADABLE):
        return path.is_file() and path.suffix == ".h5"


def _patiently(raw: WholeFile, read: Callable[[], _T]) -> _T:
    """Return ``read()``, tried again where a writer at work may have changed what it read."""
    for _ in range(_READ_AGAIN):
        try:
            return read()
        except StoreError:
            if not raw.refresh():
                raise
            time.sleep(_READ_AGAIN_PAUSE_S)
    return read()


def _refuse_mismatch(path: Path, stored: StoreHeader, wanted: StoreHeader) -> None:
    """Raise `StoreMismatchError` where rows of ``wanted`` do not belong into the store."""
    differences: list[tuple[str, object, object]] = []
    if stored.frame_wkt != wanted.frame_wkt:
        names = _frame_name(stored.frame_wkt), _frame_name(wanted.frame_wkt)
        pair = names if names[0] != names[1] else (stored.frame_wkt, wanted.frame_wkt)
        differences.append(("frame", *pair))
    for name in ("dem_digest", "width", "max_keypoints"):
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
    with _complete_or_absent(path) as partial:
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
    for name, spec in _SPECS.items():
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
    with _explained(path, "it cannot be opened for writing", "check that you may write it"):
        return h5py.File(h5py.h5f.open(os.fsencode(path), flags, access))


def _not_a_store(path: Path) -> StoreError:
    return StoreError(
        f"{path} is an HDF5 file but not a skyline store; "
        "name one made by `skyline build` or `skyline render`"
    )


def _read_header(path: Path, file: h5py.File) -> StoreHeader:
    if "schema" not in file.attrs or _text(path, file, "schema") != SCHEMA:
        raise _not_a_store(path)
    _check_schema_version(path, file)
    config = json.loads(_text(path, file, "config"))
    files = json.loads(_text(path, file, "dem_files"))
    if not isinstance(config, dict):
        raise StoreError(f"store {path} has a config that is not a JSON object; {_REBUILD}")
    if not isinstance(files, list) or not all(isinstance(name, str) for name in files):
        raise StoreError(f"store {path} has dem_files that are not a JSON list; {_REBUILD}")
    try:
        return StoreHeader(
            frame_wkt=_text(path, file, "frame"),
            dem_digest=_text(path, file, "dem_digest"),
            dem_files=tuple(files),
            config=config,
            renderer=_text(path, file, "renderer"),
            width=_row_length(path, file, _VIEW_SPECS["elevation_tan"][0]),
            max_keypoints=_row_length(path, file, _KEYPOINTS),
            package_version=_text(path, file, "package_version"),
        )
    except InputError as error:
        raise StoreError(f"store {path} is damaged: {error}; {_REBUILD}") from error


def _check_schema_version(path: Path, file: h5py.File) -> None:
    version = _attribute(path, file, "schema_version")
    if not isinstance(version, np.integer) or version < 1:
        raise StoreError(
            f"store {path} has schema version {version!r}; expected {SCHEMA_VERSION}; {_REBUILD}"
        )
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"store {path} has schema version {version}; this skyline ({_package_version()}) reads "
            f"up to {SCHEMA_VERSION}: upgrade skyline"
        )


def _read_committed(path: Path, file: h5py.File) -> int:
    node = _hard_linked(path, file, "committed")
    if (
        not isinstance(node, h5py.Dataset)
        or node.shape != ()
        or node.dtype.kind != "u"
        or node.external
        or node.is_virtual
    ):
        raise StoreError(f"store {path}: `committed` is not one unsigned number; {_REBUILD}")
    return int(node[()])


def _attribute(path: Path, file: h5py.File, name: str) -> object:
    """Return a single-valued attribute."""
    if name not in file.attrs or file.attrs.get_id(name).shape != ():
        raise StoreError(f"store {path} has no single attribute {name!r}; {_REBUILD}")
    value: object = file.attrs[name]
    return value


def _text(path: Path, file: h5py.File, name: str) -> str:
    value = _attribute(path, file, name)
    if not isinstance(value, str):
        raise StoreError(f"store {path} has an attribute {name!r} that is not text; {_REBUILD}")
    return value


def _row_length(path: Path, file: h5py.File, name: str) -> int:
    dataset = _hard_linked(path, file, name)
    if not isinstance(dataset, h5py.Dataset) or dataset.ndim != 2:
        raise StoreError(f"store {path}: {name} is not a table of rows; {_REBUILD}")
    return int(dataset.shape[1])


def _hard_linked(path: Path, file: h5py.File, name: str) -> Any:
    """Return an object that lies in this very file, following no other kind of link."""
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            raise StoreError(f"store {path} lacks {name}; {_REBUILD}")
        if not isinstance(link, h5py.HardLink):
            raise StoreError(
                f"store {path}: {name} is a link to elsewhere, which is not followed; {_REBUILD}"
            )
        node = node[part]
    return node


def _checked_dataset(
    path: Path, file: h5py.File, name: str, spec: _Spec, header: StoreHeader
) -> h5py.Dataset:
    """Return a dataset if it has the schema's layout and its bytes lie in this file."""
    dataset = _hard_linked(path, file, name)
    row_shape = header.row_shape(spec.per_row)
    if not isinstance(dataset, h5py.Dataset) or dataset.shape[1:] != row_shape or not dataset.shape:
        raise StoreError(f"store {path}: {name} is not rows of shape {row_shape}; {_REBUILD}")
    if dataset.dtype != np.dtype(spec.dtype):
        raise StoreError(
            f"store {path}: {name} is of type {dataset.dtype}, not {spec.dtype}; {_REBUILD}"
        )
    # Rules out virtual, external, contiguous and compact storage: none of them is chunked.
    if dataset.chunks is None:
        raise StoreError(f"store {path}: {name} is not chunked in this file; {_REBUILD}")
    if np.prod(dataset.chunks, dtype=float) * dataset.dtype.itemsize > _MAX_CHUNK_BYTES:
        raise StoreError(
            f"store {path}: {name} has chunks of {dataset.chunks}, too large; {_REBUILD}"
        )
    created = dataset.id.get_create_plist()
    filters = {created.get_filter(n)[0] for n in range(created.get_nfilters())}
    if filters - (_KNOWN_FILTERS if row_shape else frozenset()):
        raise StoreError(
            f"store {path}: {name} is packed by a filter that skyline does not use; {_REBUILD}"
        )
    return dataset


@contextmanager
def _explained(path: Path, what: str, advice: str = _REBUILD) -> Iterator[None]:
    """Turn what h5py raises into one line about the store."""
    try:
        yield
    except SkylineError:
        raise
    except _UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        cause = re.search(r"error message = '([^']+)'", reason)
        reason = cause[1] if cause else reason
        raise StoreError(f"store {path}: {what} ({reason}); {advice}") from error


@contextmanager
def _complete_or_absent(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path``; the file made there takes its place, unless that fails."""
    partial = path.with_name(f"{path.name}.partial")
    try:
        with _explained(path, "it cannot be created", "check the folder's rights and space"):
            partial.unlink(missing_ok=True)
            yield partial
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def _writer_lock(path: Path) -> Iterator[None]:
    """Hold ``path``.lock; raise `StoreError` where another writer does.

    The kernel lets go of the lock when its holder dies, so a file left behind bars nobody.
    """
    lock = path.with_name(f"{path.name}.lock")
    what, advice = "it cannot be locked for writing", "check the folder's rights and space"
    with _explained(path, what, advice):
        descriptor = _lock_file(path, lock)
    try:
        with _explained(path, what, advice):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def _lock_file(path: Path, lock: Path) -> int:
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # A holder that just ended may have removed the file after it was opened here.
            if lock.exists() and os.path.samestat(os.fstat(descriptor), lock.stat()):
                return descriptor
        except BlockingIOError as error:
            holder = os.read(descriptor, 200).decode(errors="replace") or "another process"
            os.close(descriptor)
            raise StoreError(
                f"store {path} is being written by {holder}; wait for it to end, or stop it"
            ) from error
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)

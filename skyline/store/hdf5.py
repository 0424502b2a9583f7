"""The HDF5 file of a store: written in one go, and checked when it is opened.

A store is written once, from all of its rows, under a temporary name. It takes its own name when
its bytes are on disk, and nothing is ever appended to it. So readers need no locks, and two
processes that write the same store at once do no harm: either's file is the same.

A file is a store if its header has the digest that was written with it, and if its datasets have
the layout that follows from the header, with their bytes in this very file.
"""

import io
import json
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.errors import MissingFileError, SkylineError, StoreError
from skyline.store.format import (
    PACKAGE_VERSION,
    PLACE_CODING,
    PLACES,
    SCHEMA,
    SCHEMA_VERSION,
    Columns,
    StoreHeader,
    attributes_digest,
    row_checksums,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

REBUILD = "copy or build it again"

UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""The exceptions of h5py on files that are damaged or made by another program."""

_FILTERS = {"fletcher32", "shuffle", "compression"}
"""Settings of a layout that are HDF5 filters."""

_LIBVER = ("v110", "v110")
"""Pinned, so that every release of HDF5 since 1.10 reads the file, and its bytes stay the same."""

_ALIGNED = {"alignment_threshold": 1024, "alignment_interval": 64}
"""Chunks of places begin at whole cache lines, for half a byte a place."""

_ROWS_AT_ONCE = 1024
"""Rows written at once, whole chunks: a packed chunk that is written twice leaves dead bytes."""


def write_store(
    path: str | os.PathLike[str],
    header: StoreHeader,
    columns: Columns,
    order: NDArray[np.intp] | None = None,
) -> int:
    """Write a store of some rows, and return their number.

    The same rows, order and header give the same bytes. Columns are as
    `skyline.store.format.columns_of` returns them; ``order`` (N,) has the rows to write, by default
    all. A store that already exists is replaced. Raises `MissingFileError` where there is no
    folder, and `StoreError` where the file cannot be written.
    """
    path = Path(path).resolve()
    check_folder(path)
    partial = path.with_name(f".{path.name}.{uuid4().hex[:12]}.partial")
    if order is None:
        order = np.arange(len(columns[header.sorted_by[0]]))
    with explained(path, "it cannot be written", "check the folder's rights and space"):
        try:
            with _Target(partial, "x+b") as target:
                aligned = _ALIGNED if header.holds == PLACES else {}
                with h5py.File(target, "w", libver=_LIBVER, **aligned) as file:
                    _write_header(file, header)
                    for name, row in header.specs.items():
                        # HDF5 has no chunks larger than a dataset may become.
                        most = None if len(order) else (None, *row.shape)
                        layout = header.layout(name, len(order))
                        file.create_dataset(name, maxshape=most, **layout)
                    for first in range(0, len(order), _ROWS_AT_ONCE):
                        some = order[first : first + _ROWS_AT_ONCE]
                        block = {name: columns[name][some] for name in columns}
                        block[header.checksum] = row_checksums(block)
                        for name, values in block.items():
                            file[name][first : first + len(some)] = values
                target.finish()
            partial.replace(path)
        finally:
            partial.unlink(missing_ok=True)
    return len(order)


def check_folder(path: Path) -> None:
    """Raise `MissingFileError` unless there is a folder for a file."""
    if not path.parent.is_dir():
        raise MissingFileError(
            f"store {path} cannot be created: folder {path.parent} does not exist; make it first"
        )


@contextmanager
def explained(path: Path, problem: str, advice: str = REBUILD) -> Iterator[None]:
    """Turn an exception of h5py into a `StoreError` of one line."""
    try:
        yield
    except SkylineError:
        raise
    except UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        cause = re.search(r"error message = '([^']+)'", reason)
        reason = cause[1] if cause else reason
        raise StoreError(f"store {path}: {problem} ({reason}); {advice}") from error


def _write_header(file: h5py.File, header: StoreHeader) -> None:
    texts = {
        "schema": SCHEMA,
        **header.attributes,
        "header_digest": attributes_digest(header.attributes),
    }
    file.attrs["schema_version"] = SCHEMA_VERSION
    for name, text in texts.items():
        # HDF5 protects only texts of a fixed length with a checksum.
        data = text.encode() or b" "
        file.attrs.create(name, np.bytes_(data), dtype=h5py.string_dtype("utf-8", len(data)))


class _Target(io.FileIO):
    """The file that HDF5 writes to.

    After a failed write, HDF5 writes again when it closes the file, and if that fails too it ends
    the process. So failures are hidden from HDF5, and `finish` raises the first.
    """

    _error: OSError | None = None

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write all of the data, or keep the error."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and self._error is None:
                left = left[super().write(left) :]
        except OSError as error:
            self._error = error
        return size

    def truncate(self, size: int | None = None, /) -> int:
        """Set the size of the file, or keep the error."""
        try:
            return super().truncate(size)
        except OSError as error:
            self._error = self._error or error
            return size or 0

    def finish(self) -> None:
        """Flush the bytes to the disk; raises the `OSError` of the first write that failed."""
        if self._error is not None:
            raise self._error
        os.fsync(self.fileno())


# --- checks ---------------------------------------------------------------------------------


def read_header(path: Path, file: h5py.File) -> StoreHeader:
    """Return the header of a store; raises `StoreError` where it is damaged or foreign."""
    foreign = StoreError(
        f"{path} is an HDF5 file but not a skyline store; "
        "name one made by `skyline build` or `skyline render`"
    )
    if file.userblock_size or not {"schema", "schema_version"} <= set(file.attrs):
        raise foreign
    version = _attribute(path, file, "schema_version")
    if version != SCHEMA_VERSION:
        is_newer = isinstance(version, np.integer) and version > SCHEMA_VERSION
        advice = "upgrade skyline" if is_newer else "build the store again"
        raise StoreError(
            f"store {path} has schema version {version}; this skyline ({PACKAGE_VERSION}) reads "
            f"version {SCHEMA_VERSION}: {advice}"
        )
    texts = {name: _text(path, file, name) for name in file.attrs if name != "schema_version"}
    if texts.pop("schema") != SCHEMA:
        raise foreign
    if texts.pop("header_digest", None) != attributes_digest(texts):
        raise StoreError(
            f"store {path} is damaged: its header (frame, DEM, config, renderer, rows) does not "
            f"have the digest that was written with it; {REBUILD}"
        )
    rows = json.loads(texts["rows"])
    if rows["rows"] == PLACES and rows != {"rows": PLACES, **PLACE_CODING}:
        raise StoreError(
            f"store {path} has places that another release of skyline built, whose bytes mean "
            "something else; build it again"
        )
    return StoreHeader(
        frame_wkt=texts["frame"],
        dem_digest=texts["dem_digest"],
        dem_files=tuple(json.loads(texts["dem_files"])),
        config=json.loads(texts["config"]),
        renderer=texts["renderer"],
        width=rows.get("width", 0),
        holds=rows["rows"],
        package_version=texts["package_version"],
    )


def _attribute(path: Path, file: h5py.File, name: str) -> object:
    """Return an attribute of one value; one of a variable length is not read.

    HDF5 keeps values of variable lengths in a heap without a checksum, and may loop in a damaged
    one.
    """
    if file.attrs.get_id(name).shape != ():
        raise StoreError(f"store {path} has no single attribute {name!r}; {REBUILD}")
    kind = file.attrs.get_id(name).get_type()
    plain = isinstance(kind, h5py.h5t.TypeIntegerID) or (
        isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
    )
    value: object = file.attrs[name] if plain else None
    return value


def _text(path: Path, file: h5py.File, name: str) -> str:
    value = _attribute(path, file, name)
    if not isinstance(value, bytes):
        raise StoreError(f"store {path} has an attribute {name!r} that is not text; {REBUILD}")
    return value.decode().removesuffix(" " if value == b" " else "")


def _hard_linked(path: Path, file: h5py.File, name: str) -> Any:
    """Return an object that lies in this very file, following no other kind of link."""
    node = file
    for part in name.split("/"):
        link = node.get(part, getlink=True) if isinstance(node, h5py.Group) else None
        if link is None:
            raise StoreError(f"store {path} lacks {name}; {REBUILD}")
        if not isinstance(link, h5py.HardLink):
            raise StoreError(
                f"store {path}: {name} is a link to another place, which is not followed; {REBUILD}"
            )
        node = node[part]
    return node


def checked_dataset(path: Path, file: h5py.File, name: str, header: StoreHeader) -> h5py.Dataset:
    """Return a dataset if it has the schema's layout and its bytes lie in this file.

    Virtual, external, contiguous and compact storage have no chunks, so they are refused.
    """
    dataset = _hard_linked(path, file, name)
    if not isinstance(dataset, h5py.Dataset) or not dataset.shape:
        raise StoreError(f"store {path}: {name} is not a dataset of rows; {REBUILD}")
    layout = header.layout(name, len(dataset))
    for setting, wanted in layout.items():
        found = getattr(dataset, setting)
        if found != wanted:
            raise StoreError(
                f"store {path}: {name} has {setting} {found}; expected {wanted}; {REBUILD}"
            )
    if dataset.id.get_create_plist().get_nfilters() != len(layout.keys() & _FILTERS):
        raise StoreError(
            f"store {path}: {name} is packed by a filter that skyline does not use; {REBUILD}"
        )
    return dataset

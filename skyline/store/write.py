"""Writing a store: the file appears under its name only when it is finished.

A store is written once, from all of its rows, under a temporary name. It takes its own name when
its bytes are on disk, and nothing is ever appended to it. So readers need no locks, and two
processes that write the same store at once do no harm: either's file is the same.
"""

import io
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import h5py
import numpy as np
from numpy.typing import NDArray

from skyline.errors import MissingFileError, SkylineError, StoreError
from skyline.store.format import (
    PLACES,
    SCHEMA,
    SCHEMA_VERSION,
    Columns,
    StoreHeader,
    row_checksums,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

REBUILD = "copy or build it again"

UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""The exceptions of h5py on files that are damaged or made by another program."""

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
) -> None:
    """Write a store of some rows; the same rows, order and header give the same bytes.

    Parameters
    ----------
    path : path-like
        A store that already exists is replaced.
    columns : mapping
        The rows, as `skyline.store.format.columns_of` returns them.
    order : (N,) intp, optional
        The rows to write, in this order; by default all.

    Raises
    ------
    MissingFileError
        The folder does not exist.
    StoreError
        The file cannot be written.
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
    texts = {"schema": SCHEMA, **header.attributes, "header_digest": header.digest}
    file.attrs["schema_version"] = SCHEMA_VERSION
    for name, text in texts.items():
        # HDF5 guards texts of a fixed length alone with a checksum.
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

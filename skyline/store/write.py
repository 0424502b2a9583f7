"""Writing a store from rows.

A store is written once, from all of its rows, under a temporary name. It takes its own name when
its bytes are on disk, and nothing is ever appended to it. So readers need no locks, and two
processes that write the same store at once do no harm: both write the same file.
"""

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING

import h5py
import numpy as np

from skyline.arrays import IntArray
from skyline.errors import InputError, MissingFileError, check_suffix
from skyline.files.disk import STANDARD, STORE_SUFFIXES, appearing
from skyline.store.layout import (
    PLACES,
    ROWS_AT_ONCE,
    Columns,
    StoreHeader,
    explained,
    row_checksums,
    write_header,
)

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_LIBVER = ("v110", "v110")
"""Pinned, so that every release of HDF5 since 1.10 reads the file, and its bytes stay the same."""

_ALIGNED = {"alignment_threshold": 1024, "alignment_interval": 64}
"""Chunks of places begin at whole cache lines; this costs half a byte a place."""


def write_store(
    path: str | os.PathLike[str],
    header: StoreHeader,
    columns: Columns,
    order: IntArray | None = None,
) -> int:
    """Write a store of some rows, and return their number.

    The same rows, order and header give the same bytes. Columns are as
    `skyline.store.layout.columns_of` returns them; ``order`` (N,) has the rows to write, by default
    all. An existing store is replaced. Raises `MissingFileError` if there is no folder for the
    file, and `StoreError` if it cannot be written.
    """
    path = Path(path).resolve()
    _check_place(path)
    if order is None:
        order = np.arange(len(columns[header.sorted_by[0]]))
    with (
        explained(path, "it cannot be written", "check the folder's rights and space"),
        appearing(path) as partial,
        _Target(partial, "x+b") as target,
    ):
        aligned = _ALIGNED if header.holds == PLACES else {}
        with h5py.File(target, "w", libver=_LIBVER, **aligned) as file:
            write_header(file, header)
            for name, row in header.specs.items():
                # HDF5 has no chunks larger than a dataset may become.
                most = None if len(order) else (None, *row.shape)
                layout = header.layout(name, len(order))
                file.create_dataset(name, maxshape=most, **layout)
            for first in range(0, len(order), ROWS_AT_ONCE):
                some = order[first : first + ROWS_AT_ONCE]
                block = {name: columns[name][some] for name in columns}
                block[header.checksum] = row_checksums(block)
                for name, values in block.items():
                    file[name][first : first + len(some)] = values
        target.finish()
    return len(order)


def check_store_path(path: Path) -> None:
    """Check the path of a store that is to be written.

    So a build is refused before it reads and renders. Raises `InputError` for ``-``, for the suffix
    of another format and for a folder without the right to write, and `MissingFileError` if there
    is no folder for it.
    """
    check_suffix(path, STORE_SUFFIXES)
    _check_place(path)


def _check_place(path: Path) -> None:
    if path.name == STANDARD:
        raise InputError("a store cannot be written to standard output; name a file")
    if not path.parent.is_dir():
        raise MissingFileError(
            f"store {path} cannot be created: folder {path.parent} does not exist; make it first"
        )
    if not os.access(path.parent, os.W_OK | os.X_OK):
        raise InputError(
            f"store {path} cannot be created: there are no rights to write in {path.parent}; name "
            "a file in another folder"
        )


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
        """Flush the bytes to the disk; raises the first write's `OSError`."""
        if self._error is not None:
            raise self._error
        os.fsync(self.fileno())

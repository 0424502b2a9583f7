"""Writing stores, from rows or from other stores, and checking them row by row.

A store is written once, from all of its rows, under a temporary name. It takes its own name when
its bytes are on disk, and nothing is ever appended to it. So readers need no locks, and two
processes that write the same store at once do no harm: either's file is the same.

Rows of a merged store are sorted by easting, northing, eye elevation and heading, and equal ones
are kept once. So its bytes depend on the set of rows alone, and neither on the order of the parts
nor on how they were cut. Stores of several boxes of one DEM may overlap. The lattices on which
places are planned are nested, so the denser plan has all places of the other. Where both plans
have a place, the row of the denser plan is kept: it represents less ground.

A file whose structures were forged together with their checksums may hang or crash HDF5 itself.
`check_store` therefore reads in a process of its own, which may die.
"""

import io
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING
from uuid import uuid4

import h5py
import numpy as np

from skyline.arrays import IntArray
from skyline.errors import InputError, MissingFileError, SkylineError, StoreError, check_suffix
from skyline.files import STANDARD
from skyline.geodesy import Bounds
from skyline.store.header import (
    PLACES,
    Columns,
    StoreHeader,
    explained,
    refuse_mismatch,
    row_checksums,
    write_header,
)
from skyline.store.read import Store, open_hdf5, open_store

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

SUFFIXES = (".h5", ".hdf5")
"""Suffixes that the file of a store may have."""
_LIBVER = ("v110", "v110")
"""Pinned, so that every release of HDF5 since 1.10 reads the file, and its bytes stay the same."""

_ALIGNED = {"alignment_threshold": 1024, "alignment_interval": 64}
"""Chunks of places begin at whole cache lines, for half a byte a place."""

_ROWS_AT_ONCE = 1024
"""Rows read or written at once, whole chunks: a packed chunk that is written twice leaves dead
bytes."""

_LIMIT_S = 60.0
_LIMIT_S_PER_BYTE = 1e-6
"""Processor time that a check may take for each byte. Checking reads at least 30 MB a second on one
core of 2020; time by the clock would depend on how busy the machine is."""

_EXAMINE = """
import dataclasses, json, pathlib, resource, sys, time
from skyline.store.write import examine
seconds = int(time.process_time()) + int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
json.dump(dataclasses.asdict(examine(pathlib.Path(sys.argv[1]))), sys.stdout)
"""


def write_store(
    path: str | os.PathLike[str],
    header: StoreHeader,
    columns: Columns,
    order: IntArray | None = None,
) -> int:
    """Write a store of some rows, and return their number.

    The same rows, order and header give the same bytes. Columns are as
    `skyline.store.header.columns_of` returns them; ``order`` (N,) has the rows to write, by default
    all. A store that already exists is replaced. Raises `MissingFileError` where there is no
    folder for the file, and `StoreError` where it cannot be written.
    """
    path = Path(path).resolve()
    _check_place(path)
    partial = path.with_name(f".{path.name}.{uuid4().hex[:12]}.partial")
    if order is None:
        order = np.arange(len(columns[header.sorted_by[0]]))
    with explained(path, "it cannot be written", "check the folder's rights and space"):
        try:
            with _Target(partial, "x+b") as target:
                aligned = _ALIGNED if header.holds == PLACES else {}
                with h5py.File(target, "w", libver=_LIBVER, **aligned) as file:
                    write_header(file, header)
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


def check_store_path(path: Path) -> None:
    """Check the path of a store that is to be written.

    Raises `InputError` for ``-`` and for the suffix of another format, `MissingFileError` where
    there is no folder for it.
    """
    check_suffix(path, SUFFIXES)
    _check_place(path)


def _check_place(path: Path) -> None:
    if path.name == STANDARD:
        raise InputError("a store cannot be written to standard output; name a file")
    if not path.parent.is_dir():
        raise MissingFileError(
            f"store {path} cannot be created: folder {path.parent} does not exist; make it first"
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
        """Flush the bytes to the disk; raises the `OSError` of the first write that failed."""
        if self._error is not None:
            raise self._error
        os.fsync(self.fileno())


@dataclass(frozen=True, slots=True)
class Damage:
    """A difference between a store and the bytes that were written."""

    what: str
    """The damage in one line."""
    first_row: int = 0
    rows: int = 0
    """``first_row``, ``rows``: the rows that are unreadable or wrong; no rows where the store as a
    whole is damaged."""


@dataclass(frozen=True, slots=True)
class StoreReport:
    """The result of `check_store`, `merge_stores` and `repair_store`."""

    rows: int
    """Rows of the store, or of the new store; 0 where it cannot be opened."""
    holds: str = "rows"
    """``renderings`` or ``places``; ``rows`` where the store cannot be opened."""
    damage: tuple[Damage, ...] = ()
    """The damage that was found; `repair_store` leaves these rows out."""
    duplicates: int = 0
    """Rows that `merge_stores` left out because the same view or place is already in the new
    store."""

    @property
    def whole(self) -> bool:
        """True if nothing is damaged."""
        return not self.damage


def merge_stores(
    paths: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]
) -> StoreReport:
    """Write the rows of stores into one new store, sorted by location.

    Parameters
    ----------
    paths : sequence of path-like
        At least one, of the same DEM and configuration, each of any box.
    out : path-like
        Must not exist.

    Raises
    ------
    StoreMismatchError
        Two of the stores were built with different settings; both values are named.
    StoreError
        A store is damaged, or the new one cannot be written or exists.
    """
    if not paths:
        raise InputError("no stores to merge; name one or more")
    out = _new(out)
    with merged_rows(paths, out.parent) as (header, columns, order):
        rows = write_store(out, header, columns, order)
        return StoreReport(rows, header.holds, duplicates=len(columns[header.checksum]) - rows)


def repair_store(path: str | os.PathLike[str], out: str | os.PathLike[str]) -> StoreReport:
    """Write the undamaged rows of a store into a new one, in their order.

    A chunk that HDF5 cannot read, of 1,024 places or 32 renderings, is left out as a whole. Raises
    `StoreError` where nothing can be saved, or the new store cannot be written or exists.
    """
    out = _new(out)
    damage: list[Damage] = []
    with open_store(path) as store:
        header, count = store.header, len(store)
    with _gathered([(path, count)], header, out.parent, damage) as columns:
        if count and not len(columns[header.checksum]):
            raise StoreError(f"none of the {count} rows of store {path} is whole; build it again")
        return StoreReport(write_store(out, header, columns), header.holds, tuple(damage))


@contextmanager
def merged_rows(
    paths: Sequence[str | os.PathLike[str]], folder: Path
) -> Iterator[tuple[StoreHeader, Columns, IntArray]]:
    """Yield the header, the rows and the order of the store that stores are merged into.

    The rows wait in a nameless file in ``folder``, unpacked. Raises as `merge_stores`.
    """
    counted, headers = [], []
    for path in paths:
        # Each store is closed at once, and not kept: there may be more stores than files can be
        # open, and h5py looks through all of its objects, closed ones too, whenever it closes one.
        with open_store(path) as store:
            counted.append((store.path, len(store)))
            headers.append(store.header)
    one, header = counted[0][0], headers[0]
    for (other, _), differing in zip(counted[1:], headers[1:], strict=True):
        refuse_mismatch(
            header.anywhere,
            differing.anywhere,
            f"stores {one} and {other} cannot be joined",
            "build both with the same settings from one DEM of both areas: skylines show terrain "
            "far around them",
            (f"in {one.name}", f"in {other.name}"),
        )
    # The header must not depend on the order of the stores.
    header = replace(
        header,
        config=joint_config(headers),
        dem_files=min(header.dem_files for header in headers),
        renderer="; ".join(
            sorted({name for header in headers for name in header.renderer.split("; ")})
        ),
        package_version=max(header.package_version for header in headers),
    )
    with _gathered(counted, header, folder) as columns:
        yield header, columns, sorted_once(header, columns)


@contextmanager
def open_joined(paths: Sequence[str | os.PathLike[str]]) -> Iterator[Store]:
    """Open a store, or several as the store into which `merge_stores` merges them.

    Several are merged into a temporary file, which disappears once its reader is closed. Raises as
    `open_store` and `merge_stores`.
    """
    if len(paths) == 1:
        with open_store(paths[0]) as store:
            yield store
        return
    with tempfile.TemporaryDirectory(prefix="skyline-") as folder:
        joined = Path(folder) / "joined.h5"
        merge_stores(paths, joined)
        with open_store(joined) as store:
            yield store


def joint_config(headers: Sequence[StoreHeader]) -> dict[str, object]:
    """Return the configuration of stores that may differ in their boxes."""
    config = dict(headers[0].config)
    if "bounds_deg" in config:
        boxes: set[Bounds] = set()
        for header in headers:
            if header.boxes_deg is None:
                return config | {"bounds_deg": None}
            boxes.update(header.boxes_deg)
        config["bounds_deg"] = sorted(boxes) if len(boxes) > 1 else boxes.pop()
    return config


def sorted_once(header: StoreHeader, columns: Columns) -> IntArray:
    """Return the rows to write, each once, in order of location and heading."""
    keys = [np.asarray(columns[name]) for name in header.sorted_by]
    # Of places with equal keys the one with the smallest tolerance is kept.
    ties = [columns[name] for field, name in header.fields.items() if field == "tolerance_m"]
    order = np.lexsort([*ties, *keys[::-1]])
    again = np.ones(len(order), dtype=bool)
    again[:1] = False
    for key in keys:
        again[1:] &= key[order[1:]] == key[order[:-1]]
    return order[~again]


@contextmanager
def _gathered(
    stores: Sequence[tuple[str | os.PathLike[str], int]],
    header: StoreHeader,
    folder: Path,
    damage: list[Damage] | None = None,
) -> Iterator[Columns]:
    """Yield all rows of stores, with the number that each has, unpacked in a file.

    Damaged rows are left out and appended to ``damage``; without such a list they raise
    `StoreError`. To read rows from the stores in order of location would unpack each chunk many
    times.
    """
    record, total = np.dtype(list(header.specs.items())), sum(count for _, count in stores)
    with (
        explained(folder, "rows cannot be gathered in it", "check the folder's rights and space"),
        tempfile.TemporaryFile(dir=folder) as file,
    ):
        rows = np.zeros(0, dtype=record)
        if total:
            # The space is taken now: a disk that fills up under a memory map ends the process.
            os.posix_fallocate(file.fileno(), 0, total * record.itemsize)
            rows = np.memmap(file, dtype=record, mode="r+", shape=total)
        stop = 0
        for path, _ in stores:
            with open_store(path) as store:
                for columns, whole, found in whole_rows(store):
                    if found is not None and damage is None:
                        raise StoreError(
                            f"store {store.path} is damaged: {found.what}; `skyline store "
                            "repair` saves the whole rows"
                        )
                    if found is not None and damage is not None:
                        damage.append(found)
                    start, stop = stop, stop + len(whole)
                    for name, values in columns.items():
                        rows[name][start:stop] = values[whole]
        yield {name: rows[name][:stop] for name in header.specs}


def check_store(path: str | os.PathLike[str]) -> StoreReport:
    """Read all of a store in another process and return what is damaged.

    Raises
    ------
    MissingFileError
        The file does not exist, or its build has not finished.
    StoreError
        The store could not be examined, for lack of memory for example.
    """
    path = Path(path).resolve()
    with open_hdf5(path):
        pass
    limit_s = _LIMIT_S + _LIMIT_S_PER_BYTE * path.stat().st_size
    command = [sys.executable, "-c", _EXAMINE, str(path), str(math.ceil(limit_s))]
    searched = os.pathsep.join(filter(None, sys.path))
    child = subprocess.run(
        command,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": searched},
        check=False,
    )
    if child.returncode < 0:
        reason = f"HDF5 crashes on it (signal {-child.returncode})"
        if child.returncode == -signal.SIGXCPU:
            reason = f"HDF5 had not read it after {limit_s:.0f} s of processor time"
        return _unreadable(f"store {path} is damaged: {reason}")
    try:
        report = json.loads(child.stdout)
    except ValueError as error:
        reason = (child.stderr.strip().splitlines() or ["no reason was given"])[-1]
        raise StoreError(f"store {path} could not be examined: {reason}; try again") from error
    damage = tuple(Damage(**item) for item in report.pop("damage"))
    return StoreReport(**report, damage=damage)


def _unreadable(reason: str) -> StoreReport:
    return StoreReport(0, damage=(Damage(reason),))


def examine(path: Path) -> StoreReport:
    """Do the work of `check_store` in this process."""
    try:
        with open_store(path) as store:
            found = [damage for _, _, damage in whole_rows(store) if damage]
            return StoreReport(len(store), store.header.holds, _joined(found))
    except SkylineError as error:
        return _unreadable(str(error))


def whole_rows(store: Store) -> Iterator[tuple[Columns, IntArray, Damage | None]]:
    """Yield stored rows block by block: the columns, which of them are whole, and the damage.

    A block where a chunk cannot be read is taken apart; its whole chunks are still yielded.
    """
    size = store.header.chunk_rows(len(store))
    for start in range(0, len(store), _ROWS_AT_ONCE):
        stop = min(start + _ROWS_AT_ONCE, len(store))
        try:
            yield _compared(store, start, stop)
        except StoreError:
            for first in range(start, stop, size):
                last = min(first + size, stop)
                try:
                    yield _compared(store, first, last)
                except StoreError as error:
                    yield {}, np.zeros(0, dtype=np.intp), Damage(str(error), first, last - first)


def is_whole(store: Store) -> bool:
    """Return whether all rows of a store can be read and have their checksums."""
    return all(damage is None for *_, damage in whole_rows(store))


def _compared(store: Store, start: int, stop: int) -> tuple[Columns, IntArray, Damage | None]:
    """Compare rows with their checksums."""
    columns = store.stored(slice(start, stop))
    same = row_checksums(columns) == columns[store.header.checksum]
    if same.all():
        return columns, np.arange(stop - start), None
    wrong = np.flatnonzero(~same)
    what = f"{len(wrong)} rows from {start + wrong[0]} on do not have their checksums"
    return columns, np.flatnonzero(same), Damage(what, int(start + wrong[0]), len(wrong))


def _joined(found: list[Damage]) -> tuple[Damage, ...]:
    """Return damage, that of successive chunks as one."""
    joined: list[Damage] = []
    for damage in found:
        last = joined[-1] if joined else None
        if last and last.what == damage.what and last.first_row + last.rows == damage.first_row:
            joined[-1] = Damage(last.what, last.first_row, last.rows + damage.rows)
        else:
            joined.append(damage)
    return tuple(joined)


def _new(out: str | os.PathLike[str]) -> Path:
    """Return the path of a store that is to be written and must not be there yet."""
    out = Path(out).resolve()
    check_store_path(out)
    if out.exists():
        raise StoreError(
            f"store {out} cannot be created: it exists already; remove it, or choose another name"
        )
    return out

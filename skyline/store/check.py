"""Comparing the rows of a store with their checksums.

A file whose structures were forged together with their checksums may hang or crash HDF5 itself.
`check_store` therefore reads in a process of its own, which may die.
"""

import json
import math
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from skyline.errors import SkylineError, StoreError
from skyline.store.layout import ROWS_AT_ONCE, Columns, row_checksums
from skyline.store.read import Store, open_hdf5, open_store

_EXAMINER = (sys.executable, "-m", "skyline.store.check")
"""The command that examines a store; it is followed by the store's path."""


@dataclass(frozen=True, slots=True)
class Damage:
    """A difference between a store and the bytes that were written."""

    what: str
    first_row: int = 0
    """The first row that is unreadable or wrong."""
    rows: int = 0
    """Number of such rows, which follow each other; 0 where the store as a whole is damaged."""


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


def check_store(
    path: str | os.PathLike[str],
    limit_s: float | None = None,
    examiner: Sequence[str] = _EXAMINER,
) -> StoreReport:
    """Read a whole store in another process, and return its damage.

    Parameters
    ----------
    path : path-like
    limit_s : float, optional
        Processor time after which HDF5 is taken to hang; by default a minute, and a second for each
        megabyte. One core of 2020 checks at least 30 MB a second. Wall-clock time would depend on
        how busy the machine is.
    examiner : sequence of str
        The command that examines the store: it takes the path, and prints the report as JSON.

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
    if limit_s is None:
        limit_s = 60.0 + 1e-6 * path.stat().st_size
    searched = os.pathsep.join(filter(None, sys.path))
    with subprocess.Popen(
        [*examiner, str(path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": searched},
    ) as child:
        limits = math.ceil(limit_s), resource.RLIM_INFINITY
        resource.prlimit(child.pid, resource.RLIMIT_CPU, limits)
        printed, errors = child.communicate()
    if child.returncode < 0:
        reason = f"HDF5 crashes on it (signal {-child.returncode})"
        if child.returncode == -signal.SIGXCPU:
            reason = f"HDF5 had not read it after {limit_s:.0f} s of processor time"
        return _unreadable(f"store {path} is damaged: {reason}")
    try:
        report = json.loads(printed)
    except ValueError as error:
        reason = (errors.strip().splitlines() or ["no reason was given"])[-1]
        raise StoreError(f"store {path} could not be examined: {reason}; try again") from error
    damage = tuple(Damage(**item) for item in report.pop("damage"))
    return StoreReport(**report, damage=damage)


def _unreadable(reason: str) -> StoreReport:
    return StoreReport(0, damage=(Damage(reason),))


def examine(path: Path) -> StoreReport:
    """Do the work of `check_store` in this process."""
    try:
        with open_store(path) as store:
            found = [damage for _, damage in whole_rows(store) if damage]
            return StoreReport(len(store), store.header.holds, _merged(found))
    except SkylineError as error:
        return _unreadable(str(error))


def whole_rows(store: Store) -> Iterator[tuple[Columns, Damage | None]]:
    """Yield each block's rows that match their checksums, and the damage.

    If one chunk of a block cannot be read, its other chunks are still read.
    """
    size = store.header.chunk_rows(len(store))
    for start in range(0, len(store), ROWS_AT_ONCE):
        stop = min(start + ROWS_AT_ONCE, len(store))
        try:
            yield _whole_rows_of(store, start, stop)
        except StoreError:
            for first in range(start, stop, size):
                last = min(first + size, stop)
                try:
                    yield _whole_rows_of(store, first, last)
                except StoreError as error:
                    yield {}, Damage(str(error), first, last - first)


def is_whole(store: Store) -> bool:
    """Return whether all rows can be read and match their checksums."""
    return all(damage is None for _, damage in whole_rows(store))


def _whole_rows_of(store: Store, start: int, stop: int) -> tuple[Columns, Damage | None]:
    """Return the rows that match their checksums, and the others' damage."""
    columns = store.stored(slice(start, stop))
    same = row_checksums(columns) == columns[store.header.checksum]
    if same.all():
        return columns, None
    wrong = start + np.flatnonzero(~same)
    what = f"{len(wrong)} rows from {wrong[0]} on do not match their checksums"
    whole = {name: values[same] for name, values in columns.items()}
    return whole, Damage(what, int(wrong[0]), len(wrong))


def _merged(found: list[Damage]) -> tuple[Damage, ...]:
    """Join the equal damage of successive chunks."""
    merged: list[Damage] = []
    for damage in found:
        last = merged[-1] if merged else None
        if last and last.what == damage.what and last.first_row + last.rows == damage.first_row:
            merged[-1] = replace(last, rows=last.rows + damage.rows)
        else:
            merged.append(damage)
    return tuple(merged)


if __name__ == "__main__":
    json.dump(asdict(examine(Path(sys.argv[1]))), sys.stdout)

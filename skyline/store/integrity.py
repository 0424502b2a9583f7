"""Is a store whole? Every row held to its checksum, the damage named.

A file from anywhere may hang or crash HDF5 itself, where its structures were forged together with
their checksums. `check_store` therefore reads in a process of its own, which may die.
"""

import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline.errors import SkylineError, StoreError
from skyline.store.built import Built
from skyline.store.lock import missing_store
from skyline.store.reader import Store, open_store
from skyline.store.rows import Columns, row_checksums

_BLOCK_ROWS = 1024
"""A whole number of chunks."""

_PATIENCE_S = 60.0
_PATIENCE_S_PER_BYTE = 1e-6
"""Of processor time, since a busy machine damages no store. Checking reads 30 MB a second and more
on one core of 2020."""

_WAITED = 30.0
"""Times the patience by the clock on the wall, for what waits instead of working."""


_EXAMINE = """
import dataclasses, json, pathlib, resource, sys, time
from skyline.store.integrity import examine
seconds = int(time.process_time()) + int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_CPU, (seconds, resource.RLIM_INFINITY))
json.dump(dataclasses.asdict(examine(pathlib.Path(sys.argv[1]))), sys.stdout)
"""


@dataclass(frozen=True, slots=True)
class Damage:
    """Something that is not as it was written."""

    what: str
    """One line."""
    first_row: int = 0
    rows: int = 0
    """``first_row``, ``rows``: which rows it makes unreadable or wrong; no rows where it is the
    store as a whole."""


@dataclass(frozen=True, slots=True)
class StoreReport:
    """What `check_store` found."""

    committed: int
    """Rows that the store says it holds; 0 where it cannot be opened."""
    in_use: bool
    """A writer is at work, or was killed; the next build goes on from the committed rows."""
    damage: tuple[Damage, ...]
    """Empty for a whole store."""
    holds: str = "rows"
    """``renderings`` or ``places``; ``rows`` where it cannot be opened."""
    built: Built = field(default_factory=Built)
    """How much of its build the store holds."""

    @property
    def whole(self) -> bool:
        """Whether nothing is damaged."""
        return not self.damage


def check_store(path: str | os.PathLike[str]) -> StoreReport:
    """Read all of a store in another process and return what is damaged.

    Raises
    ------
    MissingFileError
        No such file.
    StoreError
        The store could not be examined, for want of memory for example.
    """
    path = Path(path).resolve()
    if not path.is_file():
        raise missing_store(path)
    patience_s = _PATIENCE_S + _PATIENCE_S_PER_BYTE * path.stat().st_size
    command = [sys.executable, "-c", _EXAMINE, str(path), str(math.ceil(patience_s))]
    searched = os.pathsep.join(filter(None, sys.path))
    try:
        child = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_WAITED * patience_s,
            env={**os.environ, "PYTHONPATH": searched},
            check=False,
        )
    except subprocess.TimeoutExpired:
        return _hopeless(f"HDF5 had not read it after {_WAITED * patience_s:.0f} s")
    if child.returncode == -signal.SIGXCPU:
        return _hopeless(f"HDF5 had not read it after {patience_s:.0f} s of processor time")
    if child.returncode < 0:
        return _hopeless(f"HDF5 crashes on it (signal {-child.returncode})")
    try:
        said = json.loads(child.stdout)
    except ValueError as error:
        reason = (child.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise StoreError(f"store {path} could not be examined: {reason}; try again") from error
    damage = tuple(Damage(**item) for item in said["damage"])
    return StoreReport(**said | {"damage": damage, "built": Built(**said["built"])})


def _hopeless(what: str) -> StoreReport:
    return StoreReport(0, in_use=False, damage=(Damage(what),))


def examine(path: Path) -> StoreReport:
    """Do what `check_store` does in this process."""
    try:
        with open_store(path) as store:
            found = [damage for _, _, damage in whole_rows(store) if damage]
            # Of a changed count that is too low, nothing else tells.
            if not store.in_use and store.longest != store.committed:
                said = f"it holds {store.longest} rows and says {store.committed} are committed"
                found.insert(0, Damage(said))
            facts = store.committed, store.in_use, _joined(found), store.header.holds, store.built
            return StoreReport(*facts)
    except SkylineError as error:
        return _hopeless(str(error))


Rows = tuple[Columns, NDArray[np.intp], Damage | None]


def whole_rows(store: Store) -> Iterator[Rows]:
    """Yield stored rows block by block: the columns, which of them are whole, and what is not.

    A block where a chunk cannot be read is taken apart; its whole chunks are still yielded.
    """
    for start in range(0, len(store), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(store))
        try:
            yield _held_to_checksums(store, start, stop)
        except StoreError:
            for first in range(start, stop, store.header.chunk_rows):
                last = min(first + store.header.chunk_rows, stop)
                try:
                    yield _held_to_checksums(store, first, last)
                except StoreError as error:
                    yield {}, np.zeros(0, dtype=np.intp), Damage(str(error), first, last - first)


def _held_to_checksums(store: Store, start: int, stop: int) -> Rows:
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

"""Rendering the jobs of a build, and writing parts every few seconds.

A part is a small store with the rows of one job or of several successive ones. A job that takes
longer has begun parts: the rows it has rendered so far, in its order. When the job runs again, it
asks for the same viewpoints, and gets those rows in place of its first renderings.
"""

import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Complex128Array
from skyline.errors import StoreError
from skyline.skylines import HEADINGS
from skyline.store.check import is_whole
from skyline.store.layout import RENDERINGS, Columns, StoreHeader, explained
from skyline.store.read import open_store
from skyline.store.write import write_store
from skyline.survey.plans import JobRenderer
from skyline.terrain.viewpoints import Viewpoints

_FINISHED = re.compile(r"[a-z]+-(\d+)-(\d+)-of-(\d+)\.h5")
_BEGUN = re.compile(r"[a-z]+-(\d+)-from-(\d+)-of-(\d+)\.h5")

CountRows = Callable[[int, int], object]
"""Called with the number of rows just rendered, and `JobRenderer.expected`."""


@dataclass(frozen=True, slots=True)
class PartSize:
    """How much work a part holds before it is written."""

    seconds: float = 2.5
    """Time of rendering after which a part is written, as soon as the current rendering is done.
    Writing and merging a part takes twelve milliseconds, half a percent of the default."""
    most_bytes: int = 1 << 28
    """Greatest size of the rows that wait in memory, however fast they are rendered."""


@dataclass(frozen=True, slots=True)
class PartsFolder:
    """The folder of a build's parts, and their names."""

    path: Path
    holds: str
    jobs: int
    """Number of the build's jobs, which count from 1."""

    def part(self, first: int, last: int) -> Path:
        """Return the path of a part with jobs: ``places-00003-00005-of-00037.h5``."""
        return self.path / f"{self.holds}-{first:05d}-{last:05d}-of-{self.jobs:05d}.h5"

    def jobs_in(self, part: Path) -> range:
        """Return a part's finished jobs; none for begun parts and other files."""
        found = _FINISHED.fullmatch(part.name)
        if part.parent != self.path or not found or int(found[3]) != self.jobs:
            return range(0)
        return range(int(found[1]), int(found[2]) + 1)

    def begun_part(self, job: int, row: int) -> Path:
        """Return the path of a begun part: ``places-00003-from-4096-of-00037.h5``."""
        return self.path / f"{self.holds}-{job:05d}-from-{row}-of-{self.jobs:05d}.h5"

    def begun_parts(self, job: int) -> list[tuple[int, Path]]:
        """Return a job's begun parts in order, with their first rows' numbers."""
        parts = self.path.glob(f"{self.holds}-{job:05d}-from-*-of-{self.jobs:05d}.h5")
        found = ((_BEGUN.fullmatch(part.name), part) for part in parts)
        return sorted((int(name[2]), part) for name, part in found if name)


class JobWriter:
    """Renders jobs of a build, and writes their parts."""

    def __init__(
        self, renderer: JobRenderer, folder: PartsFolder, size: PartSize, tell: CountRows
    ) -> None:
        self.written: list[Path] = []
        """The parts of finished jobs."""
        self.rendered = 0
        """The number of their rows that were rendered here rather than taken from begun parts."""
        self._renderer = renderer
        self._folder = folder
        self._size = size
        self._tell = tell
        self._finished: dict[int, Columns] = {}
        """The rows of successive finished jobs that no part has yet."""
        self._job = 0
        """The current job."""
        self._row = 0
        """The number of the current job's rows in begun parts."""
        self._begun: Columns = {}
        """The rows in begun parts that the job has not asked for yet."""
        self._rendered: list[Columns] = []
        """The rows of the job that no part has yet."""
        self._restart()

    def write(self, jobs: Mapping[int, Any]) -> None:
        """Render jobs, given by their numbers, and write all of their rows."""
        self._tell(0, self._renderer.expected)
        for number, job in jobs.items():
            if self._finished and number - 1 not in self._finished:
                self._keep()
            self._job = number
            self._row = 0
            self._begun = self._read_begun(number)
            before = _eyes_of(self._renderer.begun, self._begun)
            rows = self._renderer.rows(job, self._look)
            self._rendered.clear()
            self._finished[number] = rows
            eyes = _eyes_of(self._renderer.header, rows)
            self.rendered += int(np.count_nonzero(~np.isin(eyes, before)))
            self._count(rows)
            if self._is_due:
                self._keep()
        self._keep()

    def _look(self, eyes: Viewpoints) -> Columns:
        """Render viewpoints, or read their rows if they are in begun parts."""
        size = self._renderer.at_once
        starts = range(0, max(len(eyes), 1), size)
        return _joined([self._rows_of(eyes[start : start + size]) for start in starts])

    def _rows_of(self, eyes: Viewpoints) -> Columns:
        wanted = np.repeat(eyes.easting_m + 1j * eyes.northing_m, self._rows_an_eye)
        held = {name: values[: len(wanted)] for name, values in self._begun.items()}
        if held and np.array_equal(_eyes_of(self._renderer.begun, held), wanted):
            self._begun = {name: values[len(wanted) :] for name, values in self._begun.items()}
            self._row += len(wanted)
            return held
        # The begun parts end here, or are of another release, which rendered other viewpoints.
        self._begun = {}
        rows = self._renderer.look(eyes)
        self._rendered.append(rows)
        self._count(rows)
        if self._is_due:
            self._keep()
        self._tell(len(wanted), self._renderer.expected)
        return rows

    @property
    def _rows_an_eye(self) -> int:
        return rows_an_eye(self._folder.holds)

    @property
    def _is_due(self) -> bool:
        return time.monotonic() >= self._due_s or self._bytes >= self._size.most_bytes

    def _count(self, rows: Columns) -> None:
        self._bytes += sum(values.nbytes for values in rows.values())

    def _restart(self) -> None:
        self._due_s = time.monotonic() + self._size.seconds
        self._bytes = 0

    def _keep(self) -> None:
        """Write the rows that no part has yet."""
        if self._finished:
            part = self._folder.part(min(self._finished), max(self._finished))
            self._write(part, self._renderer.header, list(self._finished.values()))
            self.written.append(part)
            for number in self._finished:
                for _, begun in self._folder.begun_parts(number):
                    begun.unlink(missing_ok=True)
            self._finished.clear()
        if self._rendered:
            part = self._folder.begun_part(self._job, self._row)
            self._row += self._write(part, self._renderer.begun, self._rendered)
            self._rendered.clear()
        self._restart()

    def _write(self, part: Path, header: StoreHeader, rows: Sequence[Columns]) -> int:
        with explained(part, "it cannot be written", "check the folder's rights and space"):
            for folder in (part.parent.parent, part.parent):
                folder.mkdir(exist_ok=True)
        return write_store(part, header, _joined(rows))

    def _read_begun(self, job: int) -> Columns:
        """Return the rows in a job's begun parts, up to a gap."""
        found: list[Columns] = []
        end = 0
        for row, part in self._folder.begun_parts(job):
            # Another process may finish the job now, and remove them.
            with suppress(StoreError, FileNotFoundError), open_store(part) as store:
                if row <= end < row + len(store) and is_whole(store):
                    columns = dict(store.stored(slice(end - row, None)))
                    del columns[store.header.checksum]
                    found.append(columns)
                    end = row + len(store)
        return _joined(found)


def rows_an_eye(holds: str) -> int:
    """Return the number of rows that a viewpoint has in a store."""
    return len(HEADINGS) if holds == RENDERINGS else 1


def _eyes_of(header: StoreHeader, columns: Columns) -> Complex128Array:
    """Return the locations of rows: easting + i northing."""
    easting, northing = (columns.get(name, np.zeros(0)) for name in header.sorted_by[:2])
    return np.asarray(easting + 1j * northing)


def _joined(some: Sequence[Columns]) -> Columns:
    """Join rows; without any, the result has no columns."""
    names = some[0] if some else ()
    return {name: np.concatenate([columns[name] for columns in some]) for name in names}

"""Building a store, in parts that are merged at the end.

A plan always cuts the work into the same jobs. Every few seconds the rendered rows are written as a
part (`skyline.survey.part_files`). So a build that is killed loses the last few seconds, and the
same command continues. Parts lie in the folder ``STORE.h5.parts``, where each build (one box, DEM
and settings) has a subfolder of its own. Merging sorts the rows: the number of workers, the order
and number of the parts, and how often a build was killed change no byte of the store.

Every job is rendered over the whole DEM, since terrain can rise into a skyline from any distance.
"""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

from skyline.errors import BuildError, InputError, SkylineError, StoreError, StoreMismatchError
from skyline.geodesy.bounds import Bounds
from skyline.geodesy.earth import Curvature
from skyline.progress import Progress
from skyline.render.horizon import RenderConfig
from skyline.store.check import is_whole
from skyline.store.layout import BEGUN, PLACES, StoreHeader, attributes_digest, refuse_mismatch
from skyline.store.merge import merged_rows
from skyline.store.read import open_store, parts_folder
from skyline.store.write import check_store_path, write_store
from skyline.survey.cluster import Opening, Runner, Tell
from skyline.survey.part_files import JobWriter, PartsFolder, PartSize, rows_an_eye
from skyline.survey.plans import JobRenderer, PlacePlan, Plan, RenderingPlan
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BuildResult:
    """The result of a build.

    Attributes
    ----------
    rows : int
        Renderings or places in the store.
    rendered : int
        Number of them that were rendered now; the others already existed.
    seconds : float
        Time for rendering, writing and merging, without the renderer's start.
    """

    rows: int
    rendered: int
    seconds: float


def build_places(
    terrain: Dem,
    path: str | Path,
    spacing_m: float | None = None,
    bounds_deg: Bounds | None = None,
    progress: Progress | None = None,
    *,
    places: int | None = None,
    curvature: Curvature | None = None,
) -> BuildResult:
    """Build a store of places; the same call continues a killed build.

    Parameters
    ----------
    terrain : path, paths, DataArray or HeightField
        The elevation model.
    path : str or Path
        The store. Nothing is done if it already exists with the same settings and bounds. A store
        with other bounds is replaced by a store of both areas.
    spacing_m : float, optional
        Metres between the places of a uniform grid. By default places lie densely where skylines
        are near, and sparsely where they are far; see `skyline.survey.adaptive_places`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    progress : callable, optional
        Called with the number of places rendered so far, earlier calls included, and the
        approximate number of all places.
    places : int, optional
        About how many places to plan if there is no spacing. By default 100,000; fewer if
        these would lose under 5 % of the views, which are 60 degrees wide, and more if they would
        lose over 20 %.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.

    Raises
    ------
    InputError
        The spacing suits no grid on the terrain, both a spacing and a number of places are given,
        or the area is so small that no place falls in it.
    StoreMismatchError
        The store at ``path``, or a part of it, was built from another DEM or with other settings.
    """
    field = read_dem(terrain)
    plan = PlacePlan(spacing_m, bounds_deg, places, field.frame.curvature_or(curvature))
    return build_store(field, path, plan, progress=progress)


def build_uniform(
    terrain: Dem,
    path: str | Path,
    spacing_m: float,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build a store of a uniform grid's renderings; otherwise as `build_places`."""
    terrain = read_dem(terrain)
    plan = RenderingPlan.uniform(terrain, spacing_m, bounds_deg, config or RenderConfig())
    return build_store(terrain, path, plan, progress=progress)


def render_to_store(
    terrain: Dem,
    viewpoints: Viewpoints,
    path: str | Path,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build a store of the renderings of given viewpoints; otherwise as `build_places`."""
    plan = RenderingPlan.given(viewpoints, config or RenderConfig())
    return build_store(read_dem(terrain), path, plan, progress=progress)


def build_store(
    terrain: HeightField,
    path: str | Path,
    plan: Plan,
    runner: Runner | None = None,
    progress: Progress | None = None,
    part_size: PartSize = PartSize(),  # noqa: B008  (it is frozen)
) -> BuildResult:
    """Render the missing rows of a store, and merge all parts.

    The rows are rendered in this process, or by a runner. Otherwise as `build_places`.

    Raises
    ------
    BuildError
        Jobs failed on workers; the parts of the others are kept.
    InputError, StoreMismatchError
        As `build_places`.
    """
    path = Path(path).resolve()
    check_store_path(path)
    jobs = plan.jobs(terrain)
    header = plan.header(terrain)
    folder = _folder_of(path, header, len(jobs))
    if path.exists() and (finished := finished_store(path, header)):
        # A build that was killed at its very end leaves parts beside a finished store.
        _remove(folder.path)
        return finished
    parts, kept = _whole_parts(folder, header)
    there = {number for part in parts for number in folder.jobs_in(part)}
    left = {number: job for number, job in enumerate(jobs, 1) if number not in there}
    sizes = [len(job) for job in jobs if isinstance(job, Viewpoints)]
    count = _Count(progress, kept, rows_an_eye(header.holds) * sum(sizes))
    write = partial(_write_jobs, folder, part_size)
    renderer = plan.opened(terrain) if runner is None and left else None
    started = time.perf_counter()
    written: list[Path] = []
    rendered = 0
    try:
        # The renderer's memory is free again before the parts are merged.
        with nullcontext() if renderer is None else renderer:
            if runner is not None:
                written, rendered = _on_workers(runner, header, plan, write, left, count)
            elif renderer is not None:
                written, rendered = write(renderer, left, count.add)
        count.end()
        rows = _merge_parts([*parts, *written], path)
    except (SkylineError, FileNotFoundError):
        # Another process may have built the same store meanwhile, and removed its parts.
        if not path.exists() or not (finished := finished_store(path, header)):
            raise
        rows = finished.rows
    finally:
        with suppress(OSError):  # Both are empty if the first part could not be written.
            folder.path.rmdir()
            folder.path.parent.rmdir()
    _remove(folder.path)
    if not rows:
        raise _empty(header)
    return BuildResult(rows, rendered, time.perf_counter() - started)


def _folder_of(path: Path, header: StoreHeader, jobs: int) -> PartsFolder:
    """Return the parts folder of a build: one box, DEM and settings."""
    # Parts may be continued by another release, on a DEM that has moved.
    build = replace(header, dem_files=(), package_version="")
    subfolder = parts_folder(path) / attributes_digest(build.attributes)[:12]
    return PartsFolder(subfolder, header.holds, jobs)


def _empty(header: StoreHeader) -> InputError:
    area = header.config.get("bounds_deg") or "all of the DEM"
    return InputError(
        f"no place falls on the surface in the area ({area}); choose a larger area, more "
        "places, or the spacing of a uniform grid"
    )


class _Count:
    """Counts the rows of a build, and reports them."""

    def __init__(self, progress: Progress | None, done: int, total: int) -> None:
        """Begin with ``done`` rows; ``total`` is 0 while unknown."""
        self._progress = progress
        self._done = done
        self._total = total

    def add(self, rows: int, expected: int) -> None:
        """Report rendered rows, and about how many rows are expected."""
        self._done += rows
        self._total = max(self._total, expected)
        # The end is reported when all parts are written.
        self._report(max(self._total, self._done + 1))

    def end(self) -> None:
        """Report that all rows are rendered."""
        self._report(self._done)

    def _report(self, total: int) -> None:
        if self._progress is not None:
            self._progress(self._done, total)


def _merge_parts(parts: list[Path], path: Path) -> int:
    """Merge parts into a store, and return its number of rows.

    The number is 0 where the parts have no rows; then no store is written. A store of other boxes
    at ``path`` is one more part of the new store, which replaces it.
    """
    folder = parts[0].parent
    before = _inode(path)
    held = 0
    if before is not None:
        with open_store(path) as store:
            held = len(store)
    merging = parts if before is None else [*parts, path]
    with merged_rows(merging, folder) as (header, columns, order):
        if len(columns[header.checksum]) == held:
            return 0
        # Another build of this path may merge now, so the file has a name of its own. If this build
        # is killed here, `_remove` deletes the file later.
        merged = folder / f".{uuid4().hex[:12]}.partial"
        write_store(merged, header, columns, order)
    if _inode(path) != before:
        raise StoreError(
            f"another build wrote {path} meanwhile; run the same command again to add this area"
        )
    merged.replace(path)
    return len(order)


def _inode(path: Path) -> int | None:
    """Return a file's number, which changes with its replacement, or None."""
    return path.stat().st_ino if path.exists() else None


def finished_store(path: Path, header: StoreHeader) -> BuildResult | None:
    """Return a finished build's result; None if the store lacks its boxes.

    Raises `StoreMismatchError` where other settings differ.
    """
    with open_store(path) as store:
        refuse_mismatch(
            store.header.anywhere,
            header.anywhere,
            f"store {path} was built otherwise",
            "repeat its settings or write to another file",
        )
        return BuildResult(len(store), 0, 0.0) if store.header.covers(header) else None


def _whole_parts(folder: PartsFolder, header: StoreHeader) -> tuple[list[Path], int]:
    """Return a build's whole parts, and the rows in all parts.

    Raises `StoreMismatchError` where another build of the same store has parts with other settings,
    which could not be merged with these.
    """
    whole: list[Path] = []
    rows = 0
    for part in sorted(folder.path.parent.glob("*/*-of-*.h5")):
        # The other build may end now, and remove its parts.
        with suppress(StoreError, FileNotFoundError), open_store(part) as store:
            there = store.header
            if there.holds == BEGUN:
                there = replace(there, holds=PLACES, width=0)
            refuse_mismatch(
                there.anywhere,
                header.anywhere,
                f"{part.parent} has parts of a store that was built otherwise",
                "repeat its settings, or remove the folder to build anew",
            )
            if part.parent != folder.path:
                continue
            if folder.jobs_in(part):
                if not is_whole(store):
                    continue
                whole.append(part)
            rows += len(store)
    return whole, rows


def _opened_by_worker(plan: Plan, header: StoreHeader) -> JobRenderer:
    """Return the renderer of a plan's jobs; a worker reads the DEM.

    The store's header has the DEM's files, by paths that are the same on every machine.
    """
    try:
        terrain = header.read_dem()
    except StoreMismatchError as error:
        raise StoreMismatchError(
            f"{error}; workers need the same files and the same releases of skyline and its "
            "libraries"
        ) from error
    return plan.opened(terrain)


def _write_jobs(
    folder: PartsFolder,
    part_size: PartSize,
    renderer: JobRenderer,
    jobs: Mapping[int, Any],
    tell: Tell,
) -> tuple[list[Path], int]:
    """Render and write numbered jobs; return their parts and rendered rows."""
    writer = JobWriter(renderer, folder, part_size, tell)
    writer.write(jobs)
    return writer.written, writer.rendered


def _on_workers(
    runner: Runner,
    header: StoreHeader,
    plan: Plan,
    write: Callable[[JobRenderer, Mapping[int, Any], Tell], tuple[list[Path], int]],
    left: Mapping[int, Any],
    count: _Count,
) -> tuple[list[Path], int]:
    """Have a runner write each job; return parts and rendered rows.

    If jobs failed, raises the error of `_error_of` when all others are done.
    """
    if not header.dem_files:
        raise InputError("a DEM made in memory cannot be sent to workers; write it to a file first")
    if isinstance(plan, RenderingPlan):
        # Each job brings its own viewpoints.
        plan = replace(plan, viewpoints=plan.viewpoints[:0])
    names = [f"job {number}" for number in left]
    written: list[Path] = []
    rendered = 0
    failures: dict[str, SkylineError] = {}
    opening = Opening(uuid4().hex, partial(_opened_by_worker, plan, header))
    jobs = [{number: job} for number, job in left.items()]
    outcomes = runner(write, opening, jobs, names, count.add)
    for name, outcome in zip(names, outcomes, strict=True):
        if isinstance(outcome, SkylineError):
            failures[name] = outcome
            _log.warning("%s failed: %s", name, outcome)
        else:
            parts, rows = outcome
            written += parts
            rendered += rows
    if failures:
        raise _error_of(failures, len(names))
    return written, rendered


def _error_of(failures: Mapping[str, SkylineError], jobs: int) -> SkylineError:
    """Return all jobs' common error, or a `BuildError` that names five."""
    if len(failures) == jobs and len({str(error) for error in failures.values()}) == 1:
        return next(iter(failures.values()))
    named = [f"{name} ({error})" for name, error in failures.items()]
    more = f" and {len(named) - 5} more" if len(named) > 5 else ""
    return BuildError(
        f"{len(failures)} of {jobs} jobs failed: {'; '.join(named[:5])}{more}. The others are "
        "kept: mend the cause and give the same command, which continues with the rest"
    )


def _remove(folder: Path) -> None:
    """Remove a build's parts, and the folder of all parts if empty."""
    shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        folder.parent.rmdir()

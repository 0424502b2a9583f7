"""Building a store: its parts are rendered one by one, each a finished file, and merged.

A part is a store of its own in the folder ``STORE.parts``, in the subfolder of its build: one box,
DEM and settings. It is rendered in memory and then written under its name at once, so a build that
is killed loses at most the part in hand, and the same command continues with the parts that are
missing. Builds of other boxes leave each other's parts alone. Merging sorts the rows: the number of
workers, the order of the parts, and how often a build was killed change no byte of the store.

Every part is rendered over the whole DEM, since terrain can rise into a skyline from any distance.
"""

import logging
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from uuid import uuid4

from skyline.arrays import Progress
from skyline.build.cluster import Runner
from skyline.build.plans import PartRenderer, PlacePlan, Plan, RenderingPlan
from skyline.errors import BuildError, InputError, SkylineError, StoreError, StoreMismatchError
from skyline.geodesy import Bounds, Curvature
from skyline.render.horizon import RenderConfig
from skyline.store.format import StoreHeader, attributes_digest, explained, refuse_mismatch
from skyline.store.read import open_store, part_name, parts_folder
from skyline.store.write import check_store_path, merged_rows, whole_rows, write_store
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_NAMED = 5
"""Failed parts that an error names."""

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
        Time that rendering, writing and merging took; a renderer is started before.
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
    """Build a store of places; the same call continues a build that was killed.

    Parameters
    ----------
    terrain : path, paths or HeightField
        The elevation model.
    path : str or Path
        The store. Nothing is done if it already exists with the same settings and bounds. One of
        other bounds is replaced by a store of both areas.
    spacing_m : float, optional
        Metres between the places of a uniform grid. By default places lie densely where skylines
        are near, and sparsely where they are far; see `skyline.build.spacing`.
    bounds_deg : tuple, optional
        W, S, E, N in degrees; by default all of the terrain.
    progress : callable, optional
        Called with the number of parts that are done, and the number of all parts.
    places : int, optional
        About how many places to plan if there is no spacing. By default 100,000; fewer if fewer
        lose only 5 % of the views, which are 60 degrees wide, and more if 100,000 would lose over
        20 %.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.

    Raises
    ------
    InputError
        The spacing suits no grid on the terrain, a number of places is given beside it, or no place
        falls in so small an area.
    StoreMismatchError
        The store at ``path``, or a part of it, was built from another DEM or with other settings.
    """
    plan = PlacePlan(spacing_m, bounds_deg, places, curvature or Curvature())
    return build_store(read_dem(terrain), path, plan, progress=progress)


def build_uniform(
    terrain: HeightField,
    path: str | Path,
    spacing_m: float,
    bounds_deg: Bounds | None = None,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build a store of the renderings of a uniform grid; otherwise as `build_places`."""
    plan = RenderingPlan.uniform(terrain, spacing_m, bounds_deg, config or RenderConfig())
    return build_store(terrain, path, plan, progress=progress)


def render_to_store(
    terrain: HeightField,
    viewpoints: Viewpoints,
    path: str | Path,
    config: RenderConfig | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Build a store of the renderings of given viewpoints; otherwise as `build_places`."""
    plan = RenderingPlan.given(viewpoints, config or RenderConfig())
    return build_store(terrain, path, plan, progress=progress)


def build_store(
    terrain: HeightField,
    path: str | Path,
    plan: Plan,
    runner: Runner | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render the missing parts of a store, here or by a runner, and merge all of them.

    Raises
    ------
    BuildError
        Parts failed on workers; the others are kept.
    InputError, StoreMismatchError
        As `build_places`.
    """
    path = Path(path).resolve()
    check_store_path(path)
    work, header = plan.parts(terrain), plan.header(terrain)
    # Parts may be continued by another release, on a DEM that has moved.
    build = replace(header, dem_files=(), package_version="")
    folder = parts_folder(path) / attributes_digest(build.attributes)[:12]
    if path.exists() and (finished := finished_store(path, header)):
        # A build that was killed at its very end leaves parts beside a finished store.
        _remove(folder)
        return finished
    numbers = range(1, len(work) + 1)
    parts = [folder / part_name(header.holds, number, len(work)) for number in numbers]
    there = _whole_parts(folder, header)
    left = {part: some for part, some in zip(parts, work, strict=True) if part not in there}
    done, rendered = len(parts) - len(left), 0
    show = progress or (lambda *_: None)
    written: Iterable[int] = ()
    opened = plan.opened(terrain) if runner is None and left else None
    with nullcontext() if opened is None else opened.renderer:
        started = time.perf_counter()
        show(done, len(parts))
        if runner is not None:
            written = _on_workers(runner, header, plan, left)
        elif opened is not None:
            written = map(partial(_render_part, opened), left.items())
        try:
            for rows_of_part in written:
                rendered += rows_of_part
                done += 1
                show(done, len(parts))
            rows = _merge_parts(parts, path)
        except (SkylineError, FileNotFoundError):
            # Another process may have built the same store meanwhile, and removed its parts.
            if not path.exists() or not (finished := finished_store(path, header)):
                raise
            rows = finished.rows
        finally:
            with suppress(OSError):  # Both are empty if the first part could not be written.
                folder.rmdir()
                folder.parent.rmdir()
    _remove(folder)
    if not rows:
        area = header.config.get("bounds_deg") or "all of the DEM"
        raise InputError(
            f"no place falls on the surface in the area ({area}); choose a larger area, more "
            "places, or the spacing of a uniform grid"
        )
    return BuildResult(rows, rendered, time.perf_counter() - started)


def _merge_parts(parts: list[Path], path: Path) -> int:
    """Merge parts into a store, and return its number of rows; 0 where the parts have none.

    A store of other boxes at ``path`` is one more part of the new store, which replaces it.
    """
    folder, others, held, was = parts[0].parent, list[Path](), 0, _inode(path)
    if path.exists():
        with open_store(path) as store:
            others, held = [path], len(store)
    with merged_rows([*parts, *others], folder) as (header, columns, order):
        if len(columns[header.checksum]) == held:
            return 0
        # A name of its own, since another build of this path may merge now. A build that is killed
        # here leaves the file to `_remove`.
        merged = folder / f".{uuid4().hex[:12]}.partial"
        write_store(merged, header, columns, order)
    if _inode(path) != was:
        raise StoreError(
            f"another build wrote {path} meanwhile; run the same command again to add this area"
        )
    merged.replace(path)
    return len(order)


def _inode(path: Path) -> int | None:
    """Return the number of the file at a path, which changes as the file is replaced."""
    return path.stat().st_ino if path.exists() else None


def finished_store(path: Path, header: StoreHeader) -> BuildResult | None:
    """Return the result of a finished build; None where the store has only other boxes.

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


def _whole_parts(folder: Path, header: StoreHeader) -> set[Path]:
    """Return the parts of a build that are whole.

    Raises `StoreMismatchError` where another build of the same store has parts of other settings,
    which could not be joined.
    """
    whole = set()
    for part in sorted(folder.parent.glob("*/*-of-*.h5")):
        # The other build may end now, and remove its parts.
        with suppress(StoreError, FileNotFoundError), open_store(part) as store:
            refuse_mismatch(
                store.header.anywhere,
                header.anywhere,
                f"{part.parent} has parts of a store that was built otherwise",
                "repeat its settings, or remove the folder to build anew",
            )
            if part.parent == folder and all(damage is None for *_, damage in whole_rows(store)):
                whole.add(part)
    return whole


def _write_part(build: str, plan: Plan, header: StoreHeader, item: tuple[Path, Any]) -> int:
    """Render and write a part in a worker; return its number of rows.

    The worker keeps terrain and renderer for the next part of a build, which has an identifier.
    All calls in a process must come from one thread, which owns the OpenGL context. The store's
    header has the DEM's files, by paths that are the same on every machine.
    """
    if build not in _open_renderer:
        while _open_renderer:
            _open_renderer.popitem()[1].renderer.release()
        try:
            terrain = header.read_dem()
        except StoreMismatchError as error:
            raise StoreMismatchError(
                f"{error}; workers need the same files and the same releases of skyline and its "
                "libraries"
            ) from error
        _open_renderer[build] = plan.opened(terrain)
    return _render_part(_open_renderer[build], item)


def _render_part(renderer: PartRenderer, item: tuple[Path, Any]) -> int:
    path, work = item
    columns = renderer.columns(work)
    with explained(path, "it cannot be written", "check the folder's rights and space"):
        for folder in (path.parent.parent, path.parent):
            folder.mkdir(exist_ok=True)
    return write_store(path, renderer.header, columns)


_open_renderer: dict[str, PartRenderer] = {}
"""The renderer that this worker keeps, by the build."""


def _on_workers(
    runner: Runner, header: StoreHeader, plan: Plan, left: dict[Path, Any]
) -> Iterator[int]:
    """Render and write parts by a runner; yield the number of rows of each.

    Raises at the end the error of the parts if all of them failed with the same one, and
    `BuildError` with the names of the first few otherwise.
    """
    if not header.dem_files:
        raise InputError("a DEM made in memory cannot be sent to workers; write it to a file first")
    if isinstance(plan, RenderingPlan):
        # Each job brings its own viewpoints.
        plan = RenderingPlan(plan.viewpoints[:0], plan.settings, plan.config)
    names = [part.stem for part in left]
    failures: dict[str, SkylineError] = {}
    write = partial(_write_part, uuid4().hex, plan, header)
    jobs = runner(write, list(left.items()), names)
    for name, outcome in zip(names, jobs, strict=True):
        if isinstance(outcome, SkylineError):
            failures[name] = outcome
            _log.warning("%s failed: %s", name, outcome)
        else:
            yield outcome
    if failures:
        if len(failures) == len(names) and len({str(error) for error in failures.values()}) == 1:
            raise failures[names[0]]
        named = [f"{name} ({error})" for name, error in failures.items()]
        more = f" and {len(named) - _NAMED} more" if len(named) > _NAMED else ""
        raise BuildError(
            f"{len(failures)} of {len(names)} failed: {'; '.join(named[:_NAMED])}{more}. The "
            "others are kept: mend the cause and give the same command, which continues with the "
            "rest"
        )


def _remove(folder: Path) -> None:
    """Remove the parts of a build, and the folder of all parts if no other build has any."""
    shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        folder.parent.rmdir()

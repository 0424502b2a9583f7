"""A build cut into tiles, each an independent job that writes a store of its own.

Every job renders over the whole DEM: how far terrain can rise into a skyline has no bound but the
DEM's own, and with one DEM there is one digest to hold all shards to. What is cut is the work, the
lattice of viewpoints; a DEM that is to be small is cut before, by `skyline dem fetch`.

A tile holds the viewpoints in its half-open square, or a planner's blocks whose south-western
corners lie there, so each is in one tile. A shard that is whole is left as it is, one that was
begun is finished, and merging sorts the rows: who rendered what, when, in which tiles, and how
often a worker died shows nowhere in the result.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import InputError, StoreError, StoreMismatchError
from skyline.pipeline.build import (
    BuildResult,
    missing,
    refuse_empty,
    render_missing,
    rows_each,
)
from skyline.pipeline.config import BuildConfig, RenderConfig
from skyline.pipeline.jobs import Progress, Runner, collect, run_here
from skyline.pipeline.layout import Layout
from skyline.pipeline.row_renderers import RowRenderer, rows_of
from skyline.planning.adaptive import Blocks
from skyline.planning.uniform import map_bounds
from skyline.store import Built, merge_stores, open_for_append
from skyline.store.lock import shards_folder
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class Shard:
    """A tile of the lattice."""

    name: str
    """The tile's size and place: ``10000m_59_517`` spans eastings from 590 km to under 600 km and
    northings from 5170 km to under 5180 km."""
    work: Viewpoints | Blocks
    """In the tile."""
    total: int
    """How many viewpoints or blocks there are in all tiles."""


@dataclass(frozen=True, slots=True)
class ShardSettings:
    """What all jobs of a build share; a few hundred bytes that are sent with each."""

    dem_files: tuple[str, ...]
    """Absolute paths, the same wherever a job runs."""
    dem_digest: str
    dem_options: DemOptions
    layout: Layout
    config: BuildConfig
    folder: str
    """Absolute path of the shards."""

    def read_terrain(self) -> HeightField:
        """Read the DEM; raises `StoreMismatchError` where another one lies there."""
        terrain = read_dem(self.dem_files, self.dem_options)
        if terrain.digest != self.dem_digest:
            raise StoreMismatchError(
                f"the DEM here ({', '.join(self.dem_files)}) has digest {terrain.digest[:12]}, the "
                f"build's has {self.dem_digest[:12]}; workers need the same files and the same "
                "release of skyline and of what it builds on"
            )
        return terrain


_here: dict[ShardSettings, RowRenderer[Any]] = {}
"""What this process renders with."""


def build_shard(settings: ShardSettings, shard: Shard) -> BuildResult:
    """Do one job in a worker process, which keeps terrain and renderer for the next one.

    All calls in a process must come from one thread, the OpenGL context's.

    Raises
    ------
    StoreError
        A shard that cannot be written, or that another process is writing.
    StoreMismatchError
        A shard of another build, or another DEM than the build's.
    """
    if settings not in _here:
        while _here:
            _here.popitem()[1].__exit__()
        terrain, layout = settings.read_terrain(), settings.layout
        area = map_bounds(terrain, layout.bounds_deg)
        _here[settings] = rows_of(terrain, area, settings.config, layout)
    return _build(Path(settings.folder), _here[settings], shard)


def _build(folder: Path, rows: RowRenderer[Any], shard: Shard) -> BuildResult:
    """Render what a shard lacks; one that is whole is only looked at."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{shard.name}.h5"
    done = render_missing(path, rows, shard.work, total=shard.total)
    if isinstance(shard.work, Viewpoints):
        due = rows_each(rows.header) * len(shard.work)
        if done.rows != due:
            raise StoreError(
                f"shard {path} holds {done.rows} {rows.header.holds} of what should be {due}; "
                "remove it and give the same command"
            )
    return done


def cut_into_shards(work: Viewpoints | Blocks, tile_m: float) -> list[Shard]:
    """Cut work into squares, from the north-west row by row; what is in one keeps its order.

    Raises `InputError` for a size that is not positive.
    """
    if not (np.isfinite(tile_m) and tile_m > 0.0):
        raise InputError(f"tile size is {tile_m} m; expected a positive number of metres")
    easting_m, northing_m = work.easting_m, work.northing_m
    col = np.floor(easting_m / tile_m).astype(np.int64)
    row = np.floor(northing_m / tile_m).astype(np.int64)
    order = np.lexsort((col, -row))
    place = np.stack([row[order], col[order]])
    starts = np.flatnonzero(np.r_[True, (np.diff(place) != 0).any(axis=0)])
    return [
        Shard(f"{tile_m:.12g}m_{place[1, start]}_{place[0, start]}", work[members], len(work))
        for start, members in zip(starts, np.split(order, starts[1:]), strict=True)
    ]


def build_sharded(
    terrain: HeightField,
    path: str | Path,
    layout: Layout,
    config: BuildConfig | None = None,
    runner: Runner | None = None,
    progress: Progress | None = None,
) -> BuildResult:
    """Render a uniform grid, or planned places, by tiles into shards; merge them into one store.

    The result is, to the byte, what `compact_store` makes of the store that `build_uniform` gives,
    or with a `PlaceConfig` `build_places`.
    Shards lie in the folder ``PATH.shards`` until they are merged.

    Parameters
    ----------
    terrain : HeightField
        Read from files, unless ``runner`` works in this process.
    config : RenderConfig or PlaceConfig, optional
        What is rendered and how; by default renderings.
    runner : Runner, optional
        What does the jobs; by default this process, one after another.
    progress : callable, optional
        Called after each tile with how many are done, and with how many there are.

    Raises
    ------
    BuildError
        Tiles that failed; the others' shards are kept.
    StoreMismatchError
        What is at ``path``, or one of the shards, was built otherwise.
    StoreError
        A store at ``path`` that is not whole.
    """
    started = time.perf_counter()
    path, config = Path(path).resolve(), config or RenderConfig()
    area = map_bounds(terrain, layout.bounds_deg)
    work = layout.work(terrain, area, config.eye_height_m)
    shards = cut_into_shards(work, layout.tile_m)
    folder = shards_folder(path)
    rows = partial(rows_of, terrain, area, config, layout)
    if path.exists():
        held = _held_already(path, rows, work)
        _remove(folder, shards)
        return held
    settings = ShardSettings(
        terrain.provenance.files,
        terrain.digest,
        DemOptions.from_json(terrain.provenance.options),
        layout,
        config,
        str(folder),
    )
    done = _run_all(settings, shards, runner, rows, progress)
    merged = merge_stores([folder / f"{shard.name}.h5" for shard in shards], path)
    _remove(folder, shards)
    rendered = sum(result.rendered for result in done)
    built = BuildResult(merged.rows, rendered, time.perf_counter() - started)
    return refuse_empty(built, path, layout)


def _run_all(
    settings: ShardSettings,
    shards: Sequence[Shard],
    runner: Runner | None,
    rows_here: Callable[[], RowRenderer[Any]],
    progress: Progress | None,
) -> list[BuildResult]:
    """Do all jobs."""
    names = [shard.name for shard in shards]
    finished = 0

    def tell(_: BuildResult) -> None:
        nonlocal finished
        finished += 1
        if progress:
            progress(finished, len(shards))

    if progress:
        progress(0, len(shards))
    if runner is None:
        with rows_here() as rows:
            work = partial(_build, Path(settings.folder), rows)
            return collect(run_here(work, shards, names), names, tell)
    if not settings.dem_files:
        raise InputError("a DEM made in memory cannot be sent to workers; write it to a file first")
    return collect(runner(partial(build_shard, settings), shards, names), names, tell)


def _held_already(
    path: Path, rows_here: Callable[[], RowRenderer[Any]], work: Viewpoints | Blocks
) -> BuildResult:
    """Return what a store has that was there before; it must be whole and of this build."""
    started = time.perf_counter()
    with rows_here() as rows:
        if isinstance(work, Blocks):
            # Which places it should have shows only as they are planned: what is left is done here.
            return render_missing(path, rows, work)
        with open_for_append(path, rows.header) as writer:
            if len(missing(path, work)):
                raise StoreError(
                    f"store {path} is there and lacks some of {len(work)} viewpoints; finish it "
                    "without tiles, remove it, or choose another name"
                )
            writer.note_built(Built(len(work), len(work)))
            return BuildResult(len(writer), 0, time.perf_counter() - started)


def _remove(folder: Path, shards: Sequence[Shard]) -> None:
    """Remove shards that were merged, and their folder if nothing else is in it."""
    for shard in shards:
        (folder / f"{shard.name}.h5").unlink(missing_ok=True)
        (folder / f"{shard.name}.h5.lock").unlink(missing_ok=True)
    with suppress(OSError):
        folder.rmdir()

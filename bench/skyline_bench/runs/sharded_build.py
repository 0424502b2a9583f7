"""Sharded builds, on 3 arc-second tiles of the High Sierra.

Two workers against one on the same tiles, with a renderer of one thread and of as many as there
are cores; a build one of whose workers is killed half way; and 3,000 km2 at 500 m, built, merged
and matched.
"""

import multiprocessing
import os
import resource
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline.pipeline.cluster import local_runner
from skyline.pipeline.config import RenderConfig
from skyline.pipeline.layout import Layout
from skyline.pipeline.match import Matcher
from skyline.pipeline.shards import build_sharded
from skyline.planning.uniform import map_bounds
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.digests import file_digest
from skyline_bench.measuring.memory import peak_bytes
from skyline_bench.queries.synthetic import make_queries
from skyline_bench.trials.trials import errors

YOSEMITE = (-119.60, 37.45, -119.00, 37.962)
"""3,000 km2."""
PART = (-119.40, 37.70, -119.12, 37.92)
"""600 km2."""
QUERIES = 6
ROUNDS = 3
"""Of two workers against one."""

Row = dict[str, object]


class _Clock:
    """When tiles were done: a build's speed without what its workers take to start."""

    def __init__(self, told: Callable[[int], None] = lambda _: None) -> None:
        self._told = told
        self._done: list[tuple[float, int]] = []

    def __call__(self, done: int, _total: int) -> None:
        """Note how many renderings there are now; a `Progress`."""
        self._done.append((time.perf_counter(), done))
        self._told(done)

    @property
    def first_tile(self) -> float:
        """When the first tile was done."""
        return self._done[1][0]

    @property
    def last_tile(self) -> float:
        """When the last tile was done."""
        return self._done[-1][0]

    @property
    def per_second(self) -> float:
        """Renderings a second in the second half, when every worker has long been at work."""
        all_ = self._done[-1][1]
        start, held = next(entry for entry in self._done if 2 * entry[1] >= all_)
        return (all_ - held) / (self.last_tile - start)


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _build(terrain: HeightField, path: Path, plan: Layout, workers: int, clock: _Clock) -> Row:
    """Build with workers of this machine; return what it took."""
    cpu_s, load = _children_cpu_s(), os.getloadavg()[0]
    started = time.perf_counter()
    with local_runner(workers) as runner:
        ready = time.perf_counter()
        done = build_sharded(terrain, path, plan, RenderConfig(), runner, clock)
        ended = time.perf_counter()
    return {
        "workers": workers,
        "renderings": done.rows,
        "start_s": ready - started,
        "first_tile_s": clock.first_tile - ready,
        "build_s": clock.last_tile - ready,
        "merge_s": ended - clock.last_tile,
        "renderings_a_second": clock.per_second,
        "workers_cpu_s": _children_cpu_s() - cpu_s,
        "bytes": path.stat().st_size,
        "digest": file_digest(path)[:16],
        "load_average": load,
    }


def measure_workers(terrain: HeightField, folder: Path, quick: bool) -> list[Row]:
    """Two workers against one, in turn, since the machine may be busy with other things."""
    plan = Layout(_spacing_m(quick), 5000.0, PART)
    rows: list[Row] = []
    cores = os.cpu_count() or 1
    for turn in range(1 if quick else ROUNDS):
        for workers, threads in ((1, 1), (2, 1), (1, cores)):
            os.environ["LP_NUM_THREADS"] = str(threads)
            path = folder / f"{turn}_{workers}_{threads}.h5"
            row = _build(terrain, path, plan, workers, _Clock())
            rows.append({"case": "workers", "renderer_threads": threads, "round": turn} | row)
            del os.environ["LP_NUM_THREADS"]
    rows.append({"case": "workers, ratios"} | _ratios(rows, cores))
    return rows


def _ratios(rows: Sequence[Row], cores: int) -> Row:
    """Return how much faster two workers were, the median over the rounds."""

    def speeds(workers: int, threads: int) -> NDArray[np.float64]:
        mine = [r for r in rows if (r["workers"], r["renderer_threads"]) == (workers, threads)]
        return np.array([r["renderings_a_second"] for r in mine], dtype=np.float64)

    two = speeds(2, 1)
    return {
        "two_to_one_of_one_thread": float(np.median(two / speeds(1, 1))),
        f"two_to_one_of_{cores}_threads": float(np.median(two / speeds(1, cores))),
        "same_bytes": len({row["digest"] for row in rows}) == 1,
    }


def measure_killed(terrain: HeightField, folder: Path, quick: bool) -> list[Row]:
    """Kill one of two workers when half of the renderings are there."""
    plan = Layout(_spacing_m(quick), 5000.0, PART)
    unbroken = _build(terrain, folder / "unbroken.h5", plan, 2, _Clock())
    half = int(str(unbroken["renderings"])) // 2
    killed: list[int] = []

    def kill(done: int) -> None:
        if done >= half and not killed:
            worker = multiprocessing.active_children()[0]
            killed.append(worker.pid or 0)
            worker.kill()

    row = _build(terrain, folder / "killed.h5", plan, 2, _Clock(kill))
    same = row["digest"] == unbroken["digest"]
    rows = [{"case": "killed, unbroken"} | unbroken]
    rows.append({"case": "killed", "killed": len(killed), "same_bytes": same} | row)
    return rows


def measure_area(terrain: HeightField, folder: Path, quick: bool) -> list[Row]:
    """3,000 km2 at 500 m, four headings: built, merged, matched."""
    west, south, east, north = map_bounds(terrain, YOSEMITE)
    plan, path = Layout(_spacing_m(quick), 10_000.0, YOSEMITE), folder / "area.h5"
    row: Row = {"case": "area", "area_km2": (east - west) * (north - south) / 1e6}
    row |= _build(terrain, path, plan, 2, _Clock())
    row["worker_peak_bytes"] = 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    row["bytes_a_rendering"] = path.stat().st_size / int(str(row["renderings"]))
    queries = make_queries(terrain, (west, south, east, north), QUERIES, seed=7)
    started = time.perf_counter()
    matcher = Matcher(path, terrain, "correlation")
    opened = time.perf_counter()
    found = [matcher.match(query.skyline) for query in queries]
    errors_m = [
        errors(result.candidates[0], query.truth)[0]
        for result, query in zip(found, queries, strict=True)
    ]
    matched: Row = {
        "case": "area, matched",
        "matcher": "correlation",
        "queries": len(queries),
        "locations": len(matcher.viewpoints),
        "open_s": opened - started,
        "query_s": float(np.median([result.seconds for result in found])),
        "within_1_km": float(np.mean(np.array(errors_m) < 1000.0)),
        "peak_bytes": peak_bytes(),
    }
    return [row, matched]


def _spacing_m(quick: bool) -> float:
    return 2000.0 if quick else 500.0


PARTS: dict[str, Callable[[HeightField, Path, bool], list[Row]]] = {
    "workers": measure_workers,
    "killed": measure_killed,
    "area": measure_area,
}

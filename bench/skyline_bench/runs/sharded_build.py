"""Sharded builds, on 3 arc-second tiles of the High Sierra.

Two workers against one on the same tiles, with a renderer of one thread and of as many as there
are cores; a build one of whose workers is killed half way; and 3,000 km2 at 500 m, built, merged
and matched.
"""

import multiprocessing
import os
import resource
import time
from collections.abc import Callable
from multiprocessing.process import BaseProcess
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
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import peak_bytes
from skyline_bench.queries.synthetic import make_queries
from skyline_bench.search.trials import errors, file_digest

YOSEMITE = (-119.60, 37.45, -119.00, 37.962)
"""3,000 km2."""
PART = (-119.40, 37.70, -119.12, 37.92)
"""600 km2."""
QUERIES = 6
ROUNDS = 3
"""Of two workers against one."""


def _build(
    terrain: HeightField,
    path: Path,
    plan: Layout,
    workers: int,
    told: Callable[[int], None] = lambda _: None,
) -> Row:
    """Build with workers of this machine, and tell how many renderings there are; what it took."""
    before, load = resource.getrusage(resource.RUSAGE_CHILDREN), os.getloadavg()[0]
    tiles: list[tuple[float, int]] = []

    def progress(done: int, _total: int) -> None:
        tiles.append((time.perf_counter(), done))
        told(done)

    started = time.perf_counter()
    with local_runner(workers) as runner:
        ready = time.perf_counter()
        rows = build_sharded(terrain, path, plan, RenderConfig(), runner, progress).rows
        ended = time.perf_counter()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    last, all_ = tiles[-1]
    # In the second half every worker has long been at work.
    half, held = next(tile for tile in tiles if 2 * tile[1] >= all_)
    return {
        "workers": workers,
        "renderings": rows,
        "start_s": ready - started,
        "first_tile_s": tiles[1][0] - ready,
        "build_s": last - ready,
        "merge_s": ended - last,
        "renderings_a_second": (all_ - held) / (last - half),
        "workers_cpu_s": sum(after[:2]) - sum(before[:2]),  # User and system time
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
            row = _build(terrain, path, plan, workers)
            rows.append({"case": "workers", "renderer_threads": threads, "round": turn, **row})
            del os.environ["LP_NUM_THREADS"]

    def speeds(workers: int, threads: int) -> NDArray[np.float64]:
        mine = [r for r in rows if (r["workers"], r["renderer_threads"]) == (workers, threads)]
        return np.array([r["renderings_a_second"] for r in mine])

    # The median over the rounds of how much faster two workers were.
    ratios = {
        "two_to_one_of_one_thread": float(np.median(speeds(2, 1) / speeds(1, 1))),
        f"two_to_one_of_{cores}_threads": float(np.median(speeds(2, 1) / speeds(1, cores))),
        "same_bytes": len({row["digest"] for row in rows}) == 1,
    }
    return [*rows, {"case": "workers, ratios"} | ratios]


def measure_killed(terrain: HeightField, folder: Path, quick: bool) -> list[Row]:
    """Kill one of two workers when half of the renderings are there."""
    plan = Layout(_spacing_m(quick), 5000.0, PART)
    unbroken = _build(terrain, folder / "unbroken.h5", plan, 2)
    half = unbroken["renderings"] // 2
    killed: list[BaseProcess] = []

    def kill(done: int) -> None:
        if done >= half and not killed:
            killed.append(multiprocessing.active_children()[0])
            killed[0].kill()

    row = _build(terrain, folder / "killed.h5", plan, 2, kill)
    same = row["digest"] == unbroken["digest"]
    return [
        {"case": "killed, unbroken", **unbroken},
        {"case": "killed", "killed": len(killed), "same_bytes": same, **row},
    ]


def measure_area(terrain: HeightField, folder: Path, quick: bool) -> list[Row]:
    """3,000 km2 at 500 m, four headings: built, merged, matched."""
    west, south, east, north = map_bounds(terrain, YOSEMITE)
    plan, path = Layout(_spacing_m(quick), 10_000.0, YOSEMITE), folder / "area.h5"
    built = _build(terrain, path, plan, 2)
    row = {
        "case": "area",
        "area_km2": (east - west) * (north - south) / 1e6,
        **built,
        "worker_peak_bytes": 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss,
        "bytes_a_rendering": path.stat().st_size / built["renderings"],
    }
    queries = make_queries(terrain, (west, south, east, north), QUERIES, seed=7)
    started = time.perf_counter()
    matcher = Matcher(path, terrain, "correlation")
    opened = time.perf_counter()
    found = [matcher.match(query.skyline) for query in queries]
    errors_m = [
        errors(result.candidates[0], query.truth)[0]
        for result, query in zip(found, queries, strict=True)
    ]
    matched = {
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

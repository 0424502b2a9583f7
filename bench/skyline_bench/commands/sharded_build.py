"""Sharded builds: python bench/sharded_build.py CALIFORNIA_DIR [--only workers killed area].

Measures, on the six 3 arc-second tiles of the High Sierra: two workers against one on the same
tiles, with a renderer of one thread and of as many as there are cores; a build one of whose
workers is killed half way; and 3,000 km2 at 500 m, built, merged and matched. Prints rows and
writes bench/results/sharded_build.json, in which a part that is not run keeps its rows.
"""

import argparse
import hashlib
import json
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from skyline.pipeline import Matcher, RenderConfig, ShardPlan, build_sharded, local_runner
from skyline.planning.uniform import map_bounds
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import write_record
from skyline_bench.queries.made import make_queries

RESULT = Path(__file__).parent / "results" / "sharded_build.json"
YOSEMITE = (-119.60, 37.45, -119.00, 37.962)
"""3,000 km2."""
PART = (-119.40, 37.70, -119.12, 37.92)
"""600 km2."""
QUERIES = 6

Row = dict[str, object]


class Clock:
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


def children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def peak_bytes(who: int) -> int:
    return 1024 * resource.getrusage(who).ru_maxrss


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]


def build(terrain: HeightField, path: Path, plan: ShardPlan, workers: int, clock: Clock) -> Row:
    """Build with workers of this machine; return what it took."""
    cpu_s, load = children_cpu_s(), os.getloadavg()[0]
    started = time.perf_counter()
    with local_runner(workers) as runner:
        ready = time.perf_counter()
        done = build_sharded(terrain, path, plan, RenderConfig(), runner, clock)
        ended = time.perf_counter()
    return {
        "workers": workers,
        "renderings": done.renderings,
        "start_s": ready - started,
        "first_tile_s": clock.first_tile - ready,
        "build_s": clock.last_tile - ready,
        "merge_s": ended - clock.last_tile,
        "renderings_a_second": clock.per_second,
        "workers_cpu_s": children_cpu_s() - cpu_s,
        "bytes": path.stat().st_size,
        "digest": digest(path),
        "load_average": load,
    }


def measure_workers(terrain: HeightField, folder: Path, rounds: int) -> list[Row]:
    """Two workers against one, in turn, since the machine may be busy with other things."""
    plan = ShardPlan(500.0, 5000.0, PART)
    rows: list[Row] = []
    cores = os.cpu_count() or 1
    for turn in range(rounds):
        for workers, threads in ((1, 1), (2, 1), (1, cores)):
            os.environ["LP_NUM_THREADS"] = str(threads)
            path = folder / f"{turn}_{workers}_{threads}.h5"
            row = build(terrain, path, plan, workers, Clock())
            rows.append({"case": "workers", "renderer_threads": threads, "round": turn} | row)
            say(rows[-1])
            del os.environ["LP_NUM_THREADS"]
    rows.append({"case": "workers, ratios"} | ratios(rows, cores))
    say(rows[-1])
    return rows


def ratios(rows: Sequence[Row], cores: int) -> Row:
    """Return how much faster two workers were, the median over the rounds."""

    def speeds(workers: int, threads: int) -> np.ndarray:
        return np.array(
            [
                row["renderings_a_second"]
                for row in rows
                if (row["workers"], row["renderer_threads"]) == (workers, threads)
            ]
        )

    two = speeds(2, 1)
    return {
        "two_to_one_of_one_thread": float(np.median(two / speeds(1, 1))),
        f"two_to_one_of_{cores}_threads": float(np.median(two / speeds(1, cores))),
        "same_bytes": len({row["digest"] for row in rows}) == 1,
    }


def measure_killed(terrain: HeightField, folder: Path) -> list[Row]:
    """Kill one of two workers when half of the renderings are there."""
    plan = ShardPlan(500.0, 5000.0, PART)
    unbroken = build(terrain, folder / "unbroken.h5", plan, 2, Clock())
    half = int(str(unbroken["renderings"])) // 2
    killed: list[int] = []

    def kill(done: int) -> None:
        if done >= half and not killed:
            worker = multiprocessing.active_children()[0]
            killed.append(worker.pid or 0)
            worker.kill()

    row = build(terrain, folder / "killed.h5", plan, 2, Clock(kill))
    same = row["digest"] == unbroken["digest"]
    rows = [{"case": "killed, unbroken"} | unbroken]
    rows.append({"case": "killed", "killed": len(killed), "same_bytes": same} | row)
    for each in rows:
        say(each)
    return rows


def measure_area(terrain: HeightField, folder: Path) -> list[Row]:
    """3,000 km2 at 500 m, four headings: built, merged, matched."""
    west, south, east, north = map_bounds(terrain, YOSEMITE)
    plan, path = ShardPlan(500.0, 10_000.0, YOSEMITE), folder / "area.h5"
    row = {"case": "area", "area_km2": (east - west) * (north - south) / 1e6}
    row |= build(terrain, path, plan, 2, Clock())
    row["worker_peak_bytes"] = peak_bytes(resource.RUSAGE_CHILDREN)
    row["bytes_a_rendering"] = path.stat().st_size / int(str(row["renderings"]))
    say(row)
    rows = [row]
    queries = make_queries(terrain, (west, south, east, north), QUERIES, seed=7)
    for name in ("correlation",):
        started = time.perf_counter()
        matcher = Matcher(path, terrain, name)
        opened = time.perf_counter()
        found = [matcher.match(query.skyline) for query in queries]
        errors_m = [
            np.hypot(
                result.candidates[0].easting_m - query.truth.easting_m,
                result.candidates[0].northing_m - query.truth.northing_m,
            )
            for result, query in zip(found, queries, strict=True)
        ]
        rows.append(
            {
                "case": "area, matched",
                "matcher": name,
                "queries": len(queries),
                "locations": len(matcher.viewpoints),
                "open_s": opened - started,
                "query_s": float(np.median([result.seconds for result in found])),
                "within_1_km": float(np.mean(np.array(errors_m) < 1000.0)),
                "peak_bytes": peak_bytes(resource.RUSAGE_SELF),
            }
        )
        say(rows[-1])
    return rows


PARTS = ("workers", "killed", "area")


def say(row: Row) -> None:
    shown = (f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
             for key, value in row.items())  # fmt: skip
    print(", ".join(shown), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("california", type=Path, help="folder of the six .hgt.gz tiles")
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--rounds", type=int, default=3, help="of two workers against one")
    options = parser.parse_args()
    parts = {
        "workers": partial(measure_workers, rounds=options.rounds),
        "killed": measure_killed,
        "area": measure_area,
    }
    rows = json.loads(RESULT.read_text())["rows"] if RESULT.exists() else []
    terrain = read_dem(sorted(options.california.glob("N*.hgt.gz")))
    for part in options.only:
        with tempfile.TemporaryDirectory() as folder:
            fresh = parts[part](terrain, Path(folder))
        rows = [row for row in rows if not str(row["case"]).startswith(part)] + fresh
        write_record(RESULT, "sharded-build", rows)
    print(f"written to {RESULT}")


if __name__ == "__main__":
    main()

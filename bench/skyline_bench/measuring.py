"""Measuring: times and memory of rival programs, the machine, and the record of a benchmark.

Each program has all cores and a warm-up, and they take turns.
"""

import datetime
import json
import math
import os
import platform
import re
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skyline import __version__
from skyline.build.plans import uniform_grid
from skyline.errors import ContextError
from skyline.files import write_whole
from skyline.render.context import acquire_context
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

Row = Mapping[str, Any]
"""One line of a benchmark's table: plain values by name."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Timing:
    """Medians over the repeats of one piece of work."""

    seconds: float  # Wall-clock time
    cpu_seconds: float  # Processor time of the whole process, all its threads


def core_count() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def central_viewpoints(terrain: HeightField, count: int, spacing_m: float) -> Viewpoints:
    """Return up to ``count`` viewpoints of a uniform grid, a square in the middle of a DEM."""
    side = int(np.ceil(np.sqrt(count)))
    west, south, east, north = terrain.bounds_m
    half_m = (side - 0.5) / 2.0 * spacing_m
    # Half a step over from a multiple of the spacing, an even number of them is in the middle.
    easting, northing = (
        (np.floor(middle / spacing_m) + (0.0 if side % 2 else 0.5)) * spacing_m
        for middle in ((west + east) / 2.0, (south + north) / 2.0)
    )
    bounds = (easting - half_m, northing - half_m, easting + half_m, northing + half_m)
    return uniform_grid(terrain, spacing_m, bounds)[:count]


def over_cores(
    work: Callable[[Viewpoints], Result], viewpoints: Viewpoints, viewpoints_a_call: int
) -> list[Result]:
    """Share viewpoints out among as many threads as there are cores; results in order."""
    parts = [
        viewpoints[start : start + viewpoints_a_call]
        for start in range(0, len(viewpoints), viewpoints_a_call)
    ]
    with ThreadPoolExecutor(core_count()) as pool:
        return list(pool.map(work, parts))


def in_turns(
    works: Sequence[Callable[[], object]], repeats: int, tick: Callable[[], object] = lambda: None
) -> list[Timing]:
    """Time each piece of work, in turns so that what else the machine does hits all alike.

    Everything runs once before the first of ``repeats`` timed rounds; ``tick`` is called after
    each run, outside the time.
    """
    rounds = [[_timed(work, tick) for work in works] for _ in range(repeats + 1)]
    medians = np.median(np.array(rounds[1:]).reshape(repeats, len(works), 2), axis=0)
    return [Timing(float(wall), float(cpu)) for wall, cpu in medians]


def _timed(work: Callable[[], object], tick: Callable[[], object]) -> tuple[float, float]:
    wall, cpu = time.perf_counter(), time.process_time()
    work()
    taken = time.perf_counter() - wall, time.process_time() - cpu
    tick()
    return taken


def peak_bytes() -> int | None:
    """Return the greatest resident memory of this process so far; None where unknown.

    Pages of mapped files count, which the system may drop when it needs them.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return None
    found = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    return 1024 * int(found[1]) if found else None


def machine() -> dict[str, object]:
    """Describe this machine and the software that matters to a measurement on it."""
    try:
        context = acquire_context()
        renderer, driver = context.renderer, context.version
    except ContextError:
        renderer = driver = "none"
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": core_count(),
        "os": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "renderer": renderer,
        "driver": driver,
        "skyline": __version__,
    }


def write_record(
    path: Path | None,
    bench: str,
    rows: Sequence[Row],
    summary: Mapping[str, Sequence[Row]] | None = None,
) -> None:
    """Write rows and the machine they come from as JSON, whole or not at all, to a path if any.

    Numbers that are not finite, for which JSON has no word, are written as null. A summary, which
    follows from the rows, is tables by name.
    """
    if path is None:
        return
    record: dict[str, object] = {"bench": bench, "machine": machine(), "rows": _plain(rows)}
    if summary:
        record["summary"] = {name: _plain(table) for name, table in summary.items()}
    write_whole(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def shown(value: object) -> str:
    """Return a value as tables show it: three digits, or all before the point."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)


def _plain(rows: Sequence[Row]) -> list[Row]:
    def plain(value: object) -> object:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return [{key: plain(value) for key, value in row.items()} for row in rows]


def _processor() -> str:
    """Return the processor's model name where the system gives it, else its architecture."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, [*names, platform.processor()]), platform.machine())

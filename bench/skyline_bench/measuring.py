"""Measuring times, memory and areas, and showing values.

Rival programs are timed alike. Each program has all cores and a warm-up, and they take turns.
"""

import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from skyline.geodesy.map_frame import Rectangle
from skyline.survey.plans import uniform_grid
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

Row = Mapping[str, Any]
"""One line of a benchmark's table: plain values by name."""

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Timing:
    """The time of a piece of work.

    If the work was repeated, it is the median of the repeats.
    """

    seconds: float  # Wall-clock time
    cpu_seconds: float  # Processor time of the whole process, all its threads

    @classmethod
    def median_of(cls, timings: Sequence["Timing"]) -> "Timing":
        """Return the medians of the times of some repeats."""
        wall, cpu = np.median([(one.seconds, one.cpu_seconds) for one in timings], axis=0)
        return cls(float(wall), float(cpu))


def core_count() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def square_km(bounds_m: Rectangle) -> float:
    """Return the area of a rectangle: west, south, east, north in metres."""
    west, south, east, north = bounds_m
    return (east - west) * (north - south) / 1e6


def middle_of(bounds_m: Rectangle, size_m: tuple[float, float]) -> Rectangle:
    """Return the middle part of a rectangle, up to a size: across, along."""
    west, south, east, north = bounds_m
    half_east, half_north = min(size_m[0], east - west) / 2.0, min(size_m[1], north - south) / 2.0
    easting, northing = (west + east) / 2.0, (south + north) / 2.0
    return easting - half_east, northing - half_north, easting + half_east, northing + half_north


def window_of(apart_m: float, *spacings_m: float) -> list[int]:
    """Return the samples of a window that reaches ``apart_m`` to either side."""
    return [2 * round(apart_m / step) + 1 for step in spacings_m]


def central_viewpoints(terrain: HeightField, count: int, spacing_m: float) -> Viewpoints:
    """Return up to ``count`` viewpoints on a grid in a DEM's middle."""
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
    """Share viewpoints out among all cores; return the results in order."""
    parts = [
        viewpoints[start : start + viewpoints_a_call]
        for start in range(0, len(viewpoints), viewpoints_a_call)
    ]
    with ThreadPoolExecutor(core_count()) as pool:
        return list(pool.map(work, parts))


def in_turns(
    works: Sequence[Callable[[], object]], repeats: int, tick: Callable[[], object] = lambda: None
) -> list[Timing]:
    """Time each piece of work, in turns.

    So whatever else the machine does affects all alike.

    Everything runs once before the first of ``repeats`` timed rounds; ``tick`` is called after
    each run, outside the time.
    """
    rounds = [[_ticked(work, tick) for work in works] for _ in range(repeats + 1)]
    return [Timing.median_of(timings) for timings in zip(*rounds[1:], strict=True)]


def timed(work: Callable[[], Result]) -> tuple[Result, Timing]:
    """Do a piece of work; return its result and its time."""
    wall = time.perf_counter()
    cpu = time.process_time()
    result = work()
    return result, Timing(time.perf_counter() - wall, time.process_time() - cpu)


def _ticked(work: Callable[[], object], tick: Callable[[], object]) -> Timing:
    """Return the time of a piece of work; tick after it."""
    _, timing = timed(work)
    tick()
    return timing


def peak_bytes() -> int | None:
    """Return the greatest resident memory of this process so far.

    Returns None if unknown. Pages of mapped files count, which the system may drop when it needs
    memory.
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return None
    found = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    return 1024 * int(found[1]) if found else None


def shown(value: object) -> str:
    """Return a value as tables show it.

    A number has three digits, or all digits before the point. Counts by name are listed.
    """
    if value is None or value == {}:
        return "-"
    if isinstance(value, Mapping):
        return ", ".join(f"{count} {name}" for name, count in value.items())
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)

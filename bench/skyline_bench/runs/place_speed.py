"""Skylines all the way round against four headings: milliseconds an eye, taken in turns.

Eyes are a grid 80 m apart in the DEM's middle. Every round renders all of them in every way, so
that ratios hold however busy the machine is.
"""

import time
from collections.abc import Callable

import numpy as np

from skyline.places import BINS, Places
from skyline.render.horizon import HorizonRenderer
from skyline.render.panorama import PanoramaRenderer
from skyline.terrain.heightfield import HeightField
from skyline_bench.runs.speed_error import central_viewpoints

SPACING_M = 80.0
ROUNDS = 5
REFERENCE = "four headings of 640 columns, 0.05 px"


def measure(terrain: HeightField, count: int) -> list[dict[str, object]]:
    """Return milliseconds an eye, of ``count`` eyes, for each way to render them."""
    eyes = central_viewpoints(terrain, count, SPACING_M)
    with (
        HorizonRenderer(terrain, 640, tolerance_px=0.05) as headings,
        PanoramaRenderer(terrain, 720) as fine,
        PanoramaRenderer(terrain, BINS) as places,
    ):
        ways: dict[str, Callable[[], object]] = {
            REFERENCE: lambda: headings.render(eyes),
            "720 azimuths": lambda: fine.render(eyes),
            f"{BINS} azimuths": lambda: places.render(eyes),
            f"{BINS} azimuths, coded as places": lambda: Places.of(places.render(eyes), SPACING_M),
        }
        for work in ways.values():
            work()
        seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
        for _ in range(ROUNDS):
            for name, work in ways.items():
                wall, cpu = time.perf_counter(), time.process_time()
                work()
                seconds[name].append((time.perf_counter() - wall, time.process_time() - cpu))
    taken = {name: np.array(values) / len(eyes) for name, values in seconds.items()}
    rows: list[dict[str, object]] = []
    for name, each in taken.items():
        wall_ms, cpu_ms = 1e3 * np.median(each, axis=0)
        wall_ratio, cpu_ratio = np.median(taken[REFERENCE] / each, axis=0)
        rows.append(
            {
                "way": name,
                "eyes": len(eyes),
                "wall_ms": float(wall_ms),
                "cpu_ms": float(cpu_ms),
                "times_the_reference_wall": float(wall_ratio),
                "times_the_reference_cpu": float(cpu_ratio),
            }
        )
    return rows

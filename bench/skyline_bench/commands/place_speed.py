"""Skylines all the way round against four headings: milliseconds an eye, taken in turns.

Run as ``python bench/place_speed.py DEM... [--eyes N]`` (a minute); writes place_speed.json to
bench/results. Eyes are a grid 80 m apart in the DEM's middle. Every round renders all of them in
every way, so that ratios hold however busy the machine is.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from skyline import read_dem
from skyline.places import BINS, Places
from skyline.render.horizon import HorizonRenderer
from skyline.render.panorama import PanoramaRenderer
from skyline_bench.measuring.record import write_record
from skyline_bench.runs.speed_error import central_viewpoints

RESULT = Path(__file__).parent / "results" / "place_speed.json"
SPACING_M = 80.0
ROUNDS = 5
REFERENCE = "four headings of 640 columns, 0.05 px"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dem", nargs="+", type=Path)
    parser.add_argument("--eyes", type=int, default=2000)
    given = parser.parse_args()
    terrain = read_dem(given.dem)
    eyes = central_viewpoints(terrain, given.eyes, SPACING_M)
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
        print(rows[-1])
    write_record(RESULT, "place-speed", rows)


if __name__ == "__main__":
    main()

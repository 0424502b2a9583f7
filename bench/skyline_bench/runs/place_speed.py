"""Skylines all the way round against four headings: milliseconds an eye, taken in turns.

Eyes are a grid 80 m apart in the DEM's middle. Every round renders all of them in every way, so
that ratios hold however busy the machine is.
"""

from collections.abc import Callable

from skyline.places import BINS, Places
from skyline.render.horizon import HorizonRenderer
from skyline.render.panorama import PanoramaRenderer
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import in_turns
from skyline_bench.runs.speed_error import central_viewpoints

SPACING_M = 80.0
ROUNDS = 5


def measure(terrain: HeightField, count: int) -> list[Row]:
    """Return milliseconds an eye, of ``count`` eyes, for each way to render them."""
    eyes = central_viewpoints(terrain, count, SPACING_M)
    with (
        HorizonRenderer(terrain, 640, tolerance_px=0.05) as headings,
        PanoramaRenderer(terrain, 720) as fine,
        PanoramaRenderer(terrain, BINS) as places,
    ):
        ways: dict[str, Callable[[], object]] = {
            "four headings of 640 columns, 0.05 px": lambda: headings.render(eyes),
            "720 azimuths": lambda: fine.render(eyes),
            f"{BINS} azimuths": lambda: places.render(eyes),
            f"{BINS} azimuths, coded as places": lambda: Places.of(places.render(eyes), SPACING_M),
        }
        timings = in_turns(list(ways.values()), ROUNDS)
    return [
        {
            "way": name,
            "eyes": len(eyes),
            "wall_ms": 1e3 * one.seconds / len(eyes),
            "cpu_ms": 1e3 * one.cpu_seconds / len(eyes),
            "times_the_reference_wall": timings[0].seconds / one.seconds,
            "times_the_reference_cpu": timings[0].cpu_seconds / one.cpu_seconds,
        }
        for name, one in zip(ways, timings, strict=True)
    ]

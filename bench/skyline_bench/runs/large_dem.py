"""Rendering over a very large DEM: seconds, and the greatest resident memory."""

import time

import numpy as np

from skyline.geodesy import Frame
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.cases.closed_forms import fractal
from skyline_bench.measuring.memory import peak_bytes
from skyline_bench.measuring.record import Row

SPACING_M = 30.0
PERIOD = 2000


def measure(samples: int, viewpoints: int) -> Row:
    """Render from some viewpoints about the middle of ``samples`` x ``samples`` heights."""
    # Rough terrain that repeats every 60 km, in one array and no copies.
    tile = (1500.0 + 1500.0 * fractal(PERIOD, PERIOD, 1, 2.1)).astype(np.float32)
    heights = np.empty((samples, samples), dtype=np.float32)
    for row in range(0, samples, PERIOD):
        for col in range(0, samples, PERIOD):
            part = heights[row : row + PERIOD, col : col + PERIOD]
            part[:] = tile[: part.shape[0], : part.shape[1]]
    heights.setflags(write=False)
    field = HeightField(heights, 0.0, 0.0, SPACING_M, SPACING_M, Frame.local(10.0, 46.0))
    middle = samples * SPACING_M / 2.0
    place = np.random.default_rng(2).uniform(-5000.0, 5000.0, (2, viewpoints))
    eyes = stand_on(field, middle + place[0], -middle + place[1])
    with HorizonRenderer(field) as renderer:
        started = time.perf_counter()
        views = renderer.render(eyes)
        seconds = time.perf_counter() - started
    return {
        "samples": samples,
        "viewpoints": viewpoints,
        "seconds": seconds,
        "median_depth_m": float(np.nanmedian(views.depth_m)),
        "greatest_depth_m": float(np.nanmax(views.depth_m)),
        "dem_bytes": field.heights_m.nbytes,
        "peak_resident_bytes": peak_bytes(),
    }

"""Render over a DEM of 20,000 x 20,000 samples: python bench/large_dem.py [--samples N].

Prints and writes bench/results/large_dem.json: seconds, the windows that were needed, and the
greatest resident memory, which must stay under 4 GiB.
"""

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np

from skyline.geodesy import Frame
from skyline.render.horizon import HorizonRenderer
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.measuring.record import write_record

RESULT = Path(__file__).parent / "results" / "large_dem.json"
SPACING_M = 30.0
PERIOD = 2000


def make_field(samples: int) -> HeightField:
    """Return rough terrain that repeats every 60 km, in one array and no copies."""
    frequency = np.hypot(np.fft.fftfreq(PERIOD)[:, np.newaxis], np.fft.rfftfreq(PERIOD))
    frequency[0, 0] = np.inf
    random = np.random.default_rng(1)
    spectrum = random.normal(size=frequency.shape) + 1j * random.normal(size=frequency.shape)
    tile = np.fft.irfft2(spectrum * frequency**-2.1)
    tile = (1500.0 + 1500.0 * tile / np.abs(tile).max()).astype(np.float32)
    heights = np.empty((samples, samples), dtype=np.float32)
    for row in range(0, samples, PERIOD):
        for col in range(0, samples, PERIOD):
            part = heights[row : row + PERIOD, col : col + PERIOD]
            part[:] = tile[: part.shape[0], : part.shape[1]]
    heights.setflags(write=False)
    return HeightField(heights, 0.0, 0.0, SPACING_M, SPACING_M, Frame.local(10.0, 46.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=20_000)
    parser.add_argument("--viewpoints", type=int, default=256)
    options = parser.parse_args()
    field = make_field(options.samples)
    middle = options.samples * SPACING_M / 2.0
    place = np.random.default_rng(2).uniform(-5000.0, 5000.0, (2, options.viewpoints))
    eyes = stand_on(field, middle + place[0], -middle + place[1])
    row: dict[str, object] = {"samples": options.samples, "viewpoints": options.viewpoints}
    with HorizonRenderer(field) as renderer:
        started = time.perf_counter()
        views = renderer.render(eyes)
        row["seconds"] = time.perf_counter() - started
        row["median_depth_m"] = float(np.nanmedian(views.depth_m))
        row["greatest_depth_m"] = float(np.nanmax(views.depth_m))
    row["dem_bytes"] = field.heights_m.nbytes
    row["peak_resident_bytes"] = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    write_record(RESULT, "large-dem", [row])
    print(json.dumps(row, indent=1))


if __name__ == "__main__":
    main()

"""Time the pipeline stage by stage on the demo's DEM: python bench/pipeline_speed.py.

Prints a table and writes bench/results/pipeline_speed.json with machine, driver and date. Times
on shared machines wander: compare stages of one run, not runs.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "examples"))

from demo import BOUNDS_DEG, take_pictures, write_dem

from skyline.features import polyline_keypoints
from skyline.matching import MATCHERS
from skyline.photo import read_query
from skyline.pipeline import Matcher, build_uniform
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.depth import DepthRenderer
from skyline.terrain.dem import read_dem
from skyline_bench.measuring.record import write_record
from skyline_bench.truth import oracle

RESULT = Path(__file__).parent / "results" / "pipeline_speed.json"


def timed(work: Callable[[], object], repeats: int) -> float:
    """Return the median seconds of some runs after one that warms up."""
    work()
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def measure(folder: Path) -> list[dict[str, object]]:
    """Return one row a stage."""
    rows: list[dict[str, object]] = []

    def row(stage: str, seconds: float, count: int, unit: str) -> None:
        rows.append({"stage": stage, "ms_each": 1e3 * seconds / count, "of": unit})
        print(f"{stage:<32} {1e3 * seconds / count:10.3f} ms a {unit}", flush=True)

    dem = write_dem(folder / "dem.tif")
    row("read and warp DEM", timed(lambda: read_dem([dem]), 3), 1, "DEM")
    terrain = read_dem([dem])
    eyes = uniform_grid(terrain, 1000.0, map_bounds(terrain, BOUNDS_DEG))[:16]
    for width in (160, 640, 1280):
        with DepthRenderer(terrain, width) as renderer:
            seconds = timed(lambda: renderer.render(eyes), 3)
        row(f"depth path, W = {width}", seconds, len(eyes), "viewpoint")
    row("oracle, W = 640", timed(lambda: oracle.skyline(terrain, eyes[:4]), 1), 4, "viewpoint")
    with DepthRenderer(terrain) as renderer:
        views = renderer.render(eyes)
    row("keypoints", timed(lambda: polyline_keypoints(views, 1.0), 3), len(views), "view")
    store = folder / "store.h5"
    build_uniform(terrain, store, 500.0, BOUNDS_DEG)
    query = take_pictures(terrain, folder / "queries")[0].path
    row("photo to skyline", timed(lambda: read_query(query), 3), 1, "photo")
    for name in MATCHERS:
        matcher = Matcher(store, matcher=name)
        seconds = timed(partial(matcher.match, query), 3)
        row(f"match, {name}", seconds, len(matcher.viewpoints), "stored location")
    return rows


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        rows = measure(Path(folder))
    RESULT.parent.mkdir(exist_ok=True)
    write_record(RESULT, "pipeline-speed", rows)
    print(f"written to {RESULT}")


if __name__ == "__main__":
    main()

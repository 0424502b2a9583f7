"""The pipeline timed stage by stage, on a small DEM that is always at hand.

Times on shared machines wander: compare stages of one run, not runs.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from PIL import Image

from skyline.features import polyline_keypoints
from skyline.photo.read import read_query
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import MATCHERS
from skyline.pipeline.places import build_places, build_uniform
from skyline.planning.uniform import map_bounds, uniform_grid
from skyline.render.depth import DepthRenderer
from skyline.store.header import PLACES, RENDERINGS
from skyline.terrain.dem import read_dem
from skyline_bench.measuring.geotiff import write_sample_dem
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import in_turns
from skyline_bench.queries.photographs import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.truth import oracle

BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
SPACING_M = 500.0
CAMERA = Camera(140.0, fov_deg=60.0)


def measure(folder: Path, repeats: int) -> list[Row]:
    """Return one row a stage, the median of some repeats; files go to a folder."""
    rows: list[Row] = []

    def time(stage: str, work: Callable[[], object], count: int, unit: str, n: int) -> None:
        seconds = in_turns([work], n)[0].seconds
        rows.append({"stage": stage, "ms_each": 1e3 * seconds / count, "of": unit})

    dem = write_sample_dem(folder / "dem.tif")
    time("read and warp DEM", lambda: read_dem([dem]), 1, "DEM", repeats)
    terrain = read_dem([dem])
    eyes = uniform_grid(terrain, 1000.0, map_bounds(terrain, BOUNDS_DEG))[:16]
    for width in (160, 640, 1280):
        with DepthRenderer(terrain, width) as renderer:
            work = partial(renderer.render, eyes)
            time(f"depth path, W = {width}", work, len(eyes), "viewpoint", repeats)
    time("oracle, W = 640", lambda: oracle.skyline(terrain, eyes[:4]), 4, "viewpoint", 1)
    with DepthRenderer(terrain) as renderer:
        views = renderer.render(eyes)
    time("keypoints", lambda: polyline_keypoints(views, 1.0), len(views), "view", repeats)
    stores = {RENDERINGS: folder / "renderings.h5", PLACES: folder / "places.h5"}
    build_uniform(terrain, stores[RENDERINGS], SPACING_M, BOUNDS_DEG)
    build_places(terrain, stores[PLACES], SPACING_M, BOUNDS_DEG)
    query = folder / "query.jpg"
    with DepthRenderer(terrain, 2048) as renderer:
        Image.fromarray(photograph(renderer, eyes, 0, CAMERA, seed=1)).save(query, quality=92)
    time("photo to skyline", lambda: read_query(query, CAMERA.fov_deg), 1, "photo", repeats)
    for name, kind in MATCHERS.items():
        with Matcher(stores[kind.searches], terrain, name) as matcher:
            match = partial(matcher.match, query, CAMERA.fov_deg)
            time(f"match, {name}", match, len(matcher.viewpoints), "stored location", repeats)
    return rows

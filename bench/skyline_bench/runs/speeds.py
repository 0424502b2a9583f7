"""How fast: skylines all the way round, a very large DEM, and the pipeline stage by stage.

Times on shared machines wander: compare what was timed in turns, and stages of one run.
"""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image

from skyline.build.grid import map_bounds, uniform_grid
from skyline.build.parts import build_places, build_uniform
from skyline.features import polyline_keypoints
from skyline.geodesy import Frame
from skyline.photo.read import read_query
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import MATCHERS
from skyline.places import BINS, Places
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.render.panorama import PanoramaRenderer
from skyline.store.format import PLACES, RENDERINGS
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.cases.closed_forms import fractal
from skyline_bench.measuring.geotiff import write_sample_dem
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import in_turns, peak_bytes
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.runs.speed_error import central_viewpoints
from skyline_bench.truth import oracle

_PLACES_M, _ROUNDS = 80.0, 5
_SAMPLES_M, _PERIOD = 30.0, 2000
_BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
_STORES_M = 500.0
_CAMERA = Camera(140.0, fov_deg=60.0)


def place_speed(terrain: HeightField, count: int) -> list[Row]:
    """Return milliseconds an eye, of ``count`` eyes 80 m apart, for each way to render them.

    Every round renders all of them in every way, so that ratios hold however busy the machine is.
    """
    eyes = central_viewpoints(terrain, count, _PLACES_M)
    with (
        HorizonRenderer(terrain, 640, tolerance_px=0.05) as headings,
        PanoramaRenderer(terrain, 720) as fine,
        PanoramaRenderer(terrain, BINS) as places,
    ):
        ways: dict[str, Callable[[], object]] = {
            "four headings of 640 columns, 0.05 px": lambda: headings.render(eyes),
            "720 azimuths": lambda: fine.render(eyes),
            f"{BINS} azimuths": lambda: places.render(eyes),
            f"{BINS} azimuths, coded as places": lambda: Places.of(places.render(eyes), _PLACES_M),
        }
        timings = in_turns(list(ways.values()), _ROUNDS)
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


def large_dem(samples: int, viewpoints: int) -> Row:
    """Render from some viewpoints about the middle of ``samples`` x ``samples`` heights."""
    # Rough terrain that repeats every 60 km, in one array and no copies.
    tile = (1500.0 + 1500.0 * fractal(_PERIOD, _PERIOD, 1, 2.1)).astype(np.float32)
    again = np.arange(samples) % _PERIOD
    heights = tile[np.ix_(again, again)]
    heights.setflags(write=False)
    field = HeightField(heights, 0.0, 0.0, _SAMPLES_M, _SAMPLES_M, Frame.local(lon=10.0, lat=46.0))
    middle = samples * _SAMPLES_M / 2.0
    place = np.random.default_rng(2).uniform(-5000.0, 5000.0, (2, viewpoints))
    eyes = stand_on(field, easting_m=middle + place[0], northing_m=-middle + place[1])
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


def pipeline_speed(folder: Path, repeats: int) -> list[Row]:
    """Return one row a stage, the median of some repeats; files go to a folder."""
    rows: list[Row] = []

    def timed(stage: str, work: Callable[[], object], count: int, unit: str, n: int) -> None:
        seconds = in_turns([work], n)[0].seconds
        rows.append({"stage": stage, "ms_each": 1e3 * seconds / count, "of": unit})

    dem = write_sample_dem(folder / "dem.tif")
    timed("read and warp DEM", lambda: read_dem([dem]), 1, "DEM", repeats)
    terrain = read_dem([dem])
    eyes = uniform_grid(terrain, 1000.0, map_bounds(terrain, _BOUNDS_DEG))[:16]
    for width in (160, 640, 1280):
        with DepthRenderer(terrain, width) as renderer:
            work = partial(renderer.render, eyes)
            timed(f"depth path, W = {width}", work, len(eyes), "viewpoint", repeats)
    timed("oracle, W = 640", lambda: oracle.skyline(terrain, eyes[:4]), 4, "viewpoint", 1)
    with DepthRenderer(terrain) as renderer:
        views = renderer.render(eyes)
    timed("keypoints", lambda: polyline_keypoints(views, 1.0), len(views), "view", repeats)
    stores = {RENDERINGS: folder / "renderings.h5", PLACES: folder / "places.h5"}
    build_uniform(terrain, stores[RENDERINGS], _STORES_M, _BOUNDS_DEG)
    build_places(terrain, stores[PLACES], _STORES_M, _BOUNDS_DEG)
    query = folder / "query.jpg"
    with DepthRenderer(terrain, 2048) as renderer:
        Image.fromarray(photograph(renderer, eyes, 0, _CAMERA, seed=1)).save(query, quality=92)
    timed("photo to skyline", lambda: read_query(query, _CAMERA.fov_deg), 1, "photo", repeats)
    for name, kind in MATCHERS.items():
        with Matcher(stores[kind.searches], terrain, name) as matcher:
            match = partial(matcher.match, query, _CAMERA.fov_deg)
            timed(f"match, {name}", match, len(matcher.viewpoints), "stored location", repeats)
    return rows

"""Terrain whose heights are made where someone looks gives what terrain read whole gives."""

from dataclasses import replace

import numpy as np
import pytest
from pyproj import CRS
from scenes import fractal, scattered

from skyline import Matcher, build_places
from skyline.geodesy.map_frame import Frame
from skyline.render.field_windows import GpuLimits
from skyline.render.horizon import PanoramaRenderer
from skyline.terrain.field_files import read_field, save_dem
from skyline.terrain.grid import Grid
from skyline.terrain.heightfield import field_of
from skyline.terrain.metric_dem import MetricDem, WarpSource
from skyline.terrain.provenance import Provenance
from skyline.terrain.resampling import Warp
from skyline.terrain.summits import highest_within, summit_heights_m
from skyline_bench.queries.synthetic import QueryConfig, make_queries

STEP_DEG = 1.0 / 1200.0
ROWS = 220
COLS = 330


def lazy_dem(seed):
    """Return a model of rough ground in degrees with holes, of which no sample is made yet."""
    rng = np.random.default_rng(seed)
    heights_m = fractal(ROWS, COLS, 1500.0, seed=seed).astype(np.float32)
    for top, left in rng.integers(0, [ROWS - 12, COLS - 12], (10, 2)):
        heights_m[top : top + 12, left : left + 12] = np.nan
    heights_m[:30, :50] = np.nan
    grid = Grid(9.0, 47.0, STEP_DEG, STEP_DEG, ROWS, COLS)
    frame = Frame.local(lon=grid.centre[0], lat=grid.centre[1])
    source = WarpSource(heights_m, Warp(grid, CRS.from_epsg(4326), frame, 60.0))
    return MetricDem(source.in_memory(), source.warp.target, frame, Provenance(), source)


def whole_field(seed):
    field = field_of(lazy_dem(seed))
    return replace(field, heights_m=field.heights_m)


@pytest.fixture(params=["memory", "file"])
def lazy_field(request, tmp_path):
    """Return a function that makes a lazy field of a seed, in memory or in a file."""

    def make(seed):
        dem = lazy_dem(seed)
        if request.param == "memory":
            return field_of(dem)
        path = tmp_path / f"{seed}.terrain"
        save_dem(dem, path)
        return read_field(path)

    return make


def rendered(field, eyes, limits):
    with PanoramaRenderer(field, 360, limits=limits) as renderer:
        return renderer.render(eyes)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cells", [5120, 60])
def test_horizons_are_equal_to_the_bit(lazy_field, seed, cells):
    """With 60 cells a window, most windows are ruled out by the bounds of their heights."""
    whole = whole_field(seed)
    eyes = scattered(whole, 8, seed)
    limits = GpuLimits(field_cells=cells, window_cells=cells)
    expected = rendered(whole, eyes, limits)
    for some in (slice(3), slice(None)):
        found = rendered(lazy_field(seed), eyes[some], limits)
        for name in ("elevation_tan", "distance_m", "flags"):
            assert getattr(found, name).tobytes() == getattr(expected[some], name).tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_summits_are_equal_to_the_bit(lazy_field, seed):
    whole = whole_field(seed)
    west, south, east, north = whole.bounds_m
    rng = np.random.default_rng(seed)
    easting_m, northing_m = rng.uniform([[west], [south]], [[east], [north]], (2, 300))
    lazy = lazy_field(seed)
    np.testing.assert_array_equal(
        summit_heights_m(lazy, easting_m, northing_m),
        summit_heights_m(whole, easting_m, northing_m),
    )
    for at in zip(easting_m[:40], northing_m[:40], strict=True):
        assert highest_within(lazy, *at, 500.0) == highest_within(whole, *at, 500.0)


def test_stores_and_answers_are_equal(lazy_field, tmp_path):
    whole = whole_field(7)
    west, south, east, north = whole.bounds_m
    middle = (0.7 * west + 0.3 * east, 0.7 * south + 0.3 * north)
    box_m = (*middle, middle[0] + 1500.0, middle[1] + 1500.0)
    lon, lat = whole.frame.to_lonlat(box_m[::2], box_m[1::2])
    box_deg = (lon[0], lat[0], lon[1], lat[1])
    queries = make_queries(whole, box_m, 2, seed=3, config=QueryConfig())
    stores = []
    answers = []
    for name, field in (("whole", whole), ("lazy", lazy_field(7))):
        path = tmp_path / f"{name}.h5"
        build_places(field, path, 150.0, box_deg)
        stores.append(path.read_bytes())
        with Matcher(path, field) as matcher:
            answers.append([repr(matcher.match(one.skyline).candidates) for one in queries])
    assert stores[0] == stores[1]
    assert answers[0] == answers[1]
    assert "()" not in answers[0]

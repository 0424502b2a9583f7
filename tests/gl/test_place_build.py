"""Builds of places: what is stored is what was rendered, however the build was cut and broken."""

from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from scenes import fractal, write_dem

from skyline import RenderConfig, build_uniform, read_dem, stand_on
from skyline.errors import InputError, StoreMismatchError
from skyline.pipeline import row_renderers
from skyline.pipeline.build import build_places
from skyline.pipeline.cluster import remote_runner
from skyline.pipeline.config import PlaceConfig
from skyline.pipeline.layout import Layout
from skyline.pipeline.shards import build_sharded
from skyline.places import BINS, Places
from skyline.planning.uniform import uniform_grid
from skyline.render.panorama import PanoramaRenderer
from skyline.store import check_store, compact_store, open_store

SPACING_M = 55.0
LOSS = 0.3


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, fractal(70, 80, 250.0, seed=11))])


@pytest.fixture(scope="module")
def built(terrain, tmp_path_factory):
    path = tmp_path_factory.mktemp("built") / "places.h5"
    return path, build_places(terrain, path, SPACING_M)


def test_places_are_what_was_rendered(terrain, built):
    path, done = built
    grid = uniform_grid(terrain, SPACING_M)
    assert done.rows == done.rendered == len(grid) > 1024
    with PanoramaRenderer(terrain, BINS) as renderer:
        wanted = Places.of(renderer.render(grid), SPACING_M / 2.0)
    with open_store(path) as store:
        mapped = store.places()
        assert store.header.config["spacing_m"] == SPACING_M
        assert store.header.config["rasterizer"] == "panorama"
    stored = Places.concatenate(list(mapped.blocks()))
    for field in fields(Places):
        np.testing.assert_array_equal(getattr(stored, field.name), getattr(wanted, field.name))
    assert check_store(path).whole


def test_an_interrupted_build_goes_on(terrain, built, tmp_path, monkeypatch):
    path = tmp_path / "s.h5"
    monkeypatch.setattr(row_renderers, "PLACES_AT_A_TIME", 500)

    def stop(done, _total):
        if done >= 1000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_places(terrain, path, SPACING_M, progress=stop)
    again = build_places(terrain, path, SPACING_M)
    assert 0 < again.rendered < again.rows == built[1].rows
    compact_store(path, tmp_path / "resumed.h5")
    compact_store(built[0], tmp_path / "whole.h5")
    assert (tmp_path / "resumed.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()
    assert build_places(terrain, path, SPACING_M).rendered == 0


def test_tiles_leave_no_trace(terrain, built, tmp_path):
    compact_store(built[0], tmp_path / "whole.h5")
    path, plan = tmp_path / "tiles.h5", Layout(SPACING_M, 900.0)
    done = build_sharded(terrain, path, plan, PlaceConfig())
    assert done.rows == done.rendered == built[1].rows
    assert path.read_bytes() == (tmp_path / "whole.h5").read_bytes()
    assert build_sharded(terrain, path, plan, PlaceConfig()).rendered == 0
    with pytest.raises(StoreMismatchError, match="what it holds is 'places' there, 'renderings'"):
        build_sharded(terrain, path, plan, RenderConfig(width=80))


def test_workers_make_the_same_bytes(terrain, built, dask_cluster, tmp_path):
    compact_store(built[0], tmp_path / "whole.h5")
    with remote_runner(dask_cluster.scheduler_address) as runner:
        build_sharded(terrain, tmp_path / "s.h5", Layout(SPACING_M, 900.0), PlaceConfig(), runner)
    assert (tmp_path / "s.h5").read_bytes() == (tmp_path / "whole.h5").read_bytes()


def test_other_settings_are_refused(terrain, built, tmp_path):
    with pytest.raises(StoreMismatchError, match=r"eye_height_m is 2\.0 there, 3\.0 here"):
        build_places(terrain, built[0], SPACING_M, config=PlaceConfig(eye_height_m=3.0))
    build_uniform(terrain, tmp_path / "s.h5", 2000.0, config=RenderConfig(width=80))
    with pytest.raises(StoreMismatchError, match="what it holds is 'renderings' there"):
        build_places(terrain, tmp_path / "s.h5", 2000.0)
    with pytest.raises(InputError, match="spacing is 0"):
        build_places(terrain, tmp_path / "no.h5", 0.0)


@pytest.fixture(scope="module")
def wide(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, fractal(240, 350, 700.0, seed=12))])


@pytest.fixture(scope="module")
def whole(wide, tmp_path_factory):
    path = tmp_path_factory.mktemp("built") / "places.h5"
    built = build_places(wide, path, loss=LOSS)
    compact_store(path, path.with_name("compact.h5"))
    return built, path, path.with_name("compact.h5").read_bytes()


def test_a_plan_is_what_is_built_when_nothing_else_is_asked(wide, whole):
    built, path, _ = whole
    with open_store(path) as store:
        assert store.header.config["planner"] == "adaptive"
        assert store.header.config["loss"] == LOSS
        places = Places.concatenate(list(store.places().blocks()))
    assert built.rows == built.rendered == len(places) > 300
    with PanoramaRenderer(wide, BINS) as renderer:
        eyes = stand_on(wide, easting_m=places.easting_m, northing_m=places.northing_m)
        wanted = Places.of(renderer.render(eyes), places.tolerance_m)
    np.testing.assert_array_equal(places.rise, wanted.rise)
    assert len(np.unique(places.tolerance_m)) > 2


def test_an_interrupted_plan_goes_on(wide, whole, tmp_path):
    path = tmp_path / "s.h5"

    def stop(done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_places(wide, path, loss=LOSS, progress=stop)
    again = build_places(wide, path, loss=LOSS)
    assert 0 < again.rendered < again.rows == whole[0].rows
    compact_store(path, tmp_path / "resumed.h5")
    assert (tmp_path / "resumed.h5").read_bytes() == whole[2]
    assert build_places(wide, path, loss=LOSS).rendered == 0


@pytest.mark.parametrize("tile_m", [3000.0, 8000.0])
def test_tiles_of_a_plan_leave_no_trace(wide, whole, tmp_path, tile_m):
    path, plan = tmp_path / "s.h5", Layout(tile_m=tile_m, loss=LOSS)
    build_sharded(wide, path, plan, PlaceConfig())
    assert path.read_bytes() == whole[2]
    assert build_sharded(wide, path, plan, PlaceConfig()).rendered == 0


def test_a_store_that_was_begun_is_finished_with_tiles(wide, whole, tmp_path):
    path = tmp_path / "s.h5"

    def stop(done, _total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_places(wide, path, loss=LOSS, progress=stop)
    done = build_sharded(wide, path, Layout(loss=LOSS), PlaceConfig())
    assert 0 < done.rendered < done.rows == whole[0].rows


def test_other_plans_are_refused(wide, whole, tmp_path):
    with pytest.raises(StoreMismatchError, match=r"config loss is 0\.3 there, 0\.4 here"):
        build_places(wide, whole[1], loss=0.4)
    with pytest.raises(InputError, match="a store of renderings needs a spacing"):
        build_sharded(wide, tmp_path / "s.h5", Layout(), RenderConfig(width=80))


@pytest.mark.parametrize("tiled", [False, True])
def test_an_area_without_a_place_leaves_no_store(wide, tmp_path, tiled):
    path, loss = tmp_path / "s.h5", 0.6
    west, south, east, north = wide.bounds_m
    lon, lat = wide.frame.to_lonlat(
        np.array([0.4, 0.401]) * (east - west) + west,
        np.array([0.4, 0.401]) * (north - south) + south,
    )
    bounds_deg = float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1])
    build = partial(build_places, wide, path, None, bounds_deg, loss=loss)
    if tiled:
        plan = Layout(None, 5000.0, bounds_deg, loss)
        build = partial(build_sharded, wide, path, plan, PlaceConfig())
    with pytest.raises(InputError, match=r"no place planned .* in it; choose a"):
        build()
    assert not path.exists()

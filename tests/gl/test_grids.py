"""Horizons and sky view factors on a DEM's own grid: equal to those of its samples as places."""

import pickle

import dask
import numpy as np
import pytest
import rioxarray
import xarray
from scenes import fractal, write_dem

from skyline import InputError, horizon, horizon_grid, read_dem, sky_view_grid

STEP_DEG = 15.0
ALIKE = {"eye_height_m": 0.1, "summit_within_m": 0.0, "step_deg": STEP_DEG}
"""Arguments of `horizon` with which a place is a sample of a grid."""


@pytest.fixture(scope="module")
def array(tmp_path_factory):
    """An array of rioxarray, 30 x 24 samples in UTM."""
    path = write_dem(tmp_path_factory.mktemp("dem") / "dem.tif", fractal(24, 30, 300.0, seed=2))
    return rioxarray.open_rasterio(path, masked=True).isel(band=0).load()


@pytest.fixture(scope="module")
def in_degrees():
    """An array in degrees, from south to north, 20 x 24 samples."""
    heights = 1000.0 + fractal(20, 24, 300.0, seed=3)
    lat, lon = 46.0 + np.arange(20) / 3600.0, 9.0 + np.arange(24) / 3600.0
    made = xarray.DataArray(heights, {"lat": lat, "lon": lon}, ("lat", "lon"))
    return made.rio.write_crs("EPSG:4326")


def test_longitudes_may_pass_from_360_to_0(in_degrees):
    aside = in_degrees.assign_coords(lon=(in_degrees.lon - 9.003) % 360.0)
    assert aside.lon.values[0] > 359.0
    assert aside.lon.values[-1] < 1.0
    found, expected = sky_view_grid(aside), sky_view_grid(in_degrees)
    np.testing.assert_allclose(found.values, expected.values, atol=1e-5)


def lonlat_of(array):
    """Return the longitudes and latitudes (rows, columns) of an array's samples."""
    y, x = np.meshgrid(array.y, array.x, indexing="ij")
    return read_dem(array).frame.to_lonlat(x, y)


def test_the_factors_of_samples_are_those_of_places(array):
    lon, lat = lonlat_of(array)
    reports = []
    grid = sky_view_grid(array, step_deg=STEP_DEG, progress=lambda *done: reports.append(done))
    inner = slice(2, -2), slice(2, -2)
    places = horizon(array, lon=lon[inner], lat=lat[inner], **ALIKE)
    np.testing.assert_allclose(grid[inner], places.sky_view_factor(), atol=1e-5)
    assert grid.name == "sky_view_factor"
    xarray.testing.assert_equal(grid.x, array.x)
    assert grid.rio.crs == array.rio.crs
    assert reports[-1] == (720, 720)


def test_the_horizons_of_samples_are_those_of_places(array):
    lon, lat = lonlat_of(array)
    grid = horizon_grid(array, step_deg=STEP_DEG)
    assert grid.dims == ("azimuth_deg", "y", "x")
    one = horizon(array, lon=lon[10, 20], lat=lat[10, 20], **ALIKE)
    found = grid.isel(y=10, x=20)
    np.testing.assert_allclose(found, one.elevation_deg, atol=1e-2)
    np.testing.assert_array_equal(found.azimuth_deg, one.azimuth_deg)


def test_a_grid_in_degrees_keeps_its_coordinates_and_order(in_degrees):
    grid = sky_view_grid(in_degrees, step_deg=STEP_DEG)
    assert grid.dims == ("lat", "lon")
    xarray.testing.assert_equal(grid.lat, in_degrees.lat)
    at = {"lat": in_degrees.lat[12], "lon": in_degrees.lon[7]}
    one = horizon(in_degrees, **{name: float(value) for name, value in at.items()}, **ALIKE)
    assert float(grid.sel(at)) == pytest.approx(float(one.sky_view_factor()), abs=1e-6)


def test_a_plain_sees_all_the_sky_and_a_hole_none(array):
    flat = xarray.full_like(array, 500.0)
    flat[8:16, 8:22] = np.nan
    grid = sky_view_grid(read_dem(flat.where(flat.x > flat.x[0])), step_deg=STEP_DEG)
    assert float(grid.max()) == pytest.approx(1.0, abs=1e-6)
    assert float(grid.min()) == pytest.approx(1.0, abs=1e-6)
    assert grid.rio.crs == array.rio.crs


@pytest.mark.parametrize("function", [sky_view_grid, horizon_grid])
def test_chunks_are_computed_when_they_are_needed(array, function):
    whole = function(array, step_deg=STEP_DEG)
    lazy = function(array.chunk(y=10, x=16), step_deg=STEP_DEG)
    assert lazy.chunks[-2:] == ((10, 10, 4), (16, 14))
    with dask.config.set(scheduler="threads", num_workers=3):
        xarray.testing.assert_equal(lazy.compute(), whole)
    part = pickle.loads(pickle.dumps(lazy.data[..., :2, :3]))  # as for another process
    np.testing.assert_array_equal(part.compute(scheduler="sync"), whole[..., :2, :3])


@pytest.mark.parametrize("given", [{"step_deg": 7.0}, {"eye_height_m": -1.0}, {"step_deg": "5"}])
def test_what_cannot_be_is_refused(array, given):
    with pytest.raises(InputError):
        sky_view_grid(array, **given)

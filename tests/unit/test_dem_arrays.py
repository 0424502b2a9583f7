"""A DEM held by rasterio or xarray gives the height field that its file gives."""

import os

import numpy as np
import pytest
import rasterio
import xarray
from dem_scenes import array_of
from pyproj import CRS
from rasterio.transform import Affine
from scenes import fractal, write_dem

from skyline.errors import InputError
from skyline.terrain.dem import read_dem
from skyline.terrain.provenance import DemOptions

rioxarray = pytest.importorskip("rioxarray")

DEGREES = {"crs": "EPSG:4326", "transform": Affine(1 / 1200, 0.0, 9.7, 0.0, -1 / 1200, 46.9)}
VOID = -9999.0


def rough():
    """Heights with a spike and a small void, as `read_dem` cleans them."""
    heights = np.round(fractal(60, 50, seed=4) + 1500.0)
    heights[20, 20] += 2000.0
    heights[30:32, 10:13] = VOID
    return heights.astype(np.float32)


FILES = {
    "metric": {"nodata": VOID},
    "degrees": {"nodata": VOID, **DEGREES},
    "no nodata value declared": DEGREES,
    "from the south": {"nodata": VOID, "transform": Affine(30.0, 0.0, 6e5, 0.0, 30.0, 5.17e6)},
}


def assert_same(field, other):
    assert (field.digest, field.frame) == (other.digest, other.frame)
    for name in ("filled", "hollow", "despiked", "options", "resampling"):
        assert getattr(field.provenance, name) == getattr(other.provenance, name), name
    assert other.provenance.despiked >= 1
    assert other.provenance.filled >= 6


@pytest.fixture(params=FILES)
def path(request, tmp_path):
    return write_dem(tmp_path / "dem.tif", rough(), **FILES[request.param])


def test_an_open_dataset_gives_what_its_file_gives(path):
    with rasterio.open(path) as dataset:
        field = read_dem(dataset)
    with pytest.raises(InputError):
        read_dem(dataset)
    with os.scandir(path.parent) as entries:
        assert_same(field, read_dem(next(entries)))
    assert field.provenance.files == (str(path),)


@pytest.mark.parametrize("masked", [False, True])
def test_a_data_array_gives_what_its_file_gives(path, masked):
    with rioxarray.open_rasterio(path, masked=masked) as array:
        assert_same(read_dem(array), read_dem(path))


UTM = DemOptions(crs="EPSG:32632")


def test_order_and_names_of_dimensions_do_not_matter():
    field = read_dem(array_of(), UTM)
    np.testing.assert_array_equal(field.heights_m, array_of().values)
    assert (field.west_m, field.north_m) == (6e5, 5_180_000.0)
    for other in (
        array_of().transpose("x", "y"),
        array_of().isel(y=slice(None, None, -1)),
        array_of().isel(x=slice(None, None, -1)),
        array_of().expand_dims("band"),
        array_of("northing", "easting"),
    ):
        assert read_dem(other, UTM).digest == field.digest


def test_units_scale_and_cf_grid_mappings_are_heeded():
    feet = array_of().assign_attrs(units="ft", scale_factor=0.5, add_offset=10.0)
    field = read_dem(feet, UTM)
    np.testing.assert_allclose(field.heights_m, (array_of() * 0.5 + 10.0) * 0.3048, rtol=1e-6)
    values = array_of().values.ravel()[[0, 7]]
    for name in ("missing_value", "nodata", "nodatavals"):
        named = array_of().assign_attrs({name: values})
        assert read_dem(named, UTM).provenance.filled >= 2
    assert read_dem(array_of().assign_attrs(nodatavals=(None,)), UTM).provenance.filled == 0
    mapping = CRS.from_epsg(32632).to_cf()
    crs = xarray.DataArray(0, attrs={name: mapping[name] for name in mapping if name != "crs_wkt"})
    mapped = array_of().assign_coords(utm=crs).assign_attrs(grid_mapping="utm")
    lonlat_deg = read_dem(mapped).frame.to_lonlat(6e5, 5.18e6)
    np.testing.assert_allclose(lonlat_deg, field.frame.to_lonlat(6e5, 5.18e6), atol=1e-9)


def test_a_file_that_rioxarray_writes_keeps_the_unit_and_the_sense(tmp_path):
    array = array_of().rio.write_crs("EPSG:32632").assign_attrs(units="ft", positive="down")
    array.rio.to_raster(tmp_path / "dem.tif")
    for given in (array, tmp_path / "dem.tif"):
        np.testing.assert_allclose(read_dem(given).heights_m, array * -0.3048, rtol=1e-6)

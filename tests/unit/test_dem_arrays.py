"""A DEM held by rasterio or xarray gives the height field that its file gives."""

import os

import numpy as np
import pytest
import rasterio
import xarray
from pyproj import CRS
from rasterio.transform import Affine
from scenes import fractal, write_dem

from skyline.errors import InputError
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
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
        field = HeightField.from_rasterio(dataset)
    with pytest.raises(InputError, match="from_rasterio an open rasterio dataset"):
        HeightField.from_rasterio(dataset)
    with os.scandir(path.parent) as entries:
        assert_same(field, read_dem(next(entries)))
    assert field.provenance.files == (str(path),)


@pytest.mark.parametrize("masked", [False, True])
def test_a_data_array_gives_what_its_file_gives(path, masked):
    with rioxarray.open_rasterio(path, masked=masked) as array:
        assert_same(HeightField.from_xarray(array), read_dem(path))


def plain(y="y", x="x"):
    """Heights in UTM that name no CRS."""
    heights = np.round(fractal(30, 40, seed=2) + 1000.0)
    north, east = 5_180_000.0 - 30.0 * np.arange(30), 6e5 + 30.0 * np.arange(40)
    return xarray.DataArray(heights, {y: north, x: east}, (y, x), name="height")


UTM = DemOptions(crs="EPSG:32632")


def test_order_and_names_of_dimensions_do_not_matter():
    field = HeightField.from_xarray(plain(), UTM)
    np.testing.assert_array_equal(field.heights_m, plain().values)
    assert (field.west_m, field.north_m) == (6e5, 5_180_000.0)
    for other in (
        plain().transpose("x", "y"),
        plain().isel(y=slice(None, None, -1)),
        plain().isel(x=slice(None, None, -1)),
        plain().expand_dims("band"),
        plain("northing", "easting"),
    ):
        assert HeightField.from_xarray(other, UTM).digest == field.digest


def test_units_scale_and_cf_grid_mappings_are_heeded():
    feet = plain().assign_attrs(units="ft", scale_factor=0.5, add_offset=10.0)
    field = HeightField.from_xarray(feet, UTM)
    np.testing.assert_allclose(field.heights_m, (plain() * 0.5 + 10.0) * 0.3048, rtol=1e-6)
    named = plain().assign_attrs(missing_value=plain().values.ravel()[[0, 7]])
    assert HeightField.from_xarray(named, UTM).provenance.filled >= 2
    mapping = CRS.from_epsg(32632).to_cf()
    crs = xarray.DataArray(0, attrs={name: mapping[name] for name in mapping if name != "crs_wkt"})
    mapped = plain().assign_coords(utm=crs).assign_attrs(grid_mapping="utm")
    lonlat_deg = HeightField.from_xarray(mapped).frame.to_lonlat(6e5, 5.18e6)
    np.testing.assert_allclose(lonlat_deg, field.frame.to_lonlat(6e5, 5.18e6), atol=1e-9)


REFUSED = {
    "no coordinate reference system": plain(),
    "expected y, x or lat, lon": plain("row", "column"),
    "no coordinates along x": plain().drop_vars("x"),
    "along x in 'km'": plain().assign_coords(x=plain().x.assign_attrs(units="km")),
    "along y that are not even": plain().isel(y=[0, 1, 3, 4]),
    "holds no height": (plain() * np.nan).rio.write_crs("EPSG:32632"),
    "is not understood": plain().assign_coords(
        spatial_ref=xarray.DataArray(0, attrs={"grid_mapping_name": "unheard_of"})
    ),
}


@pytest.mark.parametrize("read", [HeightField.from_rasterio, HeightField.from_xarray, read_dem])
@pytest.mark.parametrize("given", [b"dem.tif", plain().to_dataset()], ids=["bytes", "Dataset"])
def test_other_types_are_refused_in_one_line(read, given):
    with pytest.raises(InputError, match=f"is of type {type(given).__name__}; read_dem takes"):
        read(given)


@pytest.mark.parametrize("message", REFUSED)
def test_arrays_that_are_no_dem_are_refused_in_one_line(message):
    names_no_crs = message in ("no coordinate reference system", "is not understood")
    options = None if names_no_crs else UTM
    with pytest.raises(InputError, match=message) as refused:
        HeightField.from_xarray(REFUSED[message], options)
    assert "\n" not in str(refused.value)

"""Files in every kind of CRS and unit: places, azimuths and heights come out true."""

import math

import numpy as np
import pytest
import rasterio
import xarray
from dem_scenes import depths, in_feet, in_unit, side_by_side
from pyproj import CRS, Geod
from rasterio.transform import from_origin
from rasterio.warp import Resampling, calculate_default_transform, reproject
from scenes import UTM, write_dem

from skyline.errors import InputError
from skyline.geodesy.map_frame import TRUE_DEG
from skyline.terrain.dem import read_dem
from skyline.terrain.named_crs import check_named_crs
from skyline.terrain.products import GROUND, SURFACE, UNKNOWN, model_of
from skyline.terrain.provenance import DemOptions

WGS84 = Geod(ellps="WGS84")
STEP_DEG = 2e-4
REACH_DEG = 0.02

PLACES = {
    "EPSG:4326": (9.9, 46.8),
    "EPSG:4807": (2.9, 45.5),
    "EPSG:27572": (2.9, 45.5),
    "EPSG:5513": (14.5, 50.1),
    "EPSG:2053": (29.3, -29.5),
    "EPSG:2056": (9.9, 46.8),
    "EPSG:3413": (-40.0, 70.0),
    "EPSG:3857": (-119.6, 37.7),
    "EPSG:2227": (-119.6, 37.7),
    "ESRI:102003": (-119.2, 37.7),
    "+proj=tmerc +lat_0=0 +lon_0=9 +k=1 +x_0=0 +y_0=0 +ellps=bessel +units=m +no_defs "
    "+towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7": (9.9, 48.2),
    "+proj=lcc +lat_1=46.8 +lat_0=46.8 +lon_0=0 +k_0=0.99987742 +x_0=600000 +y_0=2200000 +no_defs "
    "+a=6378249.2 +b=6356515 +towgs84=-168,-60,320,0,0,0,0 +pm=paris +units=m": (2.9, 45.5),
}
SOUTHWARD = "EPSG:5513", "EPSG:2053"
"""Axes that point south or west."""


def heights_m(lon, lat, place):
    """A cone, and a lower one to its north-east, on a plane that slopes."""
    east, north = (lon - place[0]) * math.cos(math.radians(place[1])), lat - place[1]
    plane = 1000.0 + 5000.0 * east - 3000.0 * north
    for at, height in (((0.0, 0.0), 800.0), ((0.007, 0.01), 500.0)):
        plane = plane + np.maximum(height - 8e4 * np.hypot(east - at[0], north - at[1]), 0.0)
    return plane


def warped(path, crs, place, **profile):
    """A DEM around a place, warped by GDAL."""
    wide = REACH_DEG / math.cos(math.radians(place[1]))
    rows, cols = round(2 * REACH_DEG / STEP_DEG), round(2 * wide / STEP_DEG)
    transform = from_origin(place[0] - wide, place[1] + REACH_DEG, STEP_DEG, STEP_DEG)
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    source = heights_m(transform.c + STEP_DEG * col, transform.f - STEP_DEG * row, place)
    bounds = rasterio.transform.array_bounds(rows, cols, transform)
    target, width, height = calculate_default_transform("EPSG:4326", crs, cols, rows, *bounds)
    made = np.full((height, width), np.nan, np.float32)
    reproject(
        source.astype(np.float32), made, src_transform=transform, src_crs="EPSG:4326",
        dst_transform=target, dst_crs=crs, dst_nodata=np.nan, resampling=Resampling.cubic,
    )  # fmt: skip
    return in_unit(path, "m", made, crs, transform=target, GEOTIFF_VERSION="1.1", **profile)


def true_azimuth_deg(frame, east, north, grid_azimuth_deg):
    """The azimuth on the ellipsoid of a step on the map, both ways."""
    step = 500.0 * np.exp(1j * math.radians(90.0 - grid_azimuth_deg))
    steps = east + 1j * north + np.array([0.0, step, -step])
    lon, lat = frame.to_lonlat(steps.real, steps.imag)
    there = WGS84.inv(lon[0], lat[0], lon[1], lat[1])[0]
    back = WGS84.inv(lon[0], lat[0], lon[2], lat[2])[0] + 180.0
    return there + ((back - there + 180.0) % 360.0 - 180.0) / 2.0


@pytest.mark.parametrize("crs", PLACES)
def test_a_summit_is_where_gdal_puts_it_and_north_is_true(tmp_path, caplog, crs):
    place = PLACES[crs]
    field = read_dem(warped(tmp_path / "dem.tif", crs, place))
    if crs in SOUTHWARD:
        assert field.provenance.resampling != "none"
        assert len(caplog.records) == 1
    row, col = np.unravel_index(np.nanargmax(field.heights_m), field.heights_m.shape)
    lon, lat = field.frame.to_lonlat(*field.to_map(row, col))
    assert WGS84.inv(lon, lat, *place)[2] < 1.5 * field.spacing_m
    rng = np.random.default_rng(0)
    aside = rng.uniform(-0.7, 0.7, (2, 400)) * REACH_DEG
    lon, lat = place[0] + aside[0] / math.cos(math.radians(place[1])), place[1] + aside[1]
    apart = field.height_at(lon=lon, lat=lat) - heights_m(lon, lat, place)
    assert np.sqrt(np.mean(apart**2)) < 3.0
    east, north = (float(value) for value in field.frame.from_lonlat(*place))
    turn = float(field.frame.convergence_deg(easting_m=east, northing_m=north))
    assert field.frame.angle_error_deg(easting_m=east, northing_m=north) < TRUE_DEG
    for azimuth in (0.0, 123.0):
        off = true_azimuth_deg(field.frame, east, north, azimuth) - azimuth - turn
        assert abs((off + 180.0) % 360.0 - 180.0) < 0.01


US_FOOT_M = 1200 / 3937
UNITS = {
    US_FOOT_M: "US survey foot|Foot_US|ftUS|ft (US)|usft|U.S. survey feet",
    0.3048: "ft|Foot_International| foot |feet (NAVD88)",
    0.3047972654: "Clarke's foot",
    0.30479841: "Indian foot (1937)",
    1.0000135965: "German legal metre",
    1.0: "|m|Meters|[m]|m a.s.l.|metres above sea level|m NAVD88|m+NAP|unknown",
    0.1: "decimetre",
    1000.0: "km",
}


@pytest.mark.parametrize(
    ("unit", "metres"), [(unit, metres) for metres in UNITS for unit in UNITS[metres].split("|")]
)
def test_heights_are_in_the_unit_of_the_band(tmp_path, unit, metres):
    heights_m = np.array([[2000.0, 2001.0], [2002.0, 2003.0]], np.float32)
    path = in_unit(tmp_path / "dem.tif", unit, heights_m / np.float32(metres))
    np.testing.assert_allclose(read_dem(path).heights_m, heights_m, rtol=3e-7)


@pytest.mark.parametrize("name", ["units", "UNITTYPE", "VERTICAL_UNITS", "z unit"])
@pytest.mark.parametrize("bands", [(), (1,)])
def test_a_band_without_a_unit_has_that_of_a_tag(tmp_path, name, bands):
    path = write_dem(tmp_path / "dem.tif", np.full((3, 3), 1000.0, np.float32))
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(*bands, **{name: "feet"})
    np.testing.assert_allclose(read_dem(path).heights_m, 304.8, rtol=1e-6)


@pytest.mark.parametrize(
    ("description", "metres"),
    [("Elevation (ft)", 0.3048), ("dem [US survey foot]", US_FOOT_M), ("ft", 1.0), ("(5 m)", 1.0)],
)
def test_a_band_without_a_unit_has_that_of_its_description(tmp_path, description, metres):
    path = write_dem(tmp_path / "dem.tif", np.full((3, 3), 1000.0, np.float32))
    with rasterio.open(path, "r+") as dataset:
        dataset.set_band_description(1, description)
    np.testing.assert_allclose(read_dem(path).heights_m, 1000.0 * metres, rtol=1e-6)


@pytest.mark.parametrize(("unit", "metres"), [("FEET", 0.3048), ("METERS", 1.0), ("NO", 1.0)])
def test_an_arcinfo_projection_names_the_unit_of_heights(tmp_path, unit, metres):
    path = tmp_path / "dem.asc"
    header = "ncols 3\nnrows 3\nxllcorner 500000\nyllcorner 5000000\ncellsize 30\n"
    path.write_text(header + "1000 1000 1000\n" * 3)
    path.with_suffix(".prj").write_text(
        f"Projection UTM\nZone 32\nDatum WGS84\nZunits {unit}\nUnits METERS\nParameters\n"
    )
    np.testing.assert_allclose(read_dem(path).heights_m, 1000.0 * metres, rtol=1e-6)


def test_a_tag_that_names_no_length_is_not_about_heights(tmp_path):
    path = write_dem(tmp_path / "dem.tif", np.full((3, 3), 1000.0, np.float32))
    with rasterio.open(path, "r+") as dataset:
        dataset.update_tags(units="degrees")
    np.testing.assert_array_equal(read_dem(path).heights_m, 1000.0)


@pytest.mark.parametrize(("datum", "metres"), [(5783, 1.0), (6360, US_FOOT_M), (6358, -US_FOOT_M)])
@pytest.mark.parametrize("version", ["1.0", "1.1"])
def test_a_band_without_a_unit_has_that_of_the_vertical_axis(tmp_path, datum, metres, version):
    values, crs = np.array([[1000.0, 1001.0], [1002.0, 1003.0]], np.float32), f"{UTM}+{datum}"
    field = read_dem(write_dem(tmp_path / "dem.tif", values, crs=crs, GEOTIFF_VERSION=version))
    np.testing.assert_allclose(field.heights_m, values * metres, rtol=2e-7)
    assert field.frame.name == UTM


def test_a_map_in_feet_that_names_no_unit_of_heights(tmp_path, caplog):
    path = in_feet(tmp_path / "dem.tif")
    with pytest.raises(InputError):
        read_dem(path)
    for datum, metres in ((6360, US_FOOT_M), (5703, 1.0)):
        with_vertical = read_dem(path, DemOptions(crs=f"EPSG:2227+{datum}"))
        assert with_vertical.height_range_m[0] == pytest.approx(1000.0 * metres)
    assert not caplog.records


@pytest.mark.parametrize(
    ("own", "corner", "step", "named", "is_doubted"),
    [
        (UTM, (500_000.0, 5_200_000.0), 30.0, "EPSG:32633", True),
        (UTM, (500_000.0, 5_200_000.0), 30.0, "EPSG:23032", True),  # ED50 lies 120 m aside.
        (UTM, (500_000.0, 5_200_000.0), 30.0, "EPSG:25832", False),  # ETRS89 is the same here.
        (UTM, (500_000.0, 5_200_000.0), 30.0, "EPSG:4326", False),  # These are no degrees,
        ("EPSG:4326", (9.0, 47.0), 1 / 3600, UTM, False),  # and these no metres.
    ],
)
def test_a_named_crs_that_puts_files_elsewhere(tmp_path, own, corner, step, named, is_doubted):
    transform = from_origin(*corner, step, step)
    path = write_dem(tmp_path / "a.tif", np.ones((9, 9), np.int16), own, transform=transform)
    if is_doubted:
        with pytest.raises(InputError, match=f"--crs {named} would put it"):
            check_named_crs([str(path)], named)
    else:
        check_named_crs([str(path)], named)


@pytest.mark.parametrize(("unit", "is_read"), [("", True), ("m", True), ("ft", False)])
def test_a_virtual_raster_that_has_lost_its_part_s_unit_is_refused(tmp_path, unit, is_read):
    in_unit(tmp_path / "part.tif", unit, np.full((3, 3), 1000.0, np.float32))
    with rasterio.open(tmp_path / "part.tif") as part:
        wkt, place = part.crs.to_wkt(), ", ".join(map(str, part.transform.to_gdal()))
    path = tmp_path / "whole.vrt"
    path.write_text(
        f"""<VRTDataset rasterXSize="3" rasterYSize="3"><SRS>{wkt}</SRS>
        <GeoTransform>{place}</GeoTransform><VRTRasterBand dataType="Float32" band="1">
        <SimpleSource><SourceFilename relativeToVRT="1">part.tif</SourceFilename>
        <SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"""
    )
    if is_read:
        np.testing.assert_array_equal(read_dem(path).heights_m, 1000.0)
    else:
        with pytest.raises(InputError, match=r"names no unit of heights, and its part .* in ft"):
            read_dem(path)
        with rasterio.open(path, "r+") as dataset:
            dataset.units = ["ft"]
        np.testing.assert_allclose(read_dem(path).heights_m, 304.8, rtol=1e-6)


def test_depths_become_negative_heights(tmp_path):
    path = depths(tmp_path / "dem.tif", 30)
    np.testing.assert_array_equal(read_dem(path).heights_m, -30.0)
    at = {"y": 5e6 - 30.0 * np.arange(3), "x": 5e5 + 30.0 * np.arange(3)}
    array = xarray.DataArray(np.full((3, 3), 30.0), at, ("y", "x"), attrs={"positive": "down"})
    field = read_dem(array, DemOptions(crs=UTM))
    np.testing.assert_array_equal(field.heights_m, -30.0)


def test_voids_are_known_before_heights_are_converted(tmp_path):
    values = np.full((20, 20), 5000, np.int16)
    values[5, 5], values[9, 9], values[12, 12] = -9999, -32768, -1
    path = in_unit(tmp_path / "dem.tif", "US survey foot", values, nodata=-1)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = [2.0], [100.0]
    field = read_dem(path)
    np.testing.assert_allclose(field.heights_m, 10_100.0 * US_FOOT_M, rtol=1e-6)
    counts = field.provenance
    assert (counts.filled, counts.undeclared, counts.despiked) == (3, 2, 0)


def test_tiles_of_different_units_make_one_model(tmp_path):
    field = read_dem(side_by_side(tmp_path, (UTM, "ftUS"), (UTM, "m")))
    assert field.heights_m.shape == (20, 40)
    np.testing.assert_allclose(field.heights_m, 3000.0, rtol=1e-6)
    assert field.provenance.conventions["height_unit"] == "ftUS, by the band; m, by the band"


def test_tiles_of_other_datums_are_one_model_unless_one_is_above_the_ellipsoid(tmp_path, caplog):
    for other in ("EPSG:32632+5783", UTM):
        read_dem(side_by_side(tmp_path, (other, "m"), ("EPSG:32632+5773", "m")))
        assert len(caplog.records) == 1
        caplog.clear()
    above_ellipsoid = CRS.from_epsg(32632).to_3d().to_wkt()
    with pytest.raises(InputError):
        read_dem(side_by_side(tmp_path, ("EPSG:32632+5773", "m"), (above_ellipsoid, "m")))


def test_a_product_is_known_by_its_name_or_a_tag_and_files_must_agree(tmp_path):
    for name, model in (
        ("davos_srtm1_30m.tif", f"{SURFACE}, SRTM"),
        ("N046E009_AVE_DSM.tif", SURFACE),
        ("tirol_dtm_5m.asc", GROUND),
        ("N46E009_FABDEM_V1-2.tif", f"{GROUND}, FABDEM"),
        ("N46E009.hgt.gz", UNKNOWN),
    ):
        assert model_of([name]) == model
    tags = {"SKYLINE_SOURCE": "https://host/Copernicus_DSM_COG_10_N46_00_E009_00_DEM.tif"}
    tagged = str(write_dem(tmp_path / "a.tif", np.ones((3, 3), np.float32), tags=tags))
    plain = str(write_dem(tmp_path / "b.tif", np.ones((3, 3), np.float32)))
    assert model_of([tagged]) == f"{SURFACE}, Copernicus"
    assert model_of([plain]) == UNKNOWN
    assert model_of([tagged, plain]) == UNKNOWN

"""Voids, declared or not, and spikes of elevation files."""

import numpy as np
import pytest
import rasterio
from dem_scenes import colours, in_unit, mountains
from rasterio.enums import ColorInterp
from rasterio.transform import from_origin
from rasterio.vrt import WarpedVRT
from scenes import write_dem

from skyline.errors import InputError
from skyline.terrain.dem import read_dem
from skyline.terrain.repair import void_undeclared


@pytest.mark.parametrize(
    ("dtype", "nodata", "value"),
    [
        ("int16", -32768, -32768),
        ("int16", None, -32768),
        ("float32", None, -9999.0),
        ("float32", None, np.nan),
        ("float32", None, np.inf),
        ("float64", -3.4028234663852886e38, -3.4028234663852886e38),
    ],
)
def test_voids_of_every_kind(tmp_path, dtype, nodata, value):
    heights = np.full((40, 40), 500, dtype=dtype)
    heights[5:8, 5:8] = value
    heights[20:32, 20:32] = value
    field = read_dem(write_dem(tmp_path / "dem.tif", heights, nodata=nodata))
    assert np.isnan(field.heights_m[20:32, 20:32]).all()
    assert np.count_nonzero(np.isnan(field.heights_m)) == 144
    assert field.heights_m[6, 6] == 500.0
    counts = field.provenance
    assert (counts.filled, counts.hollow, counts.despiked) == (9, 144, 0)


@pytest.mark.parametrize("values", [[65535], [65533, 65534, 65535]])
def test_the_greatest_numbers_of_16_bits_are_voids_in_mountains(tmp_path, values):
    heights = mountains((40, 40)).astype(np.uint16)
    heights[20:32, 20:32] = np.resize(values, 12)
    field = read_dem(write_dem(tmp_path / "dem.tif", heights))
    assert np.count_nonzero(np.isnan(field.heights_m)) == 144


def test_masked_samples_are_voids_and_so_are_those_of_the_nodata_value(tmp_path):
    heights = np.full((9, 9), 500, np.int16)
    heights[2, 2] = 450
    path = write_dem(tmp_path / "dem.tif", heights, nodata=450)
    mask = np.full((9, 9), 255, np.uint8)
    mask[4, 4] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    assert read_dem(path).provenance.filled == 2


@pytest.mark.parametrize("order", [("gray", "alpha"), ("alpha", "gray")])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "int16", "float32"])
def test_an_alpha_band_marks_the_voids(tmp_path, dtype, order):
    heights, alpha = np.full((40, 40), 100, dtype), np.full((40, 40), 255, dtype)
    heights[0:20, 0:20] = 0
    alpha[0:20, 0:20] = 0
    alpha[30, 30] = 1  # Half a mask, as resampling leaves it, is a height.
    bands = {"gray": heights, "alpha": alpha}
    path = write_dem(tmp_path / "dem.tif", np.dstack([bands[name] for name in order]))
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [ColorInterp[name] for name in order]
    field = read_dem(path)
    assert np.isnan(field.heights_m[0:20, 0:20]).all()
    assert np.count_nonzero(field.heights_m == 100.0) == 1200
    assert field.provenance.conventions["nodata"] == "by a mask"
    with rasterio.open(path) as dataset:
        assert read_dem(dataset).digest == field.digest


def test_what_rasterio_warps_with_an_alpha_band_has_voids_round_it(tmp_path):
    heights = np.full((40, 40), 900, np.int16)
    path = write_dem(tmp_path / "dem.tif", heights)
    with (
        rasterio.open(path) as dataset,
        WarpedVRT(dataset, crs="EPSG:3574", add_alpha=True) as turned,
    ):
        assert turned.count == 2
        field = read_dem(turned)
    assert field.height_range_m == (900.0, 900.0)
    # A square turned by 50 degrees leaves half of the box around it void.
    assert field.provenance.hollow > 600


def test_colours_with_an_alpha_band_are_no_heights(tmp_path):
    path = colours(tmp_path / "a.tif")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[3] is ColorInterp.alpha
    with pytest.raises(InputError):
        read_dem(path)


def test_holes_and_spikes_do_not_bleed_through_the_warp(tmp_path):
    step = 1.0 / 1200.0
    transform = from_origin(9.0, 47.0, step, step)
    row, col = np.mgrid[0:120, 0:120].astype(np.float32)
    heights = 800.0 + 4.0 * row + 2.0 * col
    heights[40:70, 50:60] = -32768.0
    heights[90, 90] = 32767.0
    field = read_dem(
        write_dem(tmp_path / "dem.tif", heights, "EPSG:4326", transform=transform, nodata=-32768)
    )
    assert (field.provenance.hollow, field.provenance.despiked) == (300, 1)
    east, north = field.to_map(*np.indices(field.heights_m.shape))
    lon, lat = field.frame.to_lonlat(east, north)
    source_row, source_col = (47.0 - lat) / step - 0.5, (lon - 9.0) / step - 0.5
    inside = (np.minimum(source_row, source_col) >= 0) & (np.maximum(source_row, source_col) <= 119)
    hole = (source_row > 39.5) & (source_row < 69.5) & (source_col > 49.5) & (source_col < 59.5)
    np.testing.assert_array_equal(np.isnan(field.heights_m), hole | ~inside)
    known = inside & ~hole
    expected = 800.0 + 4.0 * source_row + 2.0 * source_col
    # At the rim of a hole the nearest known samples stand in: up to half a sample's slope.
    off = np.abs(field.heights_m - expected)
    assert off[known].max() <= 3.0
    rim = (np.abs(source_row - 54.5) < 17.0) & (np.abs(source_col - 54.5) < 7.0)
    assert off[known & ~rim].max() < 0.01


SPACING_M = 30.0


def turned(shape):
    """Whether a sample lies outside a footprint that was turned by 6 degrees."""
    row, col = np.mgrid[: shape[0], : shape[1]]
    return (col + 0.1 * row < 24) | (row - 0.1 * col < 12) | (col + 0.1 * row > 195)


@pytest.mark.parametrize("value", [0.0, 250.0])
def test_the_fill_of_a_turned_footprint_becomes_void(value):
    heights = mountains()
    outside = turned(heights.shape)
    heights[outside] = value
    count, values = void_undeclared(heights, SPACING_M)
    assert values == [value]
    assert count == np.count_nonzero(outside)
    np.testing.assert_array_equal(np.isnan(heights), outside)


def test_small_fill_behind_walls_on_all_sides_becomes_void():
    # A slope that rises from 2,000 m, with zeros in place of 9 samples and of 35.
    heights = np.tile(2000.0 + 5.0 * np.arange(60), (60, 1)).astype(np.float32)
    heights[10:13, 20:23] = heights[40:45, 30:37] = 0.0
    assert void_undeclared(heights, SPACING_M) == (9 + 35, [0.0])


def test_water_in_a_gorge_stays():
    # A river of one level, three samples wide and six long, between walls of 300 m.
    heights = np.tile(1000.0 + 20.0 * np.arange(60)[:, np.newaxis], (1, 60)).astype(np.float32)
    heights[:, 28:31] -= 300.0
    heights[30:36, 28:31] = heights[30, 28]
    assert void_undeclared(heights, SPACING_M) == (0, [])


@pytest.mark.parametrize("level", [0.0, 1500.0])
def test_water_stays(level):
    # A shore as steep as terrain gets at 30 m: 45 degrees all round, and a cliff on a fifth of it.
    row, col = np.mgrid[:160, :200]
    away = np.hypot(row - 80, col - 100)
    heights = (level + np.maximum(away - 40.0, 0.0) * 30.0).astype(np.float32)
    cliff = (away > 40.0) & (np.arctan2(row - 80, col - 100) > 0.6 * np.pi)
    heights[cliff] += 300.0
    before = heights.copy()
    assert void_undeclared(heights, SPACING_M) == (0, [])
    np.testing.assert_array_equal(heights, before)


def test_the_sea_stays_where_the_fill_goes():
    heights = mountains()
    row, col = np.indices(heights.shape)
    away = np.hypot(row - 90, col - 110)
    heights[:] = np.minimum(heights, np.maximum(away - 25.0, 0.0) * 20.0)
    heights[:, :12] = 0.0
    assert void_undeclared(heights, SPACING_M) == (160 * 12, [0.0])


def test_fill_is_counted_and_warned_of(tmp_path, caplog):
    heights = mountains()
    heights[:, :30] = 0.0
    path = in_unit(tmp_path / "dem.tif", "m", heights)
    counts = read_dem(path).provenance
    assert (counts.undeclared, counts.hollow) == (4800, 4800)
    assert sum("with walls round them" in one for one in caplog.messages) == 1


def test_the_turned_footprint_of_a_real_dem(shared_data):
    field = read_dem(shared_data / "photos" / "columbia" / "dem_Columbia.tif")
    # Both flanks go; the fjord, 3,796 samples at 0 m, stays.
    assert 25_000 < field.provenance.undeclared < 28_000
    assert np.isnan(field.heights_m[100:400, :5]).all()
    assert np.count_nonzero(field.heights_m == 0.0) > 3796

"""Voids and spikes of elevation files."""

import numpy as np
import pytest
import rasterio
from dem_files import write
from rasterio.transform import from_origin

from skyline.terrain.dem import read_dem


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
    field = read_dem(write(tmp_path / "dem.tif", heights, nodata=nodata))
    assert np.isnan(field.heights_m[20:32, 20:32]).all()
    assert np.count_nonzero(np.isnan(field.heights_m)) == 144
    assert field.heights_m[6, 6] == 500.0
    counts = field.provenance
    assert (counts.filled, counts.hollow, counts.despiked) == (9, 144, 0)


def test_masked_samples_are_voids(tmp_path):
    path = write(tmp_path / "dem.tif", np.full((9, 9), 500, np.int16))
    mask = np.full((9, 9), 255, np.uint8)
    mask[4, 4] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    assert read_dem(path).provenance.filled == 1


def test_holes_and_spikes_do_not_bleed_through_the_warp(tmp_path):
    step = 1.0 / 1200.0
    transform = from_origin(9.0, 47.0, step, step)
    row, col = np.mgrid[0:120, 0:120].astype(np.float32)
    heights = 800.0 + 4.0 * row + 2.0 * col
    heights[40:70, 50:60] = -32768.0
    heights[90, 90] = 32767.0
    field = read_dem(write(tmp_path / "dem.tif", heights, transform, "EPSG:4326", nodata=-32768))
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

import gzip
import json
import subprocess
import sys
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from rasterio.transform import Affine, from_origin

from skyline.errors import InputError, MissingFileError
from skyline.geodesy import Frame
from skyline.terrain import cleaning
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.tiles import Grid, mosaic_grid, open_tile, read_mosaic
from skyline.terrain.warp import square_spacing_m, warp

UTM = "EPSG:32632"
CALIFORNIA = [f"N{lat}W{lon}" for lat in (38, 37, 36) for lon in (120, 119)]

AnyArray = NDArray[Any]


def write(
    path: Path,
    heights: AnyArray,
    transform: Affine | None = None,
    crs: str | None = UTM,
    **profile: Any,
) -> Path:
    transform = from_origin(500_000.0, 5_200_000.0, 30.0, 30.0) if transform is None else transform
    bands = heights if heights.ndim == 3 else heights[np.newaxis]
    with rasterio.open(
        path,
        "w",
        driver=profile.pop("driver", "GTiff"),
        count=bands.shape[0],
        height=bands.shape[1],
        width=bands.shape[2],
        dtype=heights.dtype,
        crs=crs,
        transform=transform,
        **{key: value for key, value in profile.items() if key != "tags"},
    ) as dataset:
        dataset.write(bands)
        dataset.update_tags(**profile.get("tags", {}))
    return path


def plane(x: AnyArray, y: AnyArray) -> AnyArray:
    """A height that says where it is: no flip and no shift leaves it the same."""
    return 1000.0 + 0.25 * x - 0.5 * y


def plane_grid(rows: int, cols: int, transform: Affine) -> NDArray[np.float32]:
    """Heights of the plane at pixel centres, relative to the grid's first corner."""
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    x = transform.a * col + transform.b * row
    y = transform.d * col + transform.e * row
    return plane(x, y).astype(np.float32)


# --- where the samples are -----------------------------------------------------------------


@pytest.mark.parametrize("step_east", [30.0, -30.0])
@pytest.mark.parametrize("step_north", [-20.0, 20.0])
@pytest.mark.parametrize("tag", ["Area", "Point"])
def test_heights_are_where_the_file_puts_them(
    tmp_path: Path, step_east: float, step_north: float, tag: str
) -> None:
    transform = Affine(step_east, 0.0, 500_000.0, 0.0, step_north, 5_200_000.0)
    path = write(
        tmp_path / "dem.tif", plane_grid(23, 31, transform), transform, tags={"AREA_OR_POINT": tag}
    )
    field = read_dem(path)
    assert (field.rows, field.cols) == (23, 31)
    assert (field.spacing_east_m, field.spacing_north_m) == (30.0, 20.0)
    west, south, east, north = field.bounds_m
    corners_x = sorted([500_000.0 + 0.5 * step_east, 500_000.0 + 30.5 * step_east])
    corners_y = sorted([5_200_000.0 + 0.5 * step_north, 5_200_000.0 + 22.5 * step_north])
    assert [west, east, south, north] == [*corners_x, *corners_y]
    x = np.random.default_rng(0).uniform(west, east, 200)
    y = np.random.default_rng(1).uniform(south, north, 200)
    np.testing.assert_allclose(
        field.height_at(x, y), plane(x - 500_000.0, y - 5_200_000.0), atol=1e-3
    )
    assert field.provenance.files == (str(path.absolute()),)
    assert field.provenance.resampling == "none"
    assert field.frame.name == UTM


def write_hgt(path: Path, heights: AnyArray) -> Path:
    content = np.rint(heights).astype(">i2").tobytes()
    path.write_bytes(gzip.compress(content, 1) if path.suffix == ".gz" else content)
    return path


def degree_plane(lon: AnyArray, lat: AnyArray) -> AnyArray:
    """Whole metres at each sample of a 3 arc-second tile."""
    return 700.0 + 1200.0 * lon + 1200.0 * lat


@pytest.mark.parametrize(
    ("names", "south", "west"),
    [
        (["N46E009.hgt"], 46, 9),
        (["N46E009.hgt.gz"], 46, 9),
        (["S45E170.hgt.gz"], -45, 170),
        (["N84E015.hgt.gz"], 84, 15),
        (["N00W001.hgt"], 0, -1),
        (["N60E179.hgt.gz", "N60W180.hgt.gz"], 60, 179),
        (["N60W180.hgt.gz", "N60E179.hgt.gz"], 60, 179),
    ],
)
def test_degrees_are_warped_to_where_they_belong(
    tmp_path: Path, names: list[str], south: int, west: int
) -> None:
    sample = np.arange(1201) / 1200.0
    for name in names:
        origin = (int(name[4:7]) * (1 if name[3] == "E" else -1) - west) % 360
        write_hgt(tmp_path / name, degree_plane(origin + sample, 1.0 - sample[:, np.newaxis]))
    field = read_dem([tmp_path / name for name in names])
    assert field.spacing_m == 90.0
    rng = np.random.default_rng(0)
    lon, lat = rng.uniform(0.02, len(names) - 0.02, 500), rng.uniform(0.02, 0.98, 500)
    easting, northing = field.frame.from_lonlat(west + lon, south + lat)
    # What is left is the curvature of the plane within a cell of the target.
    np.testing.assert_allclose(
        field.height_at(easting, northing), degree_plane(lon, lat), atol=0.02
    )
    centre = Frame.local((west + 0.5 * len(names) + 180.0) % 360.0 - 180.0, south + 0.5)
    assert field.frame == centre
    # Samples stand at whole multiples of the spacing.
    assert field.west_m % 90.0 == 0.0
    assert field.north_m % 90.0 == 0.0


def test_a_tile_at_the_pole(tmp_path: Path) -> None:
    sample = np.arange(1201) / 1200.0
    write_hgt(tmp_path / "N89E010.hgt", 100.0 + 1200.0 * (1.0 - sample[:, None]) + 0.0 * sample)
    field = read_dem(tmp_path / "N89E010.hgt")
    easting, northing = field.frame.from_lonlat([10.3, 10.5, 10.8], [89.3, 89.6, 89.9])
    np.testing.assert_allclose(
        field.height_at(easting, northing), [460.0, 820.0, 1180.0], atol=0.02
    )


def test_ascii_grid_takes_its_crs_from_the_option(tmp_path: Path) -> None:
    path = tmp_path / "dem.asc"
    path.write_text(
        "ncols 3\nnrows 2\nxllcorner 1000\nyllcorner 2000\ncellsize 10\nNODATA_value -1\n"
        "1 2 3\n4 5 6\n"
    )
    field = read_dem(path, DemOptions(crs="EPSG:21781"))
    np.testing.assert_array_equal(field.heights_m, [[1, 2, 3], [4, 5, 6]])
    assert field.bounds_m == (1005.0, 2005.0, 1025.0, 2015.0)
    assert field.frame.name == "EPSG:21781"
    with pytest.raises(InputError, match="--crs"):
        read_dem(path)


def test_the_file_s_own_crs_wins_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write(tmp_path / "dem.tif", np.ones((3, 3), np.float32))
    assert read_dem(path, DemOptions(crs="EPSG:32633")).frame.name == UTM
    assert "32N" in caplog.text
    caplog.clear()
    read_dem(path, DemOptions(crs=UTM))
    assert caplog.text == ""


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2)])
@pytest.mark.parametrize("degrees", [False, True])
def test_small_dems_are_dems(tmp_path: Path, shape: tuple[int, int], degrees: bool) -> None:
    heights = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    transform = from_origin(10.0, 46.0, 1 / 3600, 1 / 3600) if degrees else None
    path = write(tmp_path / "dem.tif", heights, transform, "EPSG:4326" if degrees else UTM)
    field = read_dem(path)
    if degrees:
        assert field.height_at(0.0, 0.0) == pytest.approx(heights.mean(), abs=1e-3)
    else:
        np.testing.assert_array_equal(field.heights_m, heights)


def test_feet_become_metres(tmp_path: Path) -> None:
    path = write(tmp_path / "dem.tif", np.full((3, 3), 1000, np.int16))
    with rasterio.open(path, "r+") as dataset:
        dataset.units = ["ft"]
    np.testing.assert_allclose(read_dem(path).heights_m, 304.8)


def test_scale_and_offset_are_applied(tmp_path: Path) -> None:
    path = write(tmp_path / "dem.tif", np.full((3, 3), 1000, np.int16))
    with rasterio.open(path, "r+") as dataset:
        dataset.scales, dataset.offsets = [0.1], [50.0]
    np.testing.assert_allclose(read_dem(path).heights_m, 150.0)


def test_a_crs_in_feet_is_warped(tmp_path: Path) -> None:
    x, y = 6_500_000.0, 2_300_000.0
    transform = from_origin(x, y, 100.0, 100.0)
    heights = plane_grid(60, 60, transform)
    field = read_dem(write(tmp_path / "dem.tif", heights, transform, "EPSG:2227"))
    assert field.spacing_m == 30.0
    to_frame = Transformer.from_crs("EPSG:2227", field.frame.crs, always_xy=True)
    easting, northing = to_frame.transform(x + 1234.0, y - 2345.0)
    assert field.height_at(easting, northing) == pytest.approx(plane(1234.0, -2345.0), abs=0.05)


@pytest.mark.parametrize(
    ("ground", "spacing"),
    [
        ((21.2, 30.9), 30.0),
        ((73.7, 92.5), 90.0),
        ((9.7, 92.9), 90.0),
        ((30.9, 30.7), 30.0),
        ((7.2, 10.3), 10.0),
        ((15.4, 11.0), 15.0),
        ((30.26, 29.74), 30.0),
        ((29.9, 29.9), 30.0),
        ((690.0, 926.0), 900.0),
        ((0.99, 0.99), 0.95),
        ((1.0, 1.0), 1.0),
        ((3.09, 2.1), 3.0),
    ],
)
def test_warped_spacing_is_round(ground: tuple[float, float], spacing: float) -> None:
    assert square_spacing_m(ground) == pytest.approx(spacing, rel=1e-12)


# --- voids and spikes ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dtype", "nodata", "value"),
    [
        ("int16", -32768, -32768),
        ("int16", None, -32768),
        ("int16", 7, 7),
        ("float32", -9999.0, -9999.0),
        ("float32", None, -9999.0),
        ("float32", None, np.nan),
        ("float32", np.nan, np.nan),
        ("float32", None, np.inf),
        ("float64", -3.4028234663852886e38, -3.4028234663852886e38),
    ],
)
def test_voids_of_every_kind(
    tmp_path: Path, dtype: str, nodata: float | None, value: float
) -> None:
    heights = np.full((40, 40), 500, dtype=dtype)
    heights[5:8, 5:8] = value
    heights[20:32, 20:32] = value
    field = read_dem(write(tmp_path / "dem.tif", heights, nodata=nodata))
    assert np.isnan(field.heights_m[20:32, 20:32]).all()
    assert np.count_nonzero(np.isnan(field.heights_m)) == 144
    assert field.heights_m[6, 6] == 500.0
    counts = field.provenance
    assert (counts.filled, counts.hollow, counts.despiked) == (9, 144, 0)


def test_masked_samples_are_voids(tmp_path: Path) -> None:
    path = write(tmp_path / "dem.tif", np.full((9, 9), 500, np.int16))
    mask = np.full((9, 9), 255, np.uint8)
    mask[4, 4] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(mask)
    assert read_dem(path, DemOptions(max_void_samples=0)).provenance.hollow == 1


def test_spikes_become_ground(tmp_path: Path) -> None:
    transform = from_origin(500_000.0, 5_200_000.0, 30.0, 30.0)
    heights = plane_grid(30, 30, transform)
    spiked = heights.copy()
    spiked[10, 10], spiked[0, 29], spiked[20, 5] = 32767.0, 9000.0, -2000.0
    field = read_dem(write(tmp_path / "dem.tif", spiked, transform))
    assert (field.provenance.despiked, field.provenance.filled) == (3, 3)
    np.testing.assert_allclose(field.heights_m[1:, :-1], heights[1:, :-1], atol=1e-2)
    assert abs(field.heights_m[0, 29] - heights[0, 29]) < 20.0
    kept = read_dem(tmp_path / "dem.tif", DemOptions(spike_m=np.inf))
    assert kept.provenance.despiked == 1
    assert kept.heights_m[0, 29] == 9000.0


def test_holes_and_spikes_do_not_bleed_through_the_warp(tmp_path: Path) -> None:
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


# --- tiles ---------------------------------------------------------------------------------


def tile_at(folder: Path, heights: AnyArray, row: int, col: int) -> Path:
    transform = from_origin(500_000.0 + 30.0 * col, 5_200_000.0 - 30.0 * row, 30.0, 30.0)
    return write(folder / f"tile_{row}_{col}.tif", heights, transform)


def test_metric_tiles_become_one_grid_with_gaps_as_holes(tmp_path: Path) -> None:
    whole = np.random.default_rng(0).uniform(0, 50, (20, 30)).astype(np.float32)
    # Adjacent, sharing a border, and none in the south-east.
    paths = [
        tile_at(tmp_path, whole[10:, :16], 10, 0),
        tile_at(tmp_path, whole[:10, :15], 0, 0),
        tile_at(tmp_path, whole[:11, 14:], 0, 14),
    ]
    field = read_dem(paths)
    expected = whole.copy()
    expected[11:, 16:] = np.nan
    np.testing.assert_array_equal(field.heights_m, expected)
    assert (field.west_m, field.north_m) == (500_015.0, 5_199_985.0)
    counts = field.provenance
    assert (counts.filled, counts.hollow, counts.resampling) == (0, 0, "none")
    assert counts.files == tuple(str(path) for path in paths)


def test_a_void_on_a_border_is_read_from_the_neighbour(tmp_path: Path) -> None:
    left = np.full((5, 5), 10.0, np.float32)
    left[2, 4] = np.nan
    right = np.full((5, 5), 10.0, np.float32)
    right[2, 0] = 10.5
    field = read_dem([tile_at(tmp_path, left, 0, 0), tile_at(tmp_path, right, 0, 4)])
    assert field.heights_m[2, 4] == 10.5
    assert field.provenance.filled == 0


def test_tiles_that_disagree_are_told(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    first = tile_at(tmp_path, np.full((5, 5), 10.0, np.float32), 0, 0)
    close = tile_at(tmp_path, np.full((5, 5), 11.0, np.float32), 0, 4)
    assert read_dem([first, close]).heights_m[0, 4] == 10.0
    assert caplog.text == ""
    other = tile_at(tmp_path, np.full((5, 5), 42.0, np.float32), 4, 0)
    assert read_dem([other, first]).heights_m[4, 4] == 42.0
    assert "up to 32.00 m" in caplog.text


@pytest.mark.parametrize(
    ("transform", "crs", "message"),
    [
        (from_origin(500_165.0, 5_200_000.0, 30.0, 30.0), UTM, "0.50 columns off"),
        (from_origin(500_150.0, 5_200_010.0, 30.0, 30.0), UTM, "0.33 rows"),
        (from_origin(500_150.0, 5_200_000.0, 10.0, 10.0), UTM, "spacing of 10 x 10"),
        (from_origin(500_150.0, 5_200_000.0, 30.0, 30.0), "EPSG:32633", "zone 33N"),
        (from_origin(900_500_000.0, 5_200_000.0, 30.0, 30.0), UTM, "spans"),
    ],
)
def test_tiles_that_do_not_fit(tmp_path: Path, transform: Affine, crs: str, message: str) -> None:
    first = tile_at(tmp_path, np.ones((200, 5), np.float32), 0, 0)
    second = write(tmp_path / "b.tif", np.ones((200, 5), np.float32), transform, crs)
    with pytest.raises(InputError, match=message):
        read_dem([first, second])


def california(shared_data: Path) -> list[Path]:
    return [shared_data / "california" / f"{name}.hgt.gz" for name in CALIFORNIA]


def test_six_californian_tiles_have_no_seam(shared_data: Path, tmp_path: Path) -> None:
    raw = {}
    for path, name in zip(california(shared_data), CALIFORNIA, strict=True):
        content = gzip.decompress(path.read_bytes())
        raw[name] = np.frombuffer(content, ">i2").reshape(1201, 1201).astype(np.int16)
    tiles = [open_tile(path, None) for path in california(shared_data)]
    grid, offsets = mosaic_grid(tiles)
    assert (grid.rows, grid.cols) == (3601, 2401)
    heights = read_mosaic(tiles, grid, offsets)
    merged = np.full(heights.shape, -32768, np.int16)
    for (row, col), name in reversed(list(zip(offsets, CALIFORNIA, strict=True))):
        merged[row : row + 1201, col : col + 1201] = raw[name]
        # All of each tile is there; the file's own borders differ by a metre here and there.
        difference = np.abs(heights[row : row + 1201, col : col + 1201] - raw[name])
        assert not difference[1:-1, 1:-1].any()
        assert difference.max() <= 1.0
    np.testing.assert_array_equal(heights, merged)

    step = 1.0 / 1200.0
    whole = write(
        tmp_path / "merged.tif",
        merged,
        from_origin(-120.0 - step / 2, 39.0 + step / 2, step, step),
        "EPSG:4326",
        nodata=-32768,
    )
    one, six = read_dem(whole), read_dem(california(shared_data))
    assert one.heights_m.shape == six.heights_m.shape
    np.testing.assert_allclose(six.heights_m, one.heights_m, atol=1e-3)
    assert six.spacing_m == 90.0
    easting, northing = six.frame.from_lonlat(-118.2925, 36.5783)
    around = six.height_at(
        *np.meshgrid(easting + np.arange(-200, 201, 20), northing + np.arange(-200, 201, 20))
    )
    assert 4380.0 < around.max() < 4430.0  # Mount Whitney


# --- the warp ------------------------------------------------------------------------------


def test_warp_is_keys_cubic_convolution() -> None:
    rng = np.random.default_rng(5)
    heights = rng.uniform(0.0, 1000.0, (50, 60)).astype(np.float32)
    step = 1.0 / 1200.0
    grid = Grid(9.0, 47.0, step, step, 50, 60)
    frame = Frame.local(9.0 + 29.5 * step, 47.0 - 24.5 * step)
    warped, target = warp(heights, grid, CRS.from_epsg(4326), frame, 90.0)
    row, col = np.mgrid[5 : target.rows - 5, 5 : target.cols - 5]
    lon, lat = frame.to_lonlat(target.west + 90.0 * col, target.north - 90.0 * row)

    def kernel(x: AnyArray) -> AnyArray:
        x = np.abs(x)
        near = 1.5 * x**3 - 2.5 * x**2 + 1.0
        far = -0.5 * x**3 + 2.5 * x**2 - 4.0 * x + 2.0
        return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0))

    row_weights = kernel(((47.0 - lat) / step)[..., None] - np.arange(50))
    col_weights = kernel(((lon - 9.0) / step)[..., None] - np.arange(60))
    expected = np.einsum("ijr,ijc,rc->ij", row_weights, col_weights, heights)
    np.testing.assert_allclose(warped[row, col], expected, atol=1e-2)


def test_davos_is_30_m(shared_data: Path) -> None:
    path = shared_data / "davos" / "davos_srtm1_30m.tif"
    field = read_dem([path])
    assert field.spacing_east_m == field.spacing_north_m == 30.0
    assert (field.provenance.despiked, field.provenance.filled, field.provenance.hollow) == (
        2,
        2,
        0,
    )
    assert "WGS 84" in field.provenance.resampling
    assert "30 m" in field.provenance.resampling
    with rasterio.open(path) as dataset:
        raw, transform = dataset.read(1), dataset.transform
    places = np.random.default_rng(0).integers(20, 2140, (400, 2))
    lon = transform.c + (places[:, 1] + 0.5) * transform.a
    lat = transform.f + (places[:, 0] + 0.5) * transform.e
    difference = (
        field.height_at(*field.frame.from_lonlat(lon, lat)) - raw[places[:, 0], places[:, 1]]
    )
    assert abs(difference.mean()) < 0.3
    assert np.sqrt((difference**2).mean()) < 3.0


def test_everest_voids_are_counted(shared_data: Path) -> None:
    field = read_dem(shared_data / "everest" / "mt_everest_90m.tif")
    counts = field.provenance
    assert counts.filled + counts.hollow == 130_953 + counts.despiked
    assert (counts.filled, counts.despiked) == (17_243, 2)
    assert field.height_range_m[1] < 8650.0


def test_digest_is_the_same_each_time(tmp_path: Path) -> None:
    heights = np.random.default_rng(0).uniform(0, 900, (300, 200)).astype(np.float32)
    heights[50, 50:60] = np.nan
    transform = from_origin(9.0, 47.0, 1 / 1200, 1 / 1200)
    path = write(tmp_path / "dem.tif", heights, transform, "EPSG:4326")
    assert read_dem(path).digest == read_dem([str(path)]).digest
    assert read_dem(path).digest != read_dem(path, DemOptions(max_void_samples=0)).digest


# --- frames that are not true ----------------------------------------------------------------


def test_albers_is_used_with_a_warning_or_warped(
    shared_data: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = shared_data / "sierra" / "sierra_ansel_adams_30m_albers.tif"
    own = read_dem(path)
    assert own.provenance.resampling == "none"
    assert "not conformal" in caplog.text
    assert "1.11 degrees" in caplog.text
    caplog.clear()
    warped = read_dem(path, DemOptions(reproject=True))
    assert caplog.text == ""
    assert warped.spacing_m == 30.0
    assert float(warped.frame.angular_distortion_deg(0.0, 0.0)) < 1e-5
    easting, northing = own.to_map([300.0, 600.0], [500.0, 200.0])
    there = warped.frame.from_lonlat(*own.frame.to_lonlat(easting, northing))
    np.testing.assert_allclose(warped.height_at(*there), own.height_at(easting, northing), atol=5.0)


def test_web_mercator_has_metres_that_are_none(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    transform = from_origin(1_100_000.0, 5_900_000.0, 30.0, 30.0)
    read_dem(write(tmp_path / "dem.tif", np.ones((9, 9), np.float32), transform, "EPSG:3857"))
    assert "0.68" in caplog.text
    assert "--reproject" in caplog.text


@pytest.mark.parametrize("crs", [UTM, "EPSG:31287"])
def test_conformal_frames_raise_no_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, crs: str
) -> None:
    place = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(11.5, 47.2)
    read_dem(
        write(tmp_path / "dem.tif", np.ones((9, 9), np.float32), from_origin(*place, 5.0, 5.0), crs)
    )
    assert caplog.text == ""


# --- what is refused -------------------------------------------------------------------------


def refused(paths: Any, options: DemOptions = DemOptions()) -> str:  # noqa: B008
    with pytest.raises(InputError) as caught:
        read_dem(paths, options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_missing_files_and_folders(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match=r"no\.tif"):
        read_dem(tmp_path / "no.tif")
    assert "folder" in refused(tmp_path)
    assert "no DEM file" in refused([])


def test_not_a_raster(tmp_path: Path) -> None:
    (tmp_path / "a.tif").write_text("hello")
    assert "cannot be read as a raster" in refused(tmp_path / "a.tif")
    (tmp_path / "empty.tif").write_bytes(b"")
    assert "cannot be read as a raster" in refused(tmp_path / "empty.tif")


def test_two_bands(tmp_path: Path) -> None:
    message = refused(write(tmp_path / "rg.tif", np.ones((2, 4, 4), np.int16)))
    assert "rg.tif has 2 bands" in message


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_no_place_on_the_map(tmp_path: Path) -> None:
    ones = np.ones((4, 4), np.int16)
    assert "--crs" in refused(write(tmp_path / "a.tif", ones, crs=None))
    assert "no georeference" in refused(write(tmp_path / "b.tif", ones, Affine.identity()))
    assert "Geocentric" in refused(write(tmp_path / "c.tif", ones, crs="EPSG:4978"))
    turned = Affine(30.0, 5.0, 0.0, 5.0, -30.0, 0.0)
    assert "gdalwarp" in refused(write(tmp_path / "d.tif", ones, turned))


@pytest.mark.parametrize("crs", ["EPSG:99999", "rubbish", ""])
def test_crs_that_is_not_understood(tmp_path: Path, crs: str) -> None:
    path = write(tmp_path / "a.tif", np.ones((4, 4), np.int16), crs=None)
    assert "not understood" in refused(path, DemOptions(crs=crs))


def test_another_planet_in_degrees(tmp_path: Path) -> None:
    transform = from_origin(10.0, 10.0, 0.01, 0.01)
    path = write(tmp_path / "moon.tif", np.ones((4, 4), np.int16), transform, "IAU_2015:30100")
    assert "Moon" in refused(path)


def test_nothing_but_voids(tmp_path: Path) -> None:
    path = write(tmp_path / "a.tif", np.full((4, 4), -9999.0, np.float32), nodata=-9999.0)
    assert "all samples are nodata" in refused(path)


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_truncated_tiff_and_no_chatter(tmp_path: Path, share: float) -> None:
    heights = np.random.default_rng(0).integers(0, 900, (300, 300)).astype(np.int16)
    path = write(
        tmp_path / "a.tif", heights, tiled=True, blockxsize=64, blockysize=64, compress="deflate"
    )
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "a.tif cannot be read as a raster" in refused(path)


def test_gdal_prints_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    write(path, np.ones((300, 300), np.int16), compress="deflate")
    path.write_bytes(path.read_bytes()[:600])
    program = (
        "import sys\nfrom skyline.errors import SkylineError\n"
        "from skyline.terrain.dem import read_dem\n"
        "try:\n    read_dem(sys.argv[1])\n"
        "except SkylineError as error:\n    sys.exit(error.exit_code)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "")


def test_damaged_gzip(tmp_path: Path) -> None:
    good = gzip.compress(np.zeros((1201, 1201), ">i2").tobytes(), 1)
    for number, content in enumerate(
        [b"not gzip", good[: len(good) // 2], good[:-300] + bytes(300)]
    ):
        path = tmp_path / f"N0{number}E000.hgt.gz"
        path.write_bytes(content)
        assert "cannot be unpacked" in refused(path)
    path = tmp_path / "N05E000.hgt.gz"
    path.write_bytes(gzip.compress(b"short"))
    assert "cannot be read as a raster" in refused(path)


def test_a_gzip_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("skyline.terrain.tiles.MAX_UNPACKED_BYTES", 1 << 20)
    path = tmp_path / "N05E000.hgt.gz"
    path.write_bytes(gzip.compress(bytes(1 << 22)))
    assert "gunzip" in refused(path)


@pytest.mark.parametrize("wrong", [{"max_void_samples": -1}, {"spike_m": 0.0}, {"spike_m": np.nan}])
def test_options_out_of_range(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError):
        replace(DemOptions(), **wrong)


def test_netcdf_by_its_gdal_name(shared_data: Path) -> None:
    path = shared_data / "sierra" / "lakes_topo.nc"
    assert f"netcdf:{path}:dem" in refused(path)
    field = read_dem(f"netcdf:{path}:dem")
    assert (field.rows, field.cols, field.spacing_m) == (168, 156, 50.0)
    assert field.frame.name == "EPSG:32611"
    assert field.provenance.files == (f"netcdf:{path}:dem",)
    assert "cannot be read" in refused(f"netcdf:{path}:nothing")


# --- size ------------------------------------------------------------------------------------


def test_a_metric_dem_is_read_in_little_more_than_its_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cleaning, "_STRIP_SAMPLES", 1 << 16)
    heights = np.random.default_rng(0).integers(0, 90, (2000, 2000)).astype(np.int16)
    heights[::100, ::100] = 32767
    path = write(tmp_path / "dem.tif", heights, tiled=True)
    read_dem(path)
    tracemalloc.start()
    field: HeightField = read_dem(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert field.provenance.despiked == 400
    assert peak < 1.25 * field.heights_m.nbytes


@pytest.mark.parametrize("spike_m", [80.0, np.inf])
def test_options_survive_json(spike_m: float) -> None:
    options = DemOptions(crs="EPSG:32632", reproject=True, spike_m=spike_m)
    assert DemOptions.from_json(json.loads(json.dumps(options.to_json()))) == options
    assert DemOptions.from_json(None) == DemOptions()


@pytest.mark.parametrize("options", [{"shell": "rm"}, ["crs"], 5, {"max_void_samples": "x"}])
def test_foreign_options_are_refused(options: object) -> None:
    with pytest.raises(InputError, match="DEM options are"):
        DemOptions.from_json(options)

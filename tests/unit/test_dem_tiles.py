"""Tiles of one grid become one elevation model."""

import gzip

import numpy as np
import pytest
from dem_scenes import tile_at
from rasterio.transform import from_origin
from scenes import at_m, write_dem

from skyline.terrain.dem import read_dem, read_files
from skyline.terrain.mosaic import border_step_m
from skyline.terrain.provenance import DemOptions

CALIFORNIA = [f"N{lat}W{lon}" for lat in (37, 36) for lon in (120, 119)]


def test_metric_tiles_become_one_grid_with_gaps_as_holes(tmp_path):
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
    twice = read_dem([*paths, tmp_path, tmp_path / ".." / tmp_path.name / paths[0].name])
    assert (twice.digest, len(twice.provenance.files)) == (field.digest, 3)
    (tmp_path / "readme.txt").write_text("A folder is the elevation files in it.")
    folder = read_dem(tmp_path)
    assert (folder.digest, folder.provenance.files) == (field.digest, tuple(sorted(counts.files)))


def test_a_void_on_a_border_is_read_from_the_neighbour(tmp_path):
    left = np.full((5, 5), 10.0, np.float32)
    left[2, 4] = np.nan
    right = np.full((5, 5), 10.0, np.float32)
    right[2, 0] = 10.5
    field = read_dem([tile_at(tmp_path, left, 0, 0), tile_at(tmp_path, right, 0, 4)])
    assert field.heights_m[2, 4] == 10.5
    assert field.provenance.filled == 0
    left[2, 4] = -32767.0  # A void that the file does not declare.
    again = read_dem([tile_at(tmp_path, left, 0, 0), tile_at(tmp_path, right, 0, 4)])
    np.testing.assert_array_equal(again.heights_m, field.heights_m)


def test_tiles_that_disagree_are_warned_of(tmp_path, caplog):
    first = tile_at(tmp_path, np.full((5, 5), 10.0, np.float32), 0, 0)
    close = tile_at(tmp_path, np.full((5, 5), 11.0, np.float32), 0, 4)
    assert read_dem([first, close]).heights_m[0, 4] == 10.0
    assert not caplog.records
    other = tile_at(tmp_path, np.full((5, 5), 42.0, np.float32), 4, 0)
    assert read_dem([other, first]).heights_m[4, 4] == 42.0
    assert len(caplog.records) == 1


@pytest.mark.parametrize(
    "name",
    ["davos/davos_srtm1_30m.tif", "everest/mt_everest_90m.tif", "rofental/dem_rofental_50.asc"],
)
def test_no_cut_through_real_terrain_is_a_wall(shared_data, name):
    options = DemOptions(crs="EPSG:32632") if name.endswith("asc") else DemOptions()
    heights, rng = read_files([shared_data / name], options).heights_m, np.random.default_rng(1)
    for turn in range(1000):
        whole = heights.T if turn % 2 else heights
        row, col = rng.integers(0, np.array(whole.shape) - (128, 4))
        lines = whole[row : row + 128, col : col + 4].T
        assert border_step_m(lines, np.ones(128, dtype=bool)) == 0.0


def sloping_m(lon, lat):
    """Return the heights (rows, columns) of a plane."""
    return 1000.0 + 900.0 * (lon - 9.0) + 700.0 * (lat[:, np.newaxis] - 50.0)


def tile_of_plane(path, west, north, seconds, crest_m=0.0):
    """Write a tile of 60 rows, 10 s apart, of the plane, with a crest in its middle."""
    step, rows, cols = 1.0 / 360.0, 60, round(3600 / seconds / 10)
    lon = west + seconds * np.arange(cols) * step
    heights = sloping_m(lon, north - np.arange(rows) * step).astype(np.float32)
    heights[30, cols // 2] += crest_m
    transform = from_origin(west - seconds * step / 2, north + step / 2, seconds * step, step)
    return write_dem(path, heights, "EPSG:4326", transform=transform)


def test_tiles_whose_columns_lie_closer_farther_south_become_one_grid(tmp_path):
    """As Copernicus' at 50 degrees: a plane has no seam, crests keep their height."""
    tiles = []
    for lon in (9, 10):
        tiles.append(tile_of_plane(tmp_path / f"n{lon}.tif", lon, 50.0 + 1 / 6, 1.5, 400.0))
        tiles.append(tile_of_plane(tmp_path / f"s{lon}.tif", lon, 50.0, 1.0))
    mosaic = read_files(tiles, DemOptions())
    grid = mosaic.grid
    assert (grid.rows, grid.cols, grid.step_east) == (120, 720, pytest.approx(1 / 360))
    lon = grid.west + np.arange(grid.cols) * grid.step_east
    lat = grid.north - np.arange(grid.rows) * grid.step_north
    off_m = mosaic.heights_m - sloping_m(lon, lat)
    assert np.isfinite(off_m[:, :-1]).all()
    rows, _ = np.nonzero(np.abs(off_m[:, :-1]) > 0.01)
    assert set(rows) == {30}
    for half in (off_m[30, :360], off_m[30, 360:]):
        assert half.max() == pytest.approx(400.0, abs=1.3)


def test_four_californian_tiles_have_no_seam(shared_data):
    paths = [shared_data / "california" / f"{name}.hgt.gz" for name in CALIFORNIA]
    mosaic = read_files(paths, DemOptions())
    assert (mosaic.grid.rows, mosaic.grid.cols) == (2401, 2401)
    heights = mosaic.heights_m
    merged = np.full(heights.shape, -32768, np.int16)
    for name, path in reversed(list(zip(CALIFORNIA, paths, strict=True))):
        raw = np.frombuffer(gzip.decompress(path.read_bytes()), ">i2").reshape(1201, 1201)
        row, col = 1200 * (37 - int(name[1:3])), 1200 * (120 - int(name[4:7]))
        merged[row : row + 1201, col : col + 1201] = raw
        # All of each tile is there; the file's own borders differ by a metre here and there.
        difference = np.abs(heights[row : row + 1201, col : col + 1201] - raw)
        assert not difference[1:-1, 1:-1].any()
        assert difference.max() <= 1.0
    np.testing.assert_array_equal(heights, merged)
    field = read_dem(paths)
    assert field.spacing_m == 70.0
    easting, northing = field.frame.from_lonlat(-118.2925, 36.5783)
    away_m = np.arange(-200, 201, 20)
    around = field.height_at(**at_m(np.meshgrid(easting + away_m, northing + away_m)))
    assert 4380.0 < around.max() < 4430.0  # Mount Whitney

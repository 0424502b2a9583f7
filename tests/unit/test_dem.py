"""Elevation files: places, heights and frames of their samples."""

import gzip

import numpy as np
import pytest
from pyproj import CRS
from rasterio.transform import Affine, from_origin
from scenes import UTM, at_deg, write_dem

from skyline.errors import InputError
from skyline.geodesy.map_frame import TRUE_DEG, Frame
from skyline.terrain.dem import read_dem, read_files
from skyline.terrain.field_files import save_field
from skyline.terrain.grid import Grid
from skyline.terrain.metric_dem import WarpSource
from skyline.terrain.provenance import DemOptions
from skyline.terrain.resampling import Warp, local_maxima


def plane(x, y):
    """A height that names its place: every flip and every shift changes it."""
    return 1000.0 + 0.25 * x - 0.5 * y


def plane_grid(rows, cols, transform):
    """Heights of the plane at pixel centres, relative to the grid's first corner."""
    row, col = np.mgrid[0:rows, 0:cols] + 0.5
    x = transform.a * col + transform.b * row
    y = transform.d * col + transform.e * row
    return plane(x, y).astype(np.float32)


@pytest.mark.parametrize("step_east", [30.0, -30.0])
@pytest.mark.parametrize("step_north", [-20.0, 20.0])
@pytest.mark.parametrize("tag", ["Area", "Point"])
def test_heights_are_where_the_file_puts_them(tmp_path, step_east, step_north, tag):
    transform = Affine(step_east, 0.0, 500_000.0, 0.0, step_north, 5_200_000.0)
    heights, tags = plane_grid(23, 31, transform), {"AREA_OR_POINT": tag}
    path = write_dem(tmp_path / "dem.tif", heights, tags=tags, transform=transform)
    field = read_dem(path)
    assert (field.rows, field.cols) == (23, 31)
    assert (field.spacing_east_m, field.spacing_north_m) == (30.0, 20.0)
    west, south, east, north = field.bounds_m
    corners_x = sorted([500_000.0 + 0.5 * step_east, 500_000.0 + 30.5 * step_east])
    corners_y = sorted([5_200_000.0 + 0.5 * step_north, 5_200_000.0 + 22.5 * step_north])
    assert [west, east, south, north] == [*corners_x, *corners_y]
    x, y = np.random.default_rng(0).uniform((west, south), (east, north), (200, 2)).T
    expected = plane(x - 500_000.0, y - 5_200_000.0)
    np.testing.assert_allclose(field.height_at(easting_m=x, northing_m=y), expected, atol=1e-3)
    assert field.provenance.files == (str(path.absolute()),)
    assert field.provenance.resampling == "none"
    assert field.frame.name == UTM


def write_hgt(path, heights):
    content = np.rint(heights).astype(">i2").tobytes()
    path.write_bytes(gzip.compress(content, 1) if path.suffix == ".gz" else content)
    return path


def degree_plane(lon, lat):
    """Whole metres at each sample of a 3 arc-second tile."""
    return 700.0 + 1200.0 * lon + 1200.0 * lat


@pytest.mark.parametrize(
    ("names", "south", "west"),
    [
        (["N46E009.hgt.gz"], 46, 9),
        (["S45E170.hgt.gz"], -45, 170),
        (["N00W001.hgt"], 0, -1),
        (["N60E179.hgt.gz", "N60W180.hgt.gz"], 60, 179),
    ],
)
def test_degrees_are_warped_to_where_they_belong(tmp_path, names, south, west):
    sample = np.arange(1201) / 1200.0
    for name in names:
        origin = (int(name[4:7]) * (1 if name[3] == "E" else -1) - west) % 360
        write_hgt(tmp_path / name, degree_plane(origin + sample, 1.0 - sample[:, np.newaxis]))
    field = read_dem([tmp_path / name for name in names])
    spacing_m = {46: 60.0, -45: 65.0, 0: 90.0}.get(south, 45.0)
    assert field.spacing_m == spacing_m
    rng = np.random.default_rng(0)
    lon, lat = rng.uniform(0.02, len(names) - 0.02, 500), rng.uniform(0.02, 0.98, 500)
    found = field.height_at(lon=west + lon, lat=south + lat)
    # The remaining difference is the curvature of the plane within a cell of the target.
    np.testing.assert_allclose(found, degree_plane(lon, lat), atol=0.02)
    centre = Frame.local(lon=(west + 0.5 * len(names) + 180.0) % 360.0 - 180.0, lat=south + 0.5)
    assert field.frame == centre
    # Samples stand at whole multiples of the spacing.
    assert field.west_m % spacing_m == 0.0
    assert field.north_m % spacing_m == 0.0


HEADER = "ncols 3\nnrows 2\nxllcorner 1000\nyllcorner 2000\ncellsize 10\nNODATA_value -1\n"
POINTS = "1005 2015 1\n1015 2015 2\n1025 2015 3\n1005 2005 4\n1015 2005 5\n1025 2005 6"


@pytest.mark.parametrize(
    ("name", "text"), [("dem.asc", HEADER + "1 2 3\n4 5 6\n"), ("points.xyz", POINTS)]
)
def test_a_text_is_a_grid_whose_crs_is_the_option_s(tmp_path, name, text):
    path = tmp_path / name
    path.write_text(text)
    field = read_dem(path, DemOptions(crs="EPSG:21781"))
    np.testing.assert_array_equal(field.heights_m, [[1, 2, 3], [4, 5, 6]])
    assert field.bounds_m == (1005.0, 2005.0, 1025.0, 2015.0)
    assert field.frame.name == "EPSG:21781"
    with pytest.raises(InputError):
        read_dem(path)


def test_the_file_s_own_crs_wins_with_a_warning(tmp_path, caplog):
    path = write_dem(tmp_path / "dem.tif", np.ones((3, 3), np.float32))
    assert read_dem(path, DemOptions(crs="EPSG:32633")).frame.name == UTM
    assert len(caplog.records) == 1
    caplog.clear()
    read_dem(path, DemOptions(crs=UTM))
    assert not caplog.records


def keys_weights(at, count):
    """Return the weights (..., count) of samples at 0, 1, 2, ... in cubic convolution."""
    x = np.abs(at[..., np.newaxis] - np.arange(count))
    near = 1.5 * x**3 - 2.5 * x**2 + 1.0
    far = -0.5 * x**3 + 2.5 * x**2 - 4.0 * x + 2.0
    return np.where(x <= 1.0, near, np.where(x < 2.0, far, 0.0))


def convolved(heights, row, col):
    """Interpolate heights, never beyond the four samples around."""
    weights = keys_weights(row, len(heights)), keys_weights(col, heights.shape[1])
    found = np.einsum("ijr,ijc,rc->ij", *weights, heights)
    top, left = row.astype(int), col.astype(int)
    around = np.stack([heights[top + i, left + j] for i in (0, 1) for j in (0, 1)])
    return np.clip(found, around.min(axis=0), around.max(axis=0))


def test_warp_is_keys_cubic_convolution_but_for_summits_which_stay_as_high():
    heights = np.random.default_rng(5).uniform(0.0, 1000.0, (50, 60)).astype(np.float32)
    step = 1.0 / 1200.0
    grid = Grid(9.0, 47.0, step, step, 50, 60)
    frame = Frame.local(lon=9.0 + 29.5 * step, lat=47.0 - 24.5 * step)
    source = WarpSource(heights, Warp(grid, CRS.from_epsg(4326), frame, 70.0))
    warped = source.in_memory().whole()
    target = source.warp.target
    row, col = np.mgrid[5 : target.rows - 5, 5 : target.cols - 5]
    lon, lat = frame.to_lonlat(target.west + 70.0 * col, target.north - 70.0 * row)
    apart = warped[row, col] - convolved(heights, (47.0 - lat) / step, (lon - 9.0) / step)
    lifted = np.zeros(warped.shape, dtype=bool)
    for summit_row, summit_col in zip(*local_maxima(heights), strict=True):
        easting, northing = frame.from_lonlat(9.0 + step * summit_col, 47.0 - step * summit_row)
        nearest = round((target.north - northing) / 70.0), round((easting - target.west) / 70.0)
        lifted[nearest] = True
    assert np.abs(apart[~lifted[row, col]]).max() < 1e-2
    assert apart.min() > -1e-2


@pytest.mark.parametrize(
    ("crs", "place", "error_deg"),
    [
        # The scale k of a conformal map turns a slope of 45 degrees by half of |k - 1| radians.
        (UTM, (9.0, 46.0), 0.011),  # 0.9996 on the central meridian
        (UTM, (12.0, 0.3), 0.028),  # 1.00097 on the zone's border
        (UTM, (15.0, 46.0), 0.064),  # 1.0022 on the next zone's central meridian
        ("EPSG:2056", (6.1, 46.2), 0.0026),
        ("EPSG:2154", (6.9, 45.9), 0.026),
        ("EPSG:3035", (10.0, 46.5), 0.12),  # equal-area: 1.0010 to one side, 0.9990 to the other
        ("EPSG:3413", (15.0, 78.0), 0.56),
        ("EPSG:3857", (9.8, 46.8), 10.8),
        ("EPSG:3857", (37.3, -0.5), 0.38),  # on the equator a sphere's map bends the ellipsoid's
    ],
)
def test_a_map_is_kept_where_its_angles_are_true(tmp_path, caplog, crs, place, error_deg):
    x, y = Frame.from_crs(crs).from_lonlat(*place)
    transform = from_origin(float(x) - 750.0, float(y) + 750.0, 30.0, 30.0)
    slope = plane_grid(50, 50, transform)
    field = read_dem(write_dem(tmp_path / "dem.tif", slope, crs, transform=transform))
    own = Frame.from_crs(crs).angle_error_deg(easting_m=x, northing_m=y)
    assert float(own) == pytest.approx(error_deg, rel=0.1)
    assert field.frame.is_local == (error_deg > TRUE_DEG)
    assert len(caplog.records) == (error_deg > TRUE_DEG)
    if field.frame.is_local:
        assert field.frame.angle_error_deg(easting_m=0.0, northing_m=0.0) < 1e-5


def test_albers_is_warped(shared_data):
    path = shared_data / "sierra" / "sierra_ansel_adams_30m_albers.tif"
    warped, mosaic = read_dem(path), read_files([path], DemOptions())
    assert (warped.spacing_m, warped.frame.is_local) == (30.0, True)
    row, col = np.array([300, 600]), np.array([500, 200])
    x = mosaic.grid.west + 30.0 * col
    y = mosaic.grid.north - 30.0 * row
    there = at_deg(Frame.from_crs("ESRI:102003").to_lonlat(x, y))
    np.testing.assert_allclose(warped.height_at(**there), mosaic.heights_m[row, col], atol=5.0)


def test_a_saved_field_is_read_as_it_was(tmp_path):
    heights = np.random.default_rng(2).uniform(0.0, 900.0, (40, 50)).astype(np.float32)
    heights[20:30, 20:32] = np.nan
    transform = from_origin(9.5, 46.5, 1 / 3600, 1 / 3600)
    field = read_dem(write_dem(tmp_path / "dem.tif", heights, "EPSG:4326", transform=transform))
    path = tmp_path / "dem.terrain"
    save_field(field, path)
    again = read_dem(path)
    assert again.digest == field.digest
    assert again.provenance == field.provenance

"""Elevation files that cannot be used are refused in one line."""

import gzip
import subprocess
import sys

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine, from_origin
from scenes import write_dem

from skyline.errors import InputError, MissingFileError
from skyline.terrain.dem import read_dem
from skyline.terrain.provenance import DemOptions


def refused(paths, options=DemOptions()):  # noqa: B008
    with pytest.raises(InputError) as caught:
        read_dem(paths, options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(MissingFileError, match=r"no\.tif"):
        read_dem(tmp_path / "no.tif")
    assert "has no elevation files" in refused(tmp_path)
    assert "no DEM file" in refused([])
    assert "without a name" in refused("")
    for given in (None, b"a.tif", np.ones((4, 4)), np.array(1.0), [None]):
        assert "HeightField itself an array" in refused(given)
    with pytest.raises(MissingFileError, match="no file"):
        read_dem("x" * 300 + ".tif")
    with pytest.raises(MissingFileError, match="name its folder, or the files"):
        read_dem(tmp_path / "*.tif")
    (tmp_path / "._a.tif").write_bytes(b"hidden")
    (tmp_path / "b.tif").mkdir()
    assert "has no elevation files" in refused(tmp_path)
    (tmp_path / "c.tif").symlink_to(tmp_path / "gone.tif")
    with pytest.raises(MissingFileError, match=r"c\.tif is a link"):
        read_dem(tmp_path)


ONES = np.ones((4, 4), np.int16)
VOIDS = np.full((4, 4), -9999.0, np.float32)
TURNED = Affine(30.0, 5.0, 0.0, 5.0, -30.0, 0.0)
MOON = {"transform": from_origin(10.0, 10.0, 0.01, 0.01), "crs": "IAU_2015:30100"}


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
@pytest.mark.parametrize(
    ("heights", "options", "given", "said"),
    [
        (np.ones((4, 4, 2), np.int16), {}, None, "a.tif has 2 bands"),
        (ONES, {"crs": None}, None, "--crs"),
        (ONES, {"crs": None}, "EPSG:99999", "not understood"),
        (ONES, {"crs": None}, "rubbish", "not understood"),
        (ONES, {"transform": Affine.identity()}, None, "no georeference"),
        (ONES, {"crs": "EPSG:4978"}, None, "Geocentric"),
        (ONES, {"transform": TURNED}, None, "gdalwarp"),
        (ONES, MOON, None, "Moon"),
        (VOIDS, {"nodata": -9999.0}, None, "all samples are nodata"),
        (ONES.astype(np.complex64), {}, None, "expected real heights"),
        (ONES - 32000, {}, None, "beyond 30000 m"),
        (ONES, {"transform": Affine(np.nan, 0.0, 0.0, 0.0, np.nan, 0.0)}, None, "no georeference"),
    ],
)
def test_a_raster_that_is_no_dem(tmp_path, heights, options, given, said):
    assert said in refused(write_dem(tmp_path / "a.tif", heights, **options), DemOptions(crs=given))


def test_a_grid_without_both_corners(tmp_path):
    """GDAL places it at 0, 0 without a word."""
    header = "ncols 2\nnrows 2\nxllcenter 5e5\nyllcorner 5e6\ncellsize 30\n"
    (tmp_path / "a.asc").write_text(header + "1 2\n3 4\n")
    assert "lacks a corner" in refused(tmp_path / "a.asc", DemOptions(crs="EPSG:32632"))


def test_a_scale_of_zero(tmp_path):
    path = write_dem(tmp_path / "a.tif", ONES)
    with rasterio.open(path, "r+") as dataset:
        dataset.scales = (0.0,)
    assert "has the scale 0" in refused(path)


def test_not_a_raster(tmp_path):
    for content in (b"hello", b""):
        (tmp_path / "a.tif").write_bytes(content)
        assert "cannot be read as a raster" in refused(tmp_path / "a.tif")


def test_gdal_prints_nothing(tmp_path):
    path = tmp_path / "a.tif"
    write_dem(path, np.ones((300, 300), np.int16), compress="deflate")
    path.write_bytes(path.read_bytes()[:600])
    assert "a.tif cannot be read as a raster" in refused(path)
    program = f"""
from skyline import InputError, read_dem
try:
    read_dem({str(path)!r})
except InputError as error:
    raise SystemExit(error.exit_code)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (2, b"", b"")


def test_damaged_gzip(tmp_path):
    good, path = gzip.compress(np.zeros((1201, 1201), ">i2").tobytes(), 1), tmp_path / "N0E0.hgt.gz"
    for content in (b"not gzip", good[: len(good) // 2], good[:-300] + bytes(300)):
        path.write_bytes(content)
        assert "cannot be unpacked" in refused(path)
    path.write_bytes(b"")
    assert "is empty; fetch it again" in refused(path)
    path.write_bytes(gzip.compress(b"short"))
    assert "cannot be read as a raster" in refused(path)


def test_netcdf_by_its_gdal_name(shared_data):
    path = shared_data / "sierra" / "lakes_topo.nc"
    assert f"netcdf:{path}:dem" in refused(path)
    field = read_dem(f"netcdf:{path}:dem")
    assert (field.rows, field.cols, field.spacing_m) == (168, 156, 50.0)
    assert field.frame.name == "EPSG:32611"
    assert field.provenance.files == (f"netcdf:{path}:dem",)
    assert "cannot be read" in refused(f"netcdf:{path}:nothing")

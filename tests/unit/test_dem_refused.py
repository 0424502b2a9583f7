"""Elevation files that cannot be used are refused in one line."""

import fcntl
import gzip
import subprocess
import sys

import numpy as np
import pytest
from dem_files import write
from rasterio.transform import Affine, from_origin

from skyline.errors import InputError, MissingFileError
from skyline.terrain.dem import DemOptions, read_dem


def refused(paths, options=DemOptions()):  # noqa: B008
    with pytest.raises(InputError) as caught:
        read_dem(paths, options)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(MissingFileError, match=r"no\.tif"):
        read_dem(tmp_path / "no.tif")
    assert "folder" in refused(tmp_path)
    assert "no DEM file" in refused([])


def test_not_a_raster(tmp_path):
    (tmp_path / "a.tif").write_text("hello")
    assert "cannot be read as a raster" in refused(tmp_path / "a.tif")
    (tmp_path / "empty.tif").write_bytes(b"")
    assert "cannot be read as a raster" in refused(tmp_path / "empty.tif")


def test_two_bands(tmp_path):
    message = refused(write(tmp_path / "rg.tif", np.ones((2, 4, 4), np.int16)))
    assert "rg.tif has 2 bands" in message


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_no_place_on_the_map(tmp_path):
    ones = np.ones((4, 4), np.int16)
    assert "--crs" in refused(write(tmp_path / "a.tif", ones, crs=None))
    assert "no georeference" in refused(write(tmp_path / "b.tif", ones, Affine.identity()))
    assert "Geocentric" in refused(write(tmp_path / "c.tif", ones, crs="EPSG:4978"))
    turned = Affine(30.0, 5.0, 0.0, 5.0, -30.0, 0.0)
    assert "gdalwarp" in refused(write(tmp_path / "d.tif", ones, turned))


@pytest.mark.parametrize("crs", ["EPSG:99999", "rubbish"])
def test_crs_that_is_not_understood(tmp_path, crs):
    path = write(tmp_path / "a.tif", np.ones((4, 4), np.int16), crs=None)
    assert "not understood" in refused(path, DemOptions(crs=crs))


def test_another_planet_in_degrees(tmp_path):
    transform = from_origin(10.0, 10.0, 0.01, 0.01)
    path = write(tmp_path / "moon.tif", np.ones((4, 4), np.int16), transform, "IAU_2015:30100")
    assert "Moon" in refused(path)


def test_nothing_but_voids(tmp_path):
    path = write(tmp_path / "a.tif", np.full((4, 4), -9999.0, np.float32), nodata=-9999.0)
    assert "all samples are nodata" in refused(path)


def test_truncated_tiff_and_no_chatter(tmp_path):
    heights = np.random.default_rng(0).integers(0, 900, (300, 300)).astype(np.int16)
    path = write(
        tmp_path / "a.tif", heights, tiled=True, blockxsize=64, blockysize=64, compress="deflate"
    )
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert "a.tif cannot be read as a raster" in refused(path)


def test_gdal_prints_nothing(tmp_path):
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


def test_damaged_gzip(tmp_path):
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


def test_netcdf_in_a_folder_without_file_locks(shared_data, tmp_path):
    """HDF5 would lock it to read it, and fails where that fails, as it does here."""
    path = tmp_path / "lakes.nc"
    path.write_bytes((shared_data / "sierra" / "lakes_topo.nc").read_bytes())
    command = [sys.executable, "-m", "skyline", "info", f"netcdf:{path}:dem"]
    with path.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_netcdf_by_its_gdal_name(shared_data):
    path = shared_data / "sierra" / "lakes_topo.nc"
    assert f"netcdf:{path}:dem" in refused(path)
    field = read_dem(f"netcdf:{path}:dem")
    assert (field.rows, field.cols, field.spacing_m) == (168, 156, 50.0)
    assert field.frame.name == "EPSG:32611"
    assert field.provenance.files == (f"netcdf:{path}:dem",)
    assert "cannot be read" in refused(f"netcdf:{path}:nothing")

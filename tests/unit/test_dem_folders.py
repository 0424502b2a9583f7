"""Folders and archives of elevation files: all that GDAL reads is read, the rest is named."""

import gzip
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio
from dem_scenes import (
    SIZE,
    STEP_M,
    TILE_NORTH_M,
    TILE_WEST_M,
    WHOLE,
    clutter,
    east,
    packed,
    west_tile,
)
from scenes import UTM

from skyline import Matcher, build_places
from skyline.errors import InputError, MissingFileError
from skyline.files.disk import version_of
from skyline.terrain.dem import read_dem
from skyline.terrain.dem_files import dem_names
from skyline.terrain.provenance import DemOptions


@pytest.fixture
def folder(tmp_path):
    """A folder with the western tile."""
    return west_tile(tmp_path / "dems")


def as_points(folder):
    row, col = np.mgrid[0:SIZE, 0:SIZE]
    x = TILE_WEST_M + (SIZE + col + 0.5) * STEP_M
    y = TILE_NORTH_M - (row + 0.5) * STEP_M
    lines = np.stack([x, y, WHOLE[:, SIZE:]], axis=-1).reshape(-1, 3)
    np.savetxt(folder / "b.xyz", lines, fmt="%.1f %.1f %d")


def as_gzip(folder):
    plain = east(folder / "b.tif")
    (folder / "b.tif.gz").write_bytes(gzip.compress(plain.read_bytes()))
    plain.unlink()


def as_zipped_bil(folder):
    east(folder / "b.bil", driver="EHdr")
    packed(folder / "b.zip", *folder.glob("b.*"))


LOSSLESS = {"QUALITY": 100, "REVERSIBLE": True}
FORMS = {
    "img": lambda folder: east(folder / "b.img", driver="HFA"),
    "bil": lambda folder: east(folder / "b.bil", driver="EHdr"),
    "jp2": lambda folder: east(
        folder / "b.jp2", driver="JP2OpenJPEG", QUALITY=100, REVERSIBLE=True
    ),
    "gpkg": lambda folder: east(folder / "b.gpkg", driver="GPKG"),
    "gtiff": lambda folder: east(folder / "b.gtiff"),
    "no ending": lambda folder: east(folder / "b"),
    "subfolder": lambda folder: east(folder / "more" / "b.tif"),
    "xyz": as_points,
    "tif.gz": as_gzip,
    "zip": lambda folder: packed(folder / "b.zip", east(folder / "b.tif")),
    "zip of bil": as_zipped_bil,
}


@pytest.mark.parametrize("form", FORMS)
def test_a_tile_is_read_in_every_form(folder, caplog, form):
    FORMS[form](folder)
    field = read_dem(folder, DemOptions(crs=UTM) if form == "xyz" else DemOptions())
    np.testing.assert_array_equal(field.heights_m, WHOLE)
    assert not caplog.records
    again = read_dem(field.provenance.files, DemOptions(crs=UTM))
    assert again.digest == field.digest


@pytest.mark.parametrize(
    ("archive", "member"),
    [
        ("N46E010.hgt.zip", "N46E010.hgt"),
        ("N46E010.SRTMGL1.hgt.zip", "N46E010.SRTMGL1.hgt"),
        ("N46E010.zip", "N46E010.hgt"),
        ("L32.zip", "L32/N46E010.hgt"),
    ],
)
def test_tiles_of_a_degree_are_read_in_archives(tmp_path, archive, member):
    heights = (700.0 + np.add.outer(np.arange(1201), np.arange(1201)) / 8.0).astype(">i2")
    (tmp_path / "N46E009.hgt").write_bytes(heights.tobytes())
    with zipfile.ZipFile(tmp_path / archive, "w") as made:
        made.writestr(member, heights[:, ::-1].tobytes())
    field = read_dem(tmp_path)
    west, _, east_deg, _ = field.box_deg
    assert (west, east_deg) == (pytest.approx(9.0, abs=0.02), pytest.approx(11.0, abs=0.02))
    assert len(field.provenance.files) == 2
    assert field.provenance.hollow == 0


def test_an_archive_is_named_like_a_folder(folder):
    east(folder / "b.tif")
    field = read_dem(folder)
    both = folder / "both.zip"
    packed(both, folder / "a.tif", folder / "b.tif")
    assert read_dem(both).digest == field.digest
    assert [name.rpartition("/")[2] for name in dem_names(both)] == ["a.tif", "b.tif"]


def test_a_store_reads_its_archive_again(folder, tmp_path):
    packed(folder / "a.zip", folder / "a.tif")
    field, store = read_dem(folder), tmp_path / "store.h5"
    build_places(field, store, 150.0)
    with Matcher(store) as matcher:
        assert matcher.terrain.digest == field.digest
    (name,) = field.provenance.files
    assert version_of(name) == version_of(folder / "a.zip")


def test_sidecar_and_hidden_files_are_passed_over(folder, caplog):
    east(folder / "b.bil", driver="EHdr")
    (folder / "a.tif.aux.xml").write_text("<PAMDataset></PAMDataset>")
    with (
        rasterio.Env(TIFF_USE_OVR=True, GDAL_TIFF_INTERNAL_MASK=False),
        rasterio.open(folder / "a.tif", "r+") as raster,
    ):
        raster.build_overviews([2])
        raster.write_mask(np.full((SIZE, SIZE), 255, np.uint8))
    for name in ("a.tif.md5", "a.tfw", "b.dbf", "b.txt", "a.tif.vat.dbf"):
        (folder / name).write_text("30.0\n")
    # GDAL takes every file beside a header of its name for samples.
    (folder / "b.pdf").write_bytes(bytes(5000))
    for hidden in (".b", "__MACOSX", "@eaDir"):
        east(folder / hidden / "c.tif", np.zeros((SIZE, SIZE), np.int16))
    (folder / "._a.tif").write_bytes(b"\0")
    (folder / "again").symlink_to(folder, target_is_directory=True)
    os.mkfifo(folder / "pipe.tif")
    np.testing.assert_array_equal(read_dem(folder).heights_m, WHOLE)
    assert [path.name for path in map(Path, dem_names(folder))] == ["a.tif", "b.bil"]
    assert not caplog.records


def test_what_holds_no_heights_is_left_out(folder):
    clutter(folder)
    np.testing.assert_array_equal(read_dem(folder).heights_m, WHOLE)


def test_a_folder_without_heights_is_refused(folder):
    (folder / "a.tif").unlink()
    (folder / "README.txt").write_text("tiles of the east")
    with pytest.raises(InputError):
        read_dem(folder)


def test_a_model_of_eight_bits_is_read_where_nothing_is_deeper(folder):
    (folder / "a.tif").unlink()
    canopy = np.full((SIZE, SIZE), 17, np.uint8)
    east(folder / "canopy.tif", canopy)
    np.testing.assert_array_equal(read_dem(folder).heights_m, canopy)


def test_a_raster_of_other_values_over_the_tiles_is_refused(folder):
    east(folder / "b.tif")
    slope_deg = np.full((SIZE, SIZE), 30.0, np.float32)
    east(folder / "c_slope.tif", slope_deg)
    with pytest.raises(InputError):
        read_dem(folder)


def test_a_link_to_nothing_is_an_error_if_it_is_named_as_a_tile(folder, caplog):
    (folder / "gone.txt").symlink_to(folder / "nothing")
    assert len(dem_names(folder)) == 1
    assert len(caplog.records) == 1
    (folder / "gone.img").symlink_to(folder / "nothing")
    with pytest.raises(MissingFileError):
        read_dem(folder)


def test_a_raster_of_a_netcdf_file_is_read_by_its_gdal_name(shared_data):
    name = f"netcdf:{shared_data / 'sierra' / 'lakes_topo.nc'}:dem"
    field = read_dem(name)
    assert (field.rows, field.cols, field.spacing_m) == (168, 156, 50.0)
    assert field.frame.name == "EPSG:32611"
    assert field.provenance.files == (name,)

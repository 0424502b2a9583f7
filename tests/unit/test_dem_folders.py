"""Folders and archives of elevation files: all that GDAL reads is read, the rest is named."""

import gzip
import json
import os
import zipfile
from pathlib import Path

import geopandas
import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin
from scenes import UTM, write_dem

from skyline import Matcher, build_places
from skyline.errors import InputError, MissingFileError
from skyline.files import version_of
from skyline.terrain.dem import read_dem
from skyline.terrain.dem_files import dem_names
from skyline.terrain.provenance import DemOptions

SIZE = 20
WHOLE = (1000.0 + np.random.default_rng(0).uniform(0.0, 20.0, (SIZE, 2 * SIZE))).astype(np.int16)
"""Two tiles side by side: the western one is a.tif in every folder."""
WEST_M, NORTH_M, STEP_M = 500_000.0, 5_200_000.0, 30.0


def east(path, heights=WHOLE[:, SIZE:], driver="GTiff", crs=UTM, **options):
    """Write the eastern tile, or another raster on its ground."""
    heights = np.atleast_3d(heights).transpose(2, 0, 1)
    transform = from_origin(WEST_M + SIZE * STEP_M, NORTH_M, STEP_M, STEP_M)
    path.parent.mkdir(exist_ok=True)
    with rasterio.open(
        path, "w", driver=driver, dtype=heights.dtype, count=len(heights), height=SIZE, width=SIZE,
        crs=crs, transform=transform, **options,
    ) as raster:  # fmt: skip
        raster.write(heights)
    return path


def packed(path, *files):
    """Put files into a zip archive and remove them."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            archive.write(file, f"inside/{file.name}")
            file.unlink()


@pytest.fixture
def folder(tmp_path):
    """A folder with the western tile."""
    folder = tmp_path / "dems"
    folder.mkdir()
    transform = from_origin(WEST_M, NORTH_M, STEP_M, STEP_M)
    write_dem(folder / "a.tif", WHOLE[:, :SIZE], transform=transform)
    return folder


def as_points(folder):
    row, col = np.mgrid[0:SIZE, 0:SIZE]
    x = WEST_M + (SIZE + col + 0.5) * STEP_M
    y = NORTH_M - (row + 0.5) * STEP_M
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
    assert caplog.messages == []
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
        made.writestr(member, heights.tobytes())
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
    assert caplog.messages == []


def test_what_holds_no_heights_is_left_out_by_name(folder, caplog):
    colours = np.random.default_rng(1).integers(0, 255, (SIZE, SIZE, 3)).astype(np.uint8)
    east(folder / "b.tif")
    east(folder / "map.tif", colours)
    east(folder / "thumbnail.jpg", colours, driver="JPEG")
    east(folder / "b_hillshade.tif", colours[..., 0])
    (folder / "README.txt").write_text("tiles of the east")
    (folder / "peaks.csv").write_text("lon,lat,height\n9.1,46.2,3000\n9.25,46.9,20\n9.4,46.7,1\n")
    (folder / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0" + bytes(500))
    tracks = geopandas.GeoDataFrame(geometry=geopandas.points_from_xy([9.1], [46.2]), crs=4326)
    tracks.to_file(folder / "tracks.gpkg")
    (folder / "item.json").write_text(json.dumps({"stac_version": "1.0.0", "type": "Feature"}))
    for number in range(3):
        (folder / f"note{number}.md").write_text("#")
    np.testing.assert_array_equal(read_dem(folder).heights_m, WHOLE)
    (line,) = caplog.messages
    assert line == (
        f"{folder}: 11 files are left out, which are no rasters of heights: README.txt, Thumbs.db, "
        "b_hillshade.tif and 1 more .tif, item.json, note0.md and 2 more .md, peaks.csv, "
        "thumbnail.jpg, tracks.gpkg; name one to have it read"
    )
    for name in (*folder.glob("*.tif"), folder / "thumbnail.jpg"):
        if name.name not in ("a.tif", "b.tif"):
            name.unlink()
    (folder / "a.tif").unlink()
    (folder / "b.tif").unlink()
    with pytest.raises(InputError, match=r"no elevation files among README\.txt, .*; name"):
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
    with pytest.raises(InputError, match=r"c_slope\.tif covers the same ground as .* name the"):
        read_dem(folder)


POINTS = "".join(f"{x} {y} 5\n" for y in range(5) for x in (0, 1, 30, 47))
"""A text that GDAL reads as a grid of 5 x 48, with zeros between the points."""


def damaged_zip(folder):
    packed(folder / "b.zip", east(folder / "b.tif", compress=None))
    content = bytearray((folder / "b.zip").read_bytes())
    content[content.index(b"b.tif") + 400] ^= 255
    (folder / "b.zip").write_bytes(content)


DOUBTS = {
    "cut short": lambda folder: (folder / "b").write_bytes((folder / "a.tif").read_bytes()[:100]),
    "empty": lambda folder: (folder / "b.tif").write_bytes(b""),
    "a page": lambda folder: (folder / "N46E010.hgt").write_text("<html>no</html>"),
    "no archive": lambda folder: (folder / "b.hgt.zip").write_text("<html>no</html>"),
    "damaged archive": damaged_zip,
    "not unpacked": lambda folder: (folder / "b.7z").write_bytes(b"7z\xbc\xaf\x27\x1c" + bytes(99)),
    "points off a grid": lambda folder: (folder / "b.xyz").write_text(
        "0 0 5\n1 0 5\n0 7 5\n16 7 5\n"
    ),
    "short samples": lambda folder: east(folder / "b.bil", driver="EHdr").write_bytes(bytes(99)),
    "no place": lambda folder: write_dem(
        folder / "b.tif", WHOLE, None, transform=rasterio.Affine.identity()
    ),
}


@pytest.mark.parametrize("doubt", DOUBTS)
@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_a_file_that_may_be_a_tile_stops_the_folder(folder, doubt):
    DOUBTS[doubt](folder)
    with pytest.raises(InputError, match=r"dems/(b|N46E010)") as refused:
        read_dem(folder, DemOptions(crs=UTM))
    assert "\n" not in str(refused.value)


def test_a_link_to_nothing_is_an_error_if_it_is_named_as_a_tile(folder, caplog):
    (folder / "gone.txt").symlink_to(folder / "nothing")
    assert len(dem_names(folder)) == 1
    assert "gone.txt" in caplog.text
    (folder / "gone.img").symlink_to(folder / "nothing")
    with pytest.raises(MissingFileError, match=r"gone\.img is a link"):
        read_dem(folder)


def test_several_rasters_in_one_file_are_listed(folder, shared_data):
    (folder / "lakes.nc").symlink_to(shared_data / "sierra" / "lakes_topo.nc")
    with pytest.raises(InputError, match=r"holds several rasters \(netcdf:.*:dem.* name its"):
        read_dem(folder)


def test_points_off_a_grid_are_refused_by_name(tmp_path):
    path = tmp_path / "points.txt"
    path.write_text(POINTS)
    with pytest.raises(InputError, match="lie apart on a grid of 5 x 48"):
        read_dem(path, DemOptions(crs=UTM))

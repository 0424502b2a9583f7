"""Panoramas: the notes of XMP and traces, and fields of view that are too wide."""

import numpy as np
from photo_scenes import make_scene
from PIL import Image
from PIL.ExifTags import IFD, Base
from xmp_packets import ATTRIBUTES, xmp_packet

from skyline.camera.projection import Projection
from skyline.photo.read import read_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.photo.trace import write_trace

CYLINDER, SPHERE = Projection.CYLINDRICAL, Projection.EQUIRECTANGULAR


def test_panorama_file_says_its_own_span(tmp_path):
    noted = {"ProjectionType": "cylindrical", "FullPanoWidthPixels": 960 * 3}
    noted |= {"CroppedAreaImageWidthPixels": 960, "CroppedAreaImageHeightPixels": 240}
    xmp = xmp_packet(ATTRIBUTES, **noted).encode()
    image = make_scene("clear", 104, 960, 240).image
    Image.fromarray(image).save(tmp_path / "wide.jpg", quality=95, xmp=xmp)
    skyline = read_skyline(tmp_path / "wide.jpg")
    assert (skyline.projection, skyline.fov_deg) == (CYLINDER, 120.0)
    # Options take precedence over notes of the file.
    chosen = read_skyline(tmp_path / "wide.jpg", 100.0, projection=SPHERE)
    assert (chosen.projection, chosen.fov_deg, chosen.lens) == (SPHERE, 100.0, None)
    assert read_skyline(tmp_path / "wide.jpg", projection=SPHERE).fov_deg == 120.0
    assert read_skyline(tmp_path / "wide.jpg", projection=Projection.PERSPECTIVE).fov_deg is None


def test_a_phone_s_panorama_is_known_as_one(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(IFD.Exif).update({Base.CustomRendered: 6, Base.FocalLengthIn35mmFilm: 28})
    scene = make_scene("clear", 104, 960, 240)
    Image.fromarray(scene.image).save(tmp_path / "swept.jpg", quality=95, exif=exif)
    skyline = read_skyline(tmp_path / "swept.jpg")
    assert skyline.projection is CYLINDER
    assert 200.0 < skyline.fov_deg < 300.0
    assert skyline.lens.fov_sd_deg > 20.0
    chosen = read_skyline(tmp_path / "swept.jpg", projection=Projection.PERSPECTIVE)
    assert (chosen.projection, chosen.fov_deg, chosen.lens) == (Projection.PERSPECTIVE, None, None)


def test_a_trace_notes_its_projection(tmp_path):
    path = tmp_path / "wide.csv"
    rows = np.r_[np.nan, np.linspace(10.0, 40.0, 479)]
    drawn = PhotoSkyline(rows, np.isfinite(rows) * 1.0, 480, 100, 240.0, CYLINDER)
    write_trace(drawn, path)
    read = read_skyline(path)
    assert (read.width_px, read.fov_deg, read.projection) == (480, 240.0, CYLINDER)
    np.testing.assert_array_equal(read.row_px, rows)
    chosen = read_skyline(path, 200.0, projection=SPHERE)
    assert (chosen.fov_deg, chosen.projection) == (200.0, SPHERE)

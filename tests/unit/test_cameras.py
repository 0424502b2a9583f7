"""The fields of view of real cameras' photos, original, upright, resized and cropped."""

import math

import pytest
from PIL.ExifTags import Base

from skyline.photo.lens import lens_of

pytest.importorskip("lensfunpy", reason="no database of sensors on this machine")

CAMERAS = [
    ("Canon EOS 5D", 35.8, 4368, 2912, 24.0, "plane"),
    ("NIKON D700", 36.0, 4256, 2832, 24.0, "film"),
    ("ILCE-7M2", 35.8, 6000, 4000, 31.0, "film plane"),
    ("Canon EOS 40D", 22.2, 3888, 2592, 18.0, "plane"),
    ("E-M5            ", 17.3, 4608, 3456, 12.0, "film"),
    ("DSC-RX100M3", 13.2, 5472, 3648, 8.8, "film plane"),
    ("Canon PowerShot SX50 HS", 6.17, 4000, 3000, 4.3, "plane"),
    ("DSC-HX20V", 6.17, 4896, 3672, 4.45, "film"),
]
"""Model, width of the sensor in mm, pixels, focal length in mm, and the tags that it writes."""
PHONES = [
    ("iPhone 6", 4.80, 3264, 2448, 4.15, "film"),
    ("Pixel 3", 5.69, 4032, 3024, 4.44, "film"),
]
"""Their sensors are in no database."""
ALL = [pytest.param(camera, id=camera[0].strip()) for camera in CAMERAS + PHONES]


def tags_of(camera):
    model, width_mm, width, height, focal_mm, notes = camera
    tags = {
        Base.Model: model, Base.FocalLength: focal_mm,
        Base.ExifImageWidth: width, Base.ExifImageHeight: height,
    }  # fmt: skip
    if "film" in notes:
        diagonal_mm = width_mm * math.hypot(1.0, height / width)
        tags[Base.FocalLengthIn35mmFilm] = round(focal_mm * math.hypot(36.0, 24.0) / diagonal_mm)
    if "plane" in notes:
        tags |= {Base.FocalPlaneXResolution: 25.4 * width / width_mm}
    return tags


def fov_of(camera, share=1.0):
    """Return the field of view of a share of the camera's width."""
    return 2.0 * math.degrees(math.atan(share * camera[1] / 2.0 / camera[4]))


def resized(tags, width, height):
    return tags | {Base.ExifImageWidth: width, Base.ExifImageHeight: height}


@pytest.mark.parametrize("camera", ALL)
def test_originals_upright_files_and_files_of_another_size(camera):
    _, _, width, height, _, notes = camera
    tags = tags_of(camera)
    found = lens_of(tags, (width, height))
    assert found.fov_deg == pytest.approx(fov_of(camera), rel=0.06)
    is_known = camera not in PHONES
    assert (found.sd_deg is None) == is_known
    assert ("agree" in found.reason) == is_known
    size = width // 4, height // 4
    for smaller in (lens_of(tags, size), lens_of(resized(tags, *size), size)):
        assert smaller.most_deg is None
        assert smaller.fov_deg == pytest.approx(fov_of(camera), rel=0.06)
    # A focal plane that is now too small is no witness.
    reason = lens_of(resized(tags, *size), size).reason
    assert ("; EXIF's focal plane" in reason) == ("plane" in notes)
    upright_deg = fov_of(camera, height / width)
    for noted in (tags, resized(tags, height, width)):
        assert lens_of(noted, (height, width)).fov_deg == pytest.approx(upright_deg, rel=0.06)


@pytest.mark.parametrize("camera", ALL)
@pytest.mark.parametrize(("across", "down"), [(1.0, 0.7), (0.8, 0.5), (0.55, 0.7)])
@pytest.mark.parametrize("is_noted_anew", [False, True])
def test_crops_are_searched_wide(camera, across, down, is_noted_anew):
    _, _, width, height, _, _ = camera
    tags, true = tags_of(camera), fov_of(camera, across)
    size = round(0.3 * across * width), round(0.3 * down * height)
    found = lens_of(resized(tags, *size) if is_noted_anew else tags, size)
    is_screen = camera in PHONES and 1.96 < size[0] / size[1] < 2.27
    if is_noted_anew and (is_screen or abs(size[0] / size[1] - 16 / 9) < 0.03):
        # The camera itself takes this shape, of its whole width.
        assert found.fov_deg >= 0.94 * true
    else:
        assert "cropped" in found.reason
        assert true <= found.most_deg
        assert abs(true - found.fov_deg) < 2.5 * found.sd_deg

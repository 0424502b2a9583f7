"""The fields of view of real cameras' photos, original, upright, resized and cropped."""

import math

import pytest
from PIL.ExifTags import Base

from skyline.photo.lens import lens_of

pytest.importorskip("lensfunpy", reason="no database of sensors on this machine")

CAMERAS = {
    "full frame": [
        ("Canon EOS 5D", 35.8, 4368, 2912, 24.0, "plane"),
        ("Canon EOS 5D Mark II", 36.0, 5616, 3744, 35.0, "plane"),
        ("Canon EOS 5D Mark III", 36.0, 5760, 3840, 50.0, "plane"),
        ("Canon EOS 6D", 35.8, 5472, 3648, 24.0, "plane"),
        ("Canon EOS 5D Mark IV", 36.0, 6720, 4480, 70.0, "plane"),
        ("NIKON D700", 36.0, 4256, 2832, 24.0, "film"),
        ("NIKON D750", 35.9, 6016, 4016, 28.0, "film"),
        ("NIKON D850", 35.9, 8256, 5504, 50.0, "film"),
        ("ILCE-7M2", 35.8, 6000, 4000, 31.0, "film plane"),
        ("ILCE-7RM3", 35.9, 7952, 5304, 55.0, "film plane"),
        ("PENTAX K-1", 35.9, 7360, 4912, 28.0, "film"),
        ("NIKON D610", 35.9, 6016, 4016, 35.0, "film"),
    ],
    "APS-C": [
        ("NIKON D200", 23.6, 3872, 2592, 24.0, "film"),
        ("NIKON D90", 23.6, 4288, 2848, 18.0, "film"),
        ("NIKON D7000", 23.6, 4928, 3264, 35.0, "film"),
        ("Canon EOS 20D", 22.5, 3504, 2336, 17.0, "plane"),
        ("Canon EOS 40D", 22.2, 3888, 2592, 18.0, "plane"),
        ("Canon EOS 450D", 22.2, 4272, 2848, 55.0, "plane"),
        ("Canon EOS 7D", 22.3, 5184, 3456, 15.0, "plane"),
        ("Canon EOS 70D", 22.5, 5472, 3648, 24.0, "plane"),
        ("ILCE-6000", 23.5, 6000, 4000, 16.0, "film plane"),
        ("NEX-6", 23.5, 4912, 3264, 20.0, "film"),
        ("X-T3", 23.5, 6240, 4160, 23.0, "film plane"),
        ("PENTAX K-5", 23.7, 4928, 3264, 21.0, "film"),
    ],
    "Micro Four Thirds": [
        ("E-M5            ", 17.3, 4608, 3456, 12.0, "film"),
        ("E-M10           ", 17.3, 4608, 3456, 14.0, "film"),
        ("E-M1MarkII      ", 17.4, 5184, 3888, 25.0, "film"),
        ("E-PL5           ", 17.3, 4608, 3456, 14.0, "film"),
        ("E-P3            ", 17.3, 4032, 3024, 17.0, "film"),
        ("E-510           ", 17.3, 3648, 2736, 14.0, "film"),
        ("DMC-G3", 17.3, 4592, 3448, 14.0, "film"),
        ("DMC-GF1", 17.3, 4000, 3000, 20.0, "film"),
        ("DMC-GX7", 17.3, 4592, 3448, 20.0, "film"),
        ("DMC-GM1", 17.3, 4592, 3448, 12.0, "film"),
    ],
    "1 inch": [
        ("DSC-RX100", 13.2, 5472, 3648, 10.4, "film"),
        ("DSC-RX100M3", 13.2, 5472, 3648, 8.8, "film plane"),
        ("DSC-RX100M4", 13.2, 5472, 3648, 25.7, "film"),
        ("DSC-RX10", 13.2, 5472, 3648, 8.8, "film"),
        ("DMC-FZ1000", 13.2, 5472, 3648, 9.12, "film"),
        ("DMC-TZ100", 13.2, 5472, 3648, 9.1, "film"),
        ("Canon PowerShot G7 X", 13.2, 5472, 3648, 8.8, "plane"),
        ("Canon PowerShot G9 X", 13.2, 5472, 3648, 10.2, "plane"),
        ("NIKON 1 J5", 13.2, 5568, 3712, 10.0, "film"),
        ("NIKON 1 V1", 13.2, 3872, 2592, 10.0, "film"),
    ],
    "compact": [
        ("Canon PowerShot SX50 HS", 6.17, 4000, 3000, 4.3, "plane"),
        ("Canon PowerShot SX220 HS", 6.17, 4000, 3000, 5.0, "plane"),
        ("Canon PowerShot SX240 HS", 6.17, 4000, 3000, 4.5, "plane"),
        ("Canon PowerShot SX260 HS", 6.17, 4000, 3000, 9.0, "plane"),
        ("DMC-TZ60", 6.17, 4896, 3672, 4.3, "film"),
        ("DMC-FZ200", 6.17, 4000, 3000, 4.5, "film"),
        ("DMC-TZ61", 6.17, 4896, 3672, 4.3, "film"),
        ("DSC-HX20V", 6.17, 4896, 3672, 4.45, "film"),
        ("COOLPIX P330", 7.44, 4000, 3000, 5.1, "film"),
        ("Canon PowerShot S95", 7.44, 3648, 2736, 6.0, "plane"),
    ],
    "phone": [
        ("iPhone 6", 4.80, 3264, 2448, 4.15, "film"),
        ("iPhone 11", 5.66, 4032, 3024, 4.25, "film"),
        ("iPhone 15 Pro", 9.76, 4032, 3024, 6.765, "film"),
        ("SM-G973U", 5.72, 4032, 3024, 4.3, "film"),
        ("SM-G950F", 5.60, 4032, 3024, 4.25, "film"),
        ("Pixel 3", 5.69, 4032, 3024, 4.44, "film"),
        ("Pixel 6", 9.82, 4080, 3072, 6.81, "film"),
        ("VOG-L29", 7.15, 3648, 2736, 5.58, "film"),
        ("Nexus 5X", 6.25, 4032, 3024, 4.67, "film"),
        ("Mi 9 Lite", 6.4, 4000, 3000, 4.74, "film"),
    ],
}
"""Model, width of the sensor in mm, pixels, focal length in mm, and the tags that it writes."""
ALL = [pytest.param(camera, id=camera[0].strip()) for one in CAMERAS.values() for camera in one]


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
def test_originals_and_files_of_another_size(camera):
    _, _, width, height, _, notes = camera
    tags = tags_of(camera)
    found = lens_of(tags, (width, height))
    assert found.fov_deg == pytest.approx(fov_of(camera), rel=0.06)
    is_known = camera not in CAMERAS["phone"]
    assert (found.sd_deg is None) == is_known
    assert ("agree" in found.reason) == is_known
    size = width // 4, height // 4
    for smaller in (lens_of(tags, size), lens_of(resized(tags, *size), size)):
        assert smaller.most_deg is None
        assert smaller.fov_deg == pytest.approx(fov_of(camera), rel=0.06)
    # A focal plane that is now too small is no witness.
    reason = lens_of(resized(tags, *size), size).reason
    assert ("; EXIF's focal plane" in reason) == ("plane" in notes)


@pytest.mark.parametrize("camera", ALL)
def test_upright_files(camera):
    _, _, width, height, _, _ = camera
    tags, upright = tags_of(camera), fov_of(camera, height / width)
    for noted in (tags, resized(tags, height, width)):
        assert lens_of(noted, (height, width)).fov_deg == pytest.approx(upright, rel=0.06)


@pytest.mark.parametrize("camera", ALL)
@pytest.mark.parametrize(("across", "down"), [(1.0, 0.7), (0.8, 0.5), (0.55, 0.7)])
@pytest.mark.parametrize("is_noted_anew", [False, True])
def test_crops_are_searched_wide(camera, across, down, is_noted_anew):
    _, _, width, height, _, _ = camera
    tags, true = tags_of(camera), fov_of(camera, across)
    size = round(0.3 * across * width), round(0.3 * down * height)
    found = lens_of(resized(tags, *size) if is_noted_anew else tags, size)
    is_screen = camera in CAMERAS["phone"] and 1.96 < size[0] / size[1] < 2.27
    if is_noted_anew and (is_screen or abs(size[0] / size[1] - 16 / 9) < 0.03):
        # The camera itself takes this shape, of its whole width.
        assert found.fov_deg >= 0.94 * true
    else:
        assert "cropped" in found.reason
        assert true <= found.most_deg
        assert abs(true - found.fov_deg) < 2.5 * found.sd_deg

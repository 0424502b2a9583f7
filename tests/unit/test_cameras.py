"""The fields of view of real cameras' photos, original, upright, resized and cropped."""

import math

import numpy as np
import pytest
from PIL.ExifTags import Base

from skyline.match.rays import Rays
from skyline.photo.noted_focal_length import NOMINAL_SD
from skyline.photo.noted_fov import lens_of

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
    assert (found.fov_sd_deg is None) == is_known
    assert ("agree" in found.reason) == is_known
    size = width // 4, height // 4
    for smaller in (lens_of(tags, size), lens_of(resized(tags, *size), size)):
        assert smaller.most_fov_deg is None
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
        assert true <= found.most_fov_deg
        assert abs(true - found.fov_deg) < 2.5 * found.fov_sd_deg


ZOOMED = [
    # Hugin's bug 2064625: the equivalent has the zoom in it.
    ("iPhone SE (3rd generation)", (4032, 3024), 3.99, 55, 1.951, None, 34.9),
    # A Galaxy's second camera, twice as long as the first, which it notes as a zoom. The sensor is
    # of 4:3, and the equivalent of its diagonal.
    ("SM-G973U", (4032, 2268), 6.0, 52, 2, None, 36.8),
    # The same bug: "For images from other phones this line was needed."
    ("SM-A202F", (4128, 3096), 3.6, 27, 2, None, 35.5),
    # photo.stackexchange.com/questions/117162: the 35 mm equivalent is not noted.
    ("F3115", (4096, 2304), 3.5, 25, 1.4, None, 56.8),
    # Focus-Points' issue 253: neither focal length has the digital teleconverter of 2 in it.
    ("E-M5", (4608, 3456), 40.0, 80, 2, None, 12.3),
    # A PowerShot's focal plane is the sensor's: 4000 pixels on 6.17 mm.
    ("Canon PowerShot SX50 HS", (4000, 3000), 4.3, None, 2, 25.4 * 4000 / 6.17, 39.5),
    # A zoom that is counted in the equivalent, and noted besides.
    ("DSC-HX20V", (4896, 3672), 4.45, 50, 2, None, 38.2),
]
"""Model, pixels, focal length and equivalent in mm, digital zoom, pixels per inch of the focal
plane, and the true field of view."""
CROP_MODES = [
    # Focus-Points' issue 252: DX mode, 23.5 mm of 36 mm, is in the equivalent.
    ("NIKON D850", (5408, 3600), 35.0, 52, 1, None, 37.1),
    ("NIKON Z 6", (3984, 2656), 50.0, 75, 1, None, 26.5),
    # Canon notes no equivalent: 3408 pixels on 22.4 mm, and the same in centimetres.
    ("Canon EOS R6", (3408, 2272), 35.0, None, 1, 3871.5, 35.4),
    ("Canon EOS R5", (5088, 3392), 24.0, None, 1, 25.4 * 5088 / 22.4, 50.0),
    # Sony's APS-C mode on full frame: equivalent and focal plane, 3936 pixels on 23.5 mm.
    ("ILCE-7M2", (3936, 2624), 31.0, 46, 1, 25.4 * 3936 / 23.5, 41.5),
    # A cropped equivalent of 35 mm from a lens of 18.3 mm, whose whole sensor sees 28 mm.
    ("GR III", (4800, 3200), 18.3, 35, 1, None, 54.4),
]


def notes_of(camera):
    model, (width, height), focal_mm, equivalent_mm, zoom, per_inch, _ = camera
    noted = {
        Base.Model: model, Base.FocalLength: focal_mm, Base.DigitalZoomRatio: zoom,
        Base.FocalLengthIn35mmFilm: equivalent_mm, Base.FocalPlaneXResolution: per_inch,
        Base.ExifImageWidth: width, Base.ExifImageHeight: height,
    }  # fmt: skip
    return {tag: value for tag, value in noted.items() if value is not None}


@pytest.mark.parametrize("camera", ZOOMED + CROP_MODES, ids=lambda camera: camera[0])
@pytest.mark.parametrize("is_upright", [False, True])
def test_zoomed_and_cropped_frames_are_within_what_is_searched(camera, is_upright):
    size, true_deg = camera[1], camera[-1]
    if is_upright:
        half = math.tan(math.radians(true_deg) / 2.0) * size[1] / size[0]
        true_deg, size = 2.0 * math.degrees(math.atan(half)), size[::-1]
    found = lens_of(notes_of(camera), size)
    sd_deg = 0.025 * found.fov_deg if found.fov_sd_deg is None else found.fov_sd_deg
    assert abs(true_deg - found.fov_deg) <= 1.5 * sd_deg
    rays = Rays(u=np.zeros(1), v=np.zeros(1), weight=np.ones(1), fov_deg=found.fov_deg)
    low_deg, high_deg = rays.about(sd_deg, found.most_fov_deg or math.inf).fov_bounds_deg
    assert low_deg < true_deg < high_deg


@pytest.mark.parametrize(
    ("size", "frame_deg", "sensor_deg"),
    [
        # 26 mm compare 43.27 mm with the diagonal of the photo, or of a sensor of 4:3 that is as
        # wide as a photo of 16:9, and as high as a square.
        ((4032, 2268), 71.9, 67.3),
        ((2268, 4032), 44.4, 41.1),
        ((3024, 3024), 60.9, 53.1),
    ],
)
def test_an_equivalent_is_of_the_diagonal_of_the_photo_or_of_the_sensor(
    size, frame_deg, sensor_deg
):
    tags = {
        Base.FocalLengthIn35mmFilm: 26, Base.ExifImageWidth: size[0], Base.ExifImageHeight: size[1],
    }  # fmt: skip
    found = lens_of(tags, size)
    assert f"{frame_deg} or {sensor_deg} degrees" in found.reason
    for possible_deg in (frame_deg, sensor_deg):
        assert abs(possible_deg - found.fov_deg) <= 1.1 * found.fov_sd_deg


def test_the_focal_length_on_a_sensor_says_whose_diagonal_an_equivalent_compares():
    # 10.4 mm on a sensor 13.2 mm wide, whose columns a photo of 16:9 has all: 64.8 degrees.
    tags = {
        Base.Model: "DSC-RX100", Base.FocalLength: 10.4, Base.FocalLengthIn35mmFilm: 28,
        Base.ExifImageWidth: 5472, Base.ExifImageHeight: 3080,
    }  # fmt: skip
    found = lens_of(tags, (5472, 3080))
    assert found.fov_deg == pytest.approx(64.8, rel=0.01)
    assert found.fov_sd_deg is None


@pytest.mark.parametrize("model", ["E-M5", "Canon PowerShot SX50 HS", "ILCE-7M2", "DSC-HX20V"])
def test_two_sources_that_agree_say_how_a_zoom_is_counted(model):
    camera = next(one for one in ZOOMED + CROP_MODES if one[0] == model)
    found = lens_of(notes_of(camera), camera[1])
    assert found.fov_deg == pytest.approx(camera[-1], rel=0.03)
    assert found.fov_sd_deg is None


@pytest.mark.parametrize(
    ("focal_mm", "equivalent_mm", "zoom", "true_deg"),
    [
        # 24 mm with a zoom of 4 in them would be a lens of 6 mm, 149 degrees: it is not.
        (5.6, 24, 4, 20.4),
        # 260 mm without the zoom of 10 would need a sensor of 1.1 mm: it is in them.
        (6.7, 260, 10, 7.6),
    ],
)
def test_only_a_possible_lens_counts(focal_mm, equivalent_mm, zoom, true_deg):
    tags = {
        Base.FocalLength: focal_mm, Base.FocalLengthIn35mmFilm: equivalent_mm,
        Base.DigitalZoomRatio: zoom,
    }  # fmt: skip
    found = lens_of(tags, (4000, 3000))
    assert found.fov_deg == pytest.approx(true_deg, rel=0.01)
    sd = math.hypot(NOMINAL_SD, 1.0 / math.sqrt(12.0) / equivalent_mm)
    assert found.fov_sd_deg == pytest.approx(
        sd * math.degrees(math.sin(math.radians(true_deg))), rel=0.01
    )
    assert found.most_fov_deg is None


def test_a_line_says_both_readings_of_a_zoom():
    tags = {Base.FocalLengthIn35mmFilm: 29, Base.DigitalZoomRatio: 2}
    found = lens_of(tags, (3000, 2000))
    # 36 mm over 29 mm, and over 58 mm.
    assert "with or without the digital zoom of 2" in found.reason
    assert found.reason.endswith("63.7 or 34.5 degrees")
    assert abs(63.7 - found.fov_deg) < 1.2 * found.fov_sd_deg
    assert abs(34.5 - found.fov_deg) < found.fov_sd_deg
    for none in (0, 1, 65535):
        alone = lens_of(tags | {Base.DigitalZoomRatio: none}, (3000, 2000))
        assert alone.fov_deg == pytest.approx(63.7, abs=0.1)


def test_a_program_that_shrinks_a_photo_makes_no_crop_mode():
    """It notes the new size, and its own time, but keeps the resolution of the focal plane."""
    tags = {
        Base.Model: "Canon EOS R6", Base.FocalLength: 35.0,
        Base.ExifImageWidth: 3408, Base.ExifImageHeight: 2272,
        Base.FocalPlaneXResolution: 25.4 * 5472 / 36.0,  # 22.4 mm for 3408 pixels
        Base.DateTimeOriginal: "2024:05:01 10:00:00", Base.DateTime: "2024:06:02 12:00:00",
    }  # fmt: skip
    found = lens_of(tags, (3408, 2272))
    assert found.fov_deg == pytest.approx(54.4, abs=0.1)
    assert "and that sensor is not" in found.reason
    same = lens_of(tags | {Base.DateTime: "2024:05:01 10:00:02"}, (3408, 2272))
    assert same.fov_deg == pytest.approx(35.5, abs=0.1)


@pytest.mark.parametrize(
    ("tags", "size", "share"),
    [
        ({}, (4000, 3000), 0.05),
        ({}, (1600, 1200), 0.2),
        ({Base.ExifImageWidth: 1600, Base.ExifImageHeight: 1200}, (1600, 1200), 0.2),
        ({Base.Software: "Adobe Photoshop 21.0 (Windows)"}, (4000, 3000), 0.3),
        ({Base.Software: "17.5.1"}, (4000, 3000), 0.05),
        # A focal length on the sensor of this camera agrees.
        ({Base.Model: "DSC-HX20V", Base.FocalLength: 4.45}, (4000, 3000), 0.0125),
        # The shape says that it was cropped, which the deviation covers.
        ({}, (1600, 900), 0.0),
    ],
)
def test_a_crop_is_as_likely_as_the_file_says(tags, size, share):
    noted = {Base.FocalLengthIn35mmFilm: 25}
    noted |= {Base.ExifImageWidth: 4000, Base.ExifImageHeight: 3000}
    assert lens_of(noted | tags, size).crop_share == pytest.approx(share)

"""The field of view that EXIF notes, and how sure it is."""

import numpy as np
import pytest
from PIL.ExifTags import Base
from PIL.TiffImagePlugin import IFDRational

from skyline.camera.projection import Projection
from skyline.match.rays import Rays
from skyline.photo.noted_fov import camera_of, lens_of
from skyline.photo.noted_panorama import GPANO, panorama_of_xmp, swept_lens_of
from skyline.photo.skyline import Lens
from skyline.photo.xmp import Xmp

SIZE = {Base.ExifImageWidth: 4000, Base.ExifImageHeight: 3000}
PLANE = SIZE | {Base.FocalLength: IFDRational(127, 10), Base.FocalPlaneResolutionUnit: 2}
PLANE[Base.FocalPlaneXResolution] = IFDRational(4000, 1)
"""4000 pixels at 4000 an inch: a sensor an inch wide; at 25.4 / 2 mm it sees 90 degrees."""
FILM = 12.7 * np.hypot(36.0, 24.0) / np.hypot(25.4, 19.05)
"""The 35 mm equivalent of the same."""


def fov_of(half_width, focal):
    return 2.0 * np.degrees(np.arctan(half_width / focal))


@pytest.mark.parametrize("size", [(4000, 3000), (1000, 750), (2048, 1536)])
def test_the_focal_plane_of_a_whole_frame_however_resized(size):
    assert lens_of(PLANE, size).fov_deg == pytest.approx(90.0, abs=1e-9)
    assert lens_of(PLANE, size[::-1]).fov_deg == pytest.approx(fov_of(0.375, 0.5))
    per_cm = {Base.FocalPlaneXResolution: IFDRational(4_000_000, 2540)}
    centimetres = PLANE | per_cm | {Base.FocalPlaneResolutionUnit: 3}
    assert lens_of(centimetres, size).fov_deg == pytest.approx(90.0, abs=1e-3)


def test_a_panorama_of_a_phone_is_as_wide_as_its_height_says():
    tags = {Base.CustomRendered: 6, Base.FocalLengthIn35mmFilm: 28}
    found = swept_lens_of(tags, (8000, 2500))
    # Of the camera's height, which sees 36 mm of film, 2500 pixels are between 70 and 100 %.
    for kept in (0.7, 0.97):
        true_deg = np.degrees(8000 / (28 / 36 * 2500 / kept))
        assert found.fov_deg == pytest.approx(true_deg, abs=2.0 * found.fov_sd_deg)
    assert found.most_fov_deg == 360.0
    assert "panorama" in found.reason
    assert swept_lens_of(tags, (30_000, 2500)).fov_deg == 360.0
    assert swept_lens_of({Base.CustomRendered: 6}, (8000, 2500)).fov_deg is None
    assert swept_lens_of(tags, (2500, 3300)).fov_deg is not None
    upwards = swept_lens_of(tags, (2500, 8000))
    assert (upwards.fov_deg, "up or down" in upwards.reason) == (None, True)
    assert swept_lens_of(tags | {Base.CustomRendered: 0}, (8000, 2500)) is None


@pytest.mark.parametrize(
    ("size", "photo", "widened"),
    [
        ((4000, 3400), (4000, 3000), 1.0),  # a caption below it
        ((4000, 4000), (4000, 3000), 1.0),  # in a square
        ((4400, 3300), (4000, 3000), 1.1),  # an even border
        ((3000, 4450), (3000, 4000), 1.0),  # upright, with a caption: 3:2 by its file
        ((4000, 3000), (4000, 2800), 1.0),  # a dark strip of a whole frame
    ],
)
@pytest.mark.parametrize("is_noted_anew", [True, False])
def test_a_border_leaves_a_photo_its_field_of_view(size, photo, widened, is_noted_anew):
    """28 mm on a frame of 4:3 see 63.4 degrees, and 49.7 upright."""
    width, height = size if is_noted_anew else (4000, 3000)
    tags = {Base.FocalLengthIn35mmFilm: 28}
    tags |= {Base.ExifImageWidth: width, Base.ExifImageHeight: height}
    _, lens = camera_of(tags, Xmp(), size, photo)
    half = np.tan(np.radians(63.44 if size[0] > 3000 else 49.7) / 2.0)
    assert lens.fov_deg == pytest.approx(fov_of(widened * half, 1.0), abs=0.05)
    assert lens.fov_sd_deg < 2.0
    assert lens.most_fov_deg is None


@pytest.mark.parametrize("name", ["AF Fisheye-Nikkor 16mm f/2.8D", "SAMYANG 8mm Fish-Eye"])
def test_a_lens_named_a_fisheye_is_no_perspective_one(name):
    tags = {Base.FocalLengthIn35mmFilm: 16, Base.LensModel: name}
    projection, lens = camera_of(tags, Xmp(), (4000, 3000))
    assert (projection, lens.fov_deg) == (Projection.FISHEYE, None)
    assert camera_of(tags | {Base.LensModel: "16-35mm"}, Xmp(), (4000, 3000))[1].fov_deg is not None


@pytest.mark.parametrize(("applied", "share"), [("True", 0.75), ("False", 1.0)])
def test_a_crop_that_lightroom_notes_leaves_half_to_all_of_the_frame(applied, share):
    """28 mm on a frame of 4:3 see 63.4 degrees."""
    space = "http://ns.adobe.com/camera-raw-settings/1.0"
    xmp = Xmp({(space, "HasCrop"): "True", (space, "AlreadyApplied"): applied})
    tags = {Base.FocalLengthIn35mmFilm: 28}
    _, lens = camera_of(tags, xmp, (4000, 3000))
    assert lens.fov_deg == pytest.approx(share * 63.44, abs=0.01)
    assert ("was cropped from 63.4 degrees" in lens.reason) == (share < 1.0)


def test_sources_that_contradict_one_another_widen_what_is_possible():
    found = lens_of(PLANE | {Base.FocalLengthIn35mmFilm: 1.5 * FILM}, (4000, 3000))
    narrow = fov_of(0.5, 0.75)
    assert narrow < found.fov_deg < 90.0
    # Each of the two is about a deviation off.
    assert found.fov_sd_deg == pytest.approx((90.0 - narrow) / 2.0, rel=0.05)
    assert "contradict" in found.reason


def test_a_crop_that_was_resized_bounds_the_field_of_view():
    found = lens_of(PLANE, (1600, 800))
    # The focal plane alone is a hint, so a focal length 1.5 times as short is possible.
    assert found.most_fov_deg == pytest.approx(1.05 * fov_of(1.5, 1.0))
    assert found.fov_deg + 2.0 * found.fov_sd_deg > 90.0 > found.fov_deg
    agreed = lens_of(PLANE | {Base.FocalLengthIn35mmFilm: FILM}, (1600, 800))
    assert agreed.most_fov_deg == pytest.approx(1.05 * 90.0)
    assert agreed.fov_sd_deg < found.fov_sd_deg
    assert "cropped from 90.0 degrees" in found.reason


@pytest.mark.parametrize(
    ("tags", "size"),
    [
        ({}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: "wide"}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: IFDRational(0, 0)}, (4000, 3000)),
        # a swept panorama
        ({Base.FocalLengthIn35mmFilm: 26}, (12000, 3000)),
        (PLANE | {Base.FocalPlaneResolutionUnit: 9}, (4000, 3000)),
    ],
)
def test_nothing_is_known_where_exif_does_not_say(tags, size):
    found = lens_of(tags, size)
    assert found == Lens(reason=found.reason)


def gpano(**noted):
    return Xmp({(GPANO, name): str(value) for name, value in noted.items()})


# A panorama of 120 degrees.
WHOLE = {
    "ProjectionType": "Cylindrical", "CroppedAreaImageWidthPixels": 9600,
    "CroppedAreaImageHeightPixels": 2400, "FullPanoWidthPixels": 28800,
    "PoseHeadingDegrees": 200.0,
}  # fmt: skip


# As it was, resized, and cropped to all rows or to all columns.
@pytest.mark.parametrize(
    ("size", "fov_deg"),
    [((9600, 2400), 120.0), ((961, 240), 120.0), ((3200, 2400), 40.0), ((9600, 1000), 120.0)],
)
def test_a_panorama_resized_or_cropped_has_the_field_of_view_that_is_left(size, fov_deg):
    projection, lens = panorama_of_xmp(gpano(**WHOLE), size)
    assert projection is Projection.CYLINDRICAL
    assert (lens.fov_deg, lens.fov_sd_deg, lens.most_fov_deg) == (
        pytest.approx(fov_deg),
        None,
        None,
    )


# Cropped to a third and shrunk by two, which could be all columns of a strip as well; and enlarged.
@pytest.mark.parametrize(
    ("size", "least_deg", "most_deg"),
    [((1600, 1200), 20.0, 40.0), ((4000, 800), 50.0, 120.0), ((12_000, 9000), 20.0, 40.0)],
)
def test_a_panorama_that_was_cropped_bounds_the_field_of_view(size, least_deg, most_deg):
    _, lens = panorama_of_xmp(gpano(**WHOLE), size)
    rays = Rays(
        u=np.zeros(1),
        v=np.zeros(1),
        weight=np.ones(1),
        fov_deg=lens.fov_deg,
        projection=Projection.CYLINDRICAL,
    )
    low, high = rays.about(lens.fov_sd_deg, lens.most_fov_deg).fov_bounds_deg
    assert low <= least_deg < lens.fov_deg < most_deg < high <= 360.0
    assert f"a panorama of {most_deg:.1f} degrees, but the photo was cropped" in lens.reason


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"FullPanoWidthPixels": "many"}, "not how wide"),
        ({"FullPanoWidthPixels": "9e99", "CroppedAreaImageWidthPixels": "9e99"}, "not how wide"),
        ({"FullPanoWidthPixels": 28_800_000}, "0.12 degrees fit no photo"),
        ({"ProjectionType": "cubemap"}, "projection is cubemap, which is not known"),
        ({"ProjectionType": "fisheye"}, "a fisheye, but not how wide"),
    ],
)
def test_a_panorama_that_makes_no_sense_is_not_taken_for_a_lens(wrong, said):
    _, lens = panorama_of_xmp(gpano(**WHOLE | wrong), (9600, 2400))
    assert lens == Lens(reason=lens.reason)
    assert said in lens.reason

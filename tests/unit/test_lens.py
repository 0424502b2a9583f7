"""The field of view that EXIF notes: what is believed, and what is not."""

import numpy as np
import pytest
from PIL.ExifTags import Base
from PIL.TiffImagePlugin import IFDRational

from skyline.photo.exif import Lens, lens_of, swept_lens_of

SIZE = {Base.ExifImageWidth: 4000, Base.ExifImageHeight: 3000}
PLANE = {
    Base.FocalLength: IFDRational(127, 10),
    Base.FocalPlaneXResolution: IFDRational(4000, 1),
    Base.FocalPlaneResolutionUnit: 2,
} | SIZE
"""4000 pixels at 4000 an inch: a sensor an inch wide; at 25.4 / 2 mm it sees 90 degrees."""
FILM = 12.7 * np.hypot(36.0, 24.0) / np.hypot(25.4, 19.05)
"""The 35 mm equivalent of the same."""


def fov_of(half_width, focal):
    return 2.0 * np.degrees(np.arctan(half_width / focal))


def test_35_mm_equivalents():
    # 3:2 has the film's own shape, so its width is 36 mm.
    tags = {Base.FocalLengthIn35mmFilm: 18}
    assert lens_of(tags, (6000, 4000), False).fov_deg == pytest.approx(90.0)
    assert lens_of(tags, (600, 400), False).fov_deg == pytest.approx(90.0)
    assert lens_of(tags, (6000, 4000), True).fov_deg == pytest.approx(fov_of(12.0, 18.0))
    assert lens_of(tags, (600, 400), False).sd_deg is None


@pytest.mark.parametrize("size", [(4000, 3000), (1000, 750), (2048, 1536)])
def test_the_focal_plane_of_a_whole_frame_however_resized(size):
    assert lens_of(PLANE, size, False).fov_deg == pytest.approx(90.0, abs=1e-9)
    assert lens_of(PLANE, size[::-1], False).fov_deg == pytest.approx(fov_of(0.375, 0.5))
    centimetres = {
        Base.FocalPlaneResolutionUnit: 3,
        Base.FocalPlaneXResolution: IFDRational(4_000_000, 2540),
    }
    assert lens_of(PLANE | centimetres, size, False).fov_deg == pytest.approx(90.0, abs=1e-3)


def test_a_panorama_of_a_phone_is_as_wide_as_its_height_says():
    tags = {Base.CustomRendered: 6, Base.FocalLengthIn35mmFilm: 28}
    told = swept_lens_of(tags, (8000, 2500))
    # Of the camera's height, which sees 36 mm of film, 2500 pixels are between 70 and 100 %.
    for kept in (0.7, 0.97):
        assert told.fov_deg == pytest.approx(
            np.degrees(8000 / (28 / 36 * 2500 / kept)), abs=2.0 * told.sd_deg
        )
    assert told.most_deg == 360.0
    assert "panorama" in told.said
    assert swept_lens_of(tags, (30_000, 2500)).fov_deg == 360.0
    assert swept_lens_of({Base.CustomRendered: 6}, (8000, 2500)).fov_deg is None
    assert swept_lens_of(tags | {Base.CustomRendered: 0}, (8000, 2500)) is None


def test_sources_that_agree_are_one():
    told = lens_of(PLANE | {Base.FocalLengthIn35mmFilm: round(FILM)}, (4000, 3000), False)
    assert told.fov_deg == pytest.approx(90.0, abs=1.5)
    assert told.sd_deg is None
    assert "agrees" in told.said


def test_sources_that_contradict_one_another_widen_what_is_possible():
    told = lens_of(PLANE | {Base.FocalLengthIn35mmFilm: 1.5 * FILM}, (4000, 3000), False)
    narrow = fov_of(0.5, 0.75)
    assert narrow < told.fov_deg < 90.0
    # Each of the two is about a deviation off.
    assert told.sd_deg == pytest.approx((90.0 - narrow) / 2.0, rel=0.05)
    assert "contradict" in told.said


@pytest.mark.parametrize(
    ("lie", "said"),
    [
        # A scanner's resolution: a sensor of a metre.
        ({Base.FocalPlaneXResolution: 100.0}, "focal plane is no camera's"),
        ({Base.FocalLengthIn35mmFilm: 5000}, "35 mm equivalent of 5000 mm is no lens's"),
        ({Base.FocalLengthIn35mmFilm: 2}, "35 mm equivalent of 2 mm is no lens's"),
    ],
)
def test_the_less_credible_source_is_dropped(lie, said):
    told = lens_of(PLANE | {Base.FocalLengthIn35mmFilm: FILM} | lie, (4000, 3000), False)
    assert told.fov_deg == pytest.approx(90.0)
    assert told.sd_deg is None
    assert said in told.said


def test_a_crop_that_kept_all_columns_was_not_resized():
    told = lens_of(PLANE, (4000, 2000), False)
    assert told.fov_deg == pytest.approx(90.0)
    assert lens_of(PLANE, (2000, 3000), False).fov_deg == pytest.approx(fov_of(0.25, 0.5))


def test_a_crop_that_was_resized_bounds_the_field_of_view():
    told = lens_of(PLANE, (1600, 800), False)
    assert told.most_deg == pytest.approx(1.05 * 90.0)
    assert told.fov_deg + 2.0 * told.sd_deg > 90.0 > told.fov_deg
    assert "cropped: at most 90.0 degrees" in told.said
    # Taken on end, as far as anybody knows: half of the 3000 columns, or more of them.
    high = lens_of(PLANE, (750, 1500), False)
    assert high.most_deg == pytest.approx(1.05 * fov_of(0.25, 0.5))


@pytest.mark.parametrize(
    ("tags", "size"),
    [
        ({}, (4000, 3000)),
        ({Base.FocalLength: 4.2}, (4000, 3000)),
        ({Base.FocalLength: 0.0, Base.FocalPlaneXResolution: 4000.0}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: 0}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: "wide"}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: IFDRational(0, 0)}, (4000, 3000)),
        ({Base.FocalLengthIn35mmFilm: 5000}, (4000, 3000)),
        # a swept panorama
        ({Base.FocalLengthIn35mmFilm: 26}, (12000, 3000)),
        (PLANE | {Base.FocalPlaneResolutionUnit: 9}, (4000, 3000)),
    ],
)
def test_nothing_is_known_where_exif_does_not_say(tags, size):
    told = lens_of(tags, size, False)
    assert told == Lens(said=told.said)

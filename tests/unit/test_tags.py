"""Values of EXIF and XMP, which are written in several forms."""

from datetime import UTC, datetime

import pytest
from PIL import Image
from PIL.ExifTags import IFD, Base
from PIL.TiffImagePlugin import IFDRational

from skyline.photo.photo import read_noted_time
from skyline.photo.tags import leading_number, noted_time, number_of, positive


@pytest.mark.parametrize("half", [0.5, IFDRational(1, 2), "0.5", "1/2", "+2.5/5"])
def test_a_number_is_the_same_in_every_form(half):
    assert number_of(half) == 0.5


@pytest.mark.parametrize(
    "value", [None, "", "high", "1,5", (1, 2), "nan", IFDRational(0, 0), 10**400, "9" * 400 + "/1"]
)
def test_what_is_no_number_is_none(value):
    assert number_of(value) is None
    assert positive(value) is None


def test_a_number_may_stand_before_a_unit():
    assert leading_number("+12.50 m") == 12.5
    assert leading_number("4936/100") == 49.36
    assert leading_number("m 12") is None


def test_a_time_is_one_of_the_camera_s_clock():
    taken = {Base.DateTimeOriginal: "2026:06:21 12:30:05\0"}
    assert noted_time(taken, Base.DateTimeOriginal) == datetime(2026, 6, 21, 12, 30, 5)
    assert noted_time(taken, Base.DateTime) is None
    assert noted_time({Base.DateTime: "    :  :     :  :  "}, Base.DateTime) is None


def test_a_noted_zone_belongs_to_the_time():
    """12:30 in central Europe's summer is 10:30 UTC."""
    tags = {Base.DateTimeOriginal: "2026:06:21 12:30:05", Base.OffsetTimeOriginal: "+02:00\0"}
    both = Base.DateTimeOriginal, Base.OffsetTimeOriginal
    assert noted_time(tags, *both) == datetime(2026, 6, 21, 10, 30, 5, tzinfo=UTC)
    blank = tags | {Base.OffsetTimeOriginal: "   :  "}
    assert noted_time(blank, *both) == datetime(2026, 6, 21, 12, 30, 5)


def test_a_file_notes_when_its_photo_was_taken(tmp_path):
    image = Image.new("RGB", (60, 40))
    image.save(tmp_path / "without.jpg")
    exif = Image.Exif()
    exif.get_ifd(IFD.Exif)[Base.DateTimeOriginal] = "2026:07:14 15:04:00"
    image.save(tmp_path / "with.jpg", exif=exif)
    (tmp_path / "trace.csv").write_text("# width=60 height=40\ncolumn_px,row_px\n1,2\n")
    assert read_noted_time(tmp_path / "with.jpg") == datetime(2026, 7, 14, 15, 4)
    assert read_noted_time(tmp_path / "without.jpg") is None
    assert read_noted_time(tmp_path / "trace.csv") is None

"""Where a photo's EXIF says that it was taken, and what of it is no place."""

import pytest
from PIL.ExifTags import GPS

from skyline import NotedPlace
from skyline.photo.exif import place_from_exif

SOUTH_WEST = {
    GPS.GPSLatitude: (33.0, 30.0, 36.0),
    GPS.GPSLatitudeRef: "S",
    GPS.GPSLongitude: (70.0, 15.0, 0.0),
    GPS.GPSLongitudeRef: "W",
}


def test_a_place_is_degrees_with_their_side():
    gps = SOUTH_WEST | {GPS.GPSAltitude: 2500.5, GPS.GPSImgDirection: 360.0}
    assert place_from_exif(gps) == NotedPlace((-70.25, -33.51), 2500.5, 0.0)


def test_magnetic_north_and_the_accuracy_are_kept():
    gps = SOUTH_WEST | {
        GPS.GPSImgDirection: 112.0, GPS.GPSImgDirectionRef: "M", GPS.GPSHPositioningError: 4.7,
    }  # fmt: skip
    noted = place_from_exif(gps)
    assert (noted.heading_deg, noted.is_magnetic, noted.accuracy_m) == (112.0, True, 4.7)
    assert not place_from_exif(gps | {GPS.GPSImgDirectionRef: "T"}).is_magnetic


def test_below_the_sea_is_negative():
    for ref in (1, b"\x01"):
        gps = {GPS.GPSAltitude: 400.0, GPS.GPSAltitudeRef: ref}
        assert place_from_exif(gps) == NotedPlace(elevation_m=-400.0)


@pytest.mark.parametrize(
    "gps",
    [
        {},
        {GPS.GPSLatitude: (33.0, 30.0, 36.0)},
        SOUTH_WEST | {GPS.GPSLatitude: (133.0, 0.0, 0.0)},
        SOUTH_WEST | {GPS.GPSLatitude: (33.0, float("nan"), 0.0)},
        SOUTH_WEST | {GPS.GPSLatitude: "33"},
        SOUTH_WEST | {GPS.GPSStatus: "V", GPS.GPSAltitude: 10.0},
        {GPS.GPSImgDirection: 655.0, GPS.GPSAltitude: 99_999.0},
        {GPS.GPSLatitude: (0.0, 0.0, 0.0), GPS.GPSLongitude: (0.0, 0.0, 0.0)},
    ],
)
def test_what_is_no_place_is_none(gps):
    assert place_from_exif(gps) == NotedPlace()

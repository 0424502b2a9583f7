"""The place, altitude and direction in a photo's EXIF, and notes that are left aside."""

import pytest
from PIL import Image
from PIL.ExifTags import GPS, IFD
from PIL.TiffImagePlugin import IFDRational
from xmp_packets import xmp_packet

from skyline import NotedPlace
from skyline.photo.noted_place import place_from_exif
from skyline.photo.photo import read_noted_place, read_photo
from skyline.photo.xmp import Xmp

SOUTH_WEST = {
    GPS.GPSLatitude: (33.0, 30.0, 36.0),
    GPS.GPSLatitudeRef: "S",
    GPS.GPSLongitude: (70.0, 15.0, 0.0),
    GPS.GPSLongitudeRef: "W",
}


def without(*tags):
    return {tag: value for tag, value in SOUTH_WEST.items() if tag not in tags}


def test_a_place_is_degrees_with_their_side():
    gps = SOUTH_WEST | {
        GPS.GPSAltitude: 2500.5, GPS.GPSImgDirection: 360.0, GPS.GPSImgDirectionRef: "T",
    }  # fmt: skip
    assert place_from_exif(gps) == NotedPlace((-70.25, -33.51), 2500.5, 0.0)
    # However the side is written.
    for south in ("S", "s", "S\0", b"S\0", "South"):
        noted = place_from_exif(SOUTH_WEST | {GPS.GPSLatitudeRef: south})
        assert noted.lonlat_deg == (-70.25, -33.51)
    for below in (1, b"\x01", "1"):
        gps = {GPS.GPSAltitude: 400.0, GPS.GPSAltitudeRef: below}
        assert place_from_exif(gps) == NotedPlace(elevation_m=-400.0)


def test_the_north_that_a_direction_counts_from_is_kept():
    gps = SOUTH_WEST | {GPS.GPSImgDirection: 112.0, GPS.GPSHPositioningError: 4.7}
    for reference, is_magnetic in (("M", True), (b"M", True), ("T", False), ("?", None)):
        noted = place_from_exif(gps | {GPS.GPSImgDirectionRef: reference})
        assert (noted.heading_deg, noted.is_magnetic) == (112.0, is_magnetic)
        assert (noted.accuracy_m, noted.left_aside) == (4.7, "")
    assert place_from_exif(gps).is_magnetic is None
    assert place_from_exif(SOUTH_WEST).is_magnetic is False


def test_a_position_is_carried_to_wgs_84():
    for name in ("WGS-84", "WGS84", "wgs 84", "", "\0"):
        assert place_from_exif(SOUTH_WEST | {GPS.GPSMapDatum: name}).lonlat_deg == (-70.25, -33.51)
    fuji = {
        GPS.GPSLatitude: (35.0, 21.0, 0.0), GPS.GPSLatitudeRef: "N", GPS.GPSMapDatum: "TOKYO",
        GPS.GPSLongitude: (138.0, 43.0, 0.0), GPS.GPSLongitudeRef: "E",
    }  # fmt: skip
    lon, lat = place_from_exif(fuji).lonlat_deg
    # The Geospatial Information Authority of Japan: about 12 seconds north, 11 to 12 west.
    assert 3600.0 * (lat - 35.35) == pytest.approx(11.7, abs=0.5)
    assert 3600.0 * (lon - 138.0 - 43.0 / 60.0) == pytest.approx(-11.4, abs=0.5)


POSITION = "The photo's GPS position is left aside: "
NO_LATITUDE = "the latitude is not given as degrees, minutes and seconds"


@pytest.mark.parametrize(
    ("gps", "said"),
    [
        (without(GPS.GPSLongitudeRef), "the longitude does not say whether it is E or W"),
        (SOUTH_WEST | {GPS.GPSLatitudeRef: "W", GPS.GPSLongitudeRef: "S"}, "it is N or S"),
        # A sign is no reference, and with one it says the side twice.
        (SOUTH_WEST | {GPS.GPSLatitude: (-33.0, 30.0, 36.0)}, "the latitude is outside 0 to 90"),
        (without(GPS.GPSLongitude), "the longitude is not given as"),
        (SOUTH_WEST | {GPS.GPSLongitude: (180.0, 0.0, 1.0)}, "the longitude is outside 0 to 180"),
        (SOUTH_WEST | {GPS.GPSLatitude: (IFDRational(0, 0),) * 3}, NO_LATITUDE),
        (SOUTH_WEST | {GPS.GPSLatitude: "33"}, NO_LATITUDE),
        # Are these 33.51 degrees or 34.02?
        (SOUTH_WEST | {GPS.GPSLatitude: (33.51, 30.0, 36.0)}, "the latitude has decimals before"),
        (SOUTH_WEST | {GPS.GPSLatitude: (33.0, 30.6, 36.0)}, "the latitude has decimals before"),
        (SOUTH_WEST | {GPS.GPSStatus: b"V\0"}, "the receiver had no fix"),
        (SOUTH_WEST | {GPS.GPSHPositioningError: 2e4}, "it may be off by 20 km"),
        (SOUTH_WEST | {GPS.GPSMapDatum: "Atlantis 1900"}, "its datum 'ATLANTIS 1900' is not known"),
        (SOUTH_WEST | dict.fromkeys((GPS.GPSLatitude, GPS.GPSLongitude), (0.0,) * 3), "are 0, as"),
    ],
)
def test_a_position_that_is_none_is_left_aside_with_the_reason(gps, said):
    noted = place_from_exif({GPS.GPSHPositioningError: 5.0} | gps)
    assert noted == NotedPlace(left_aside=noted.left_aside)
    assert noted.left_aside.startswith(POSITION)
    assert said in noted.left_aside


@pytest.mark.parametrize(
    ("gps", "said"),
    [
        ({GPS.GPSImgDirection: 655.0}, "GPS direction is left aside: it is not within 0 to 360"),
        ({GPS.GPSAltitude: 99_999.0}, "altitude is left aside: 99999 m is outside -500 to 9000"),
        ({GPS.GPSAltitude: 10.0, GPS.GPSStatus: "V"}, "is left aside: the receiver had no fix"),
        ({GPS.GPSAltitude: 10.0, GPS.GPSAltitudeRef: b"\x02"}, "it counts from the ellipsoid"),
        ({GPS.GPSAltitude: 10.0, GPS.GPSAltitudeRef: 9}, "whether it is above or below sea level"),
    ],
)
def test_other_tags_that_cannot_be_used_are_left_aside(gps, said):
    noted = place_from_exif(gps)
    assert noted == NotedPlace(left_aside=noted.left_aside)
    assert said in noted.left_aside
    beside = place_from_exif(SOUTH_WEST | {GPS.GPSImgDirection: 655.0})
    assert beside.lonlat_deg == (-70.25, -33.51)


@pytest.mark.parametrize(
    ("namespace", "name", "value", "height_m"),
    [
        ("http://www.dji.com/drone-dji/1.0/", "RelativeAltitude", "+120.00", 120.0),
        ("http://www.dji.com/drone-dji/1.0/", "RelativeAltitude", "-7.5", -7.5),
        ("https://www.skydio.com/drone-skydio/1.0/", "RelativeAltitude", "31.25", 31.25),
        ("http://pix4d.com/camera/1.0", "AboveGroundAltitude", " 4936/100 ", 49.36),
        ("http://pix4d.com/camera/1.0", "AboveGroundAltitude", "4936/0", 4936.0),
        ("http://www.dji.com/drone-dji/1.0/", "RelativeAltitude", "high", None),
        ("http://www.dji.com/drone-dji/1.0/", "RelativeAltitude", "123456", None),
        ("http://www.dji.com/drone-dji/1.0/", "FlightYawDegree", "12", None),
    ],
)
def test_a_drone_notes_its_height_above_the_take_off(namespace, name, value, height_m):
    xmp = Xmp({(namespace.rstrip("/"), name): value.strip()})
    assert place_from_exif({}, xmp) == NotedPlace(takeoff_height_m=height_m)


def test_the_height_of_a_drone_s_photo_is_read_with_its_place(tmp_path):
    exif = Image.Exif()
    exif.get_ifd(IFD.GPSInfo).update(SOUTH_WEST | {GPS.GPSAltitude: 900.0})
    packet = xmp_packet(
        prefix="x", namespace="http://www.dji.com/drone-dji/1.0/", RelativeAltitude="+80.00"
    )
    path = tmp_path / "drone.jpg"
    Image.new("RGB", (40, 30)).save(path, exif=exif, xmp=packet.encode())
    expected = NotedPlace((-70.25, -33.51), 900.0, takeoff_height_m=80.0)
    assert read_photo(path).noted == read_noted_place(path) == expected

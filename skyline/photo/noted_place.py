"""The place and heading that a photo notes in EXIF and XMP.

Tags are read as the standard defines them (EXIF 2.32, 4.6.6, and 3.0). If the tag that gives a
number its meaning is missing, the number is left aside, with a sentence that gives the reason.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

from PIL.ExifTags import GPS
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from skyline.geodesy.earth import GROUND_M
from skyline.photo.tags import Tags, leading_number, number_of, positive, text_of
from skyline.photo.xmp import NO_XMP, Xmp

_ERROR_PER_DOP_M = 5.0
"""Error of the ranges that a receiver measures; the geometry of the satellites (DOP) multiplies
it."""
_MOST_ERROR_M = 10_000.0
"""A position with a greater error names a region: no place is searched for that far away."""
_ABOVE_TAKEOFF = ("RelativeAltitude", "AboveGroundAltitude")
"""XMP's names of the height above the take-off. DJI, Autel and Skydio write the first, each in a
namespace of its own, Parrot and senseFly the second in Pix4D's (OpenAthena and TinyEXIF read
them)."""
_MOST_TAKEOFF_M = 10_000.0
"""Greatest plausible height above the take-off: no drone flies higher."""
_DATUM_NAME = re.compile(r"[\w -]{1,30}")
"""Texts that PROJ may be asked about: names, not definitions."""

T = TypeVar("T")


@dataclass(frozen=True, slots=True, repr=False)
class NotedPlace:
    """The place and the heading that a photo notes.

    A value is None where the photo does not note it.

    Attributes
    ----------
    lonlat_deg : (float, float), optional
        Longitude and latitude, WGS 84.
    elevation_m : float, optional
        Elevation above sea level.
    heading_deg : float, optional
        Heading of the optical axis, clockwise from north, in [0, 360).
    is_magnetic : bool or None
        Whether the heading counts from magnetic north; None if the photo does not say.
    accuracy_m : float, optional
        The camera's own estimate of the error of its position.
    left_aside : str
        Sentences on unusable GPS tags and the reasons, without the position itself.
    takeoff_height_m : float, optional
        Height above the place where a drone took off, by its barometer.
    """

    lonlat_deg: tuple[float, float] | None = None
    elevation_m: float | None = None
    heading_deg: float | None = None
    is_magnetic: bool | None = False
    accuracy_m: float | None = None
    left_aside: str = ""
    takeoff_height_m: float | None = None

    def __repr__(self) -> str:
        values = ((name, getattr(self, name)) for name in self.__dataclass_fields__)
        noted = ", ".join(f"{name}={value!r}" for name, value in values if value not in (None, ""))
        return f"NotedPlace({noted})"


NOTHING_NOTED = NotedPlace()


class _AltitudeReference(IntEnum):
    """GPSAltitudeRef; EXIF 3.0 added heights above the ellipsoid."""

    ABOVE_SEA = 0
    BELOW_SEA = 1
    ABOVE_ELLIPSOID = 2
    BELOW_ELLIPSOID = 3


class _UnusableError(Exception):
    """The reason, in words, that a GPS tag cannot be used."""


def place_from_exif(gps: Tags, xmp: Xmp = NO_XMP) -> NotedPlace:
    """Return the place noted in a photo's GPS directory and XMP."""
    left_aside: list[str] = []

    def noted(name: str, read: Callable[[Tags], T | None]) -> T | None:
        try:
            return read(gps)
        except _UnusableError as why:
            left_aside.append(f"The photo's GPS {name} is left aside: {why}.")
            return None

    lonlat_deg = noted("position", _lonlat_deg)
    elevation_m = noted("altitude", _elevation_m)
    heading_deg = noted("direction", _heading_deg)
    is_magnetic = {"M": True, "T": False}.get(text_of(gps, GPS.GPSImgDirectionRef)[:1])
    return NotedPlace(
        lonlat_deg,
        elevation_m,
        heading_deg,
        False if heading_deg is None else is_magnetic,
        None if lonlat_deg is None else _accuracy_m(gps),
        " ".join(left_aside),
        _takeoff_height_m(xmp),
    )


def _takeoff_height_m(xmp: Xmp) -> float | None:
    """Return the height above the take-off in XMP.

    Returns None if XMP notes none, or an impossible one.
    """
    height_m = leading_number(xmp.first(*_ABOVE_TAKEOFF) or "")
    is_possible = height_m is not None and abs(height_m) <= _MOST_TAKEOFF_M
    return height_m if is_possible else None


def _accuracy_m(gps: Tags) -> float | None:
    noted_m = positive(gps.get(GPS.GPSHPositioningError))
    dop = positive(gps.get(GPS.GPSDOP))
    return noted_m if noted_m is not None or dop is None else _ERROR_PER_DOP_M * dop


def _lonlat_deg(gps: Tags) -> tuple[float, float] | None:
    if GPS.GPSLongitude not in gps and GPS.GPSLatitude not in gps:
        return None
    _require_fix(gps)
    accuracy_m = _accuracy_m(gps) or 0.0
    if accuracy_m > _MOST_ERROR_M:
        raise _UnusableError(f"it may be off by {accuracy_m / 1000.0:.0f} km, as the photo notes")
    lat = _angle_deg(gps, "latitude", GPS.GPSLatitude, GPS.GPSLatitudeRef, "NS", 90.0)
    lon = _angle_deg(gps, "longitude", GPS.GPSLongitude, GPS.GPSLongitudeRef, "EW", 180.0)
    if lon == lat == 0.0:
        raise _UnusableError("latitude and longitude are 0, as cameras without a fix write them")
    datum = text_of(gps, GPS.GPSMapDatum) or "WGS 84"
    try:
        crs = CRS.from_user_input(datum) if _DATUM_NAME.fullmatch(datum) else None
    except CRSError:
        crs = None
    if crs is None or not crs.is_geographic:
        raise _UnusableError(f"its datum {datum[:30]!r} is not known")
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(lon, lat)
    return lon, lat


def _angle_deg(gps: Tags, name: str, tag: int, side_tag: int, sides: str, most_deg: float) -> float:
    """Return a coordinate, read from degrees, minutes, seconds and a letter."""
    parts = gps.get(tag)
    numbers = [number_of(part) for part in parts] if isinstance(parts, tuple) else []
    known = [one for one in numbers if one is not None]
    if not len(numbers) == len(known) == 3:
        raise _UnusableError(f"the {name} is not given as degrees, minutes and seconds")
    angle_deg = known[0] + known[1] / 60.0 + known[2] / 3600.0
    if min(known) < 0.0 or max(known[1:]) > 60.0 or angle_deg > most_deg:
        raise _UnusableError(f"the {name} is outside 0 to {most_deg:g} degrees, 60', 60\"")
    if any(part % 1.0 and any(known[k + 1 :]) for k, part in enumerate(known)):
        raise _UnusableError(f"the {name} has decimals before a smaller part that is not 0")
    side = text_of(gps, side_tag)[:1]
    if side not in tuple(sides):
        raise _UnusableError(f"the {name} does not say whether it is {' or '.join(sides)}")
    # A difference, since -0.0 would be shown with its sign.
    return 0.0 - angle_deg if side == sides[1] else angle_deg


def _elevation_m(gps: Tags) -> float | None:
    if GPS.GPSAltitude not in gps:
        return None
    _require_fix(gps)
    height_m = number_of(gps[GPS.GPSAltitude])
    if height_m is None:
        raise _UnusableError("it is not a number")
    reference = gps.get(GPS.GPSAltitudeRef, _AltitudeReference.ABOVE_SEA)  # The standard's default.
    match number_of(int.from_bytes(reference) if isinstance(reference, bytes) else reference):
        case _AltitudeReference.ABOVE_SEA:
            pass
        case _AltitudeReference.BELOW_SEA:
            height_m = -height_m
        case _AltitudeReference.ABOVE_ELLIPSOID | _AltitudeReference.BELOW_ELLIPSOID:
            raise _UnusableError("it counts from the ellipsoid, not from sea level")
        case _:
            raise _UnusableError("it does not say whether it is above or below sea level")
    lowest_m, highest_m = GROUND_M
    if not lowest_m <= height_m <= highest_m:
        raise _UnusableError(f"{height_m:.0f} m is outside {lowest_m:.0f} to {highest_m:.0f} m")
    return height_m


def _heading_deg(gps: Tags) -> float | None:
    if GPS.GPSImgDirection not in gps:
        return None
    heading_deg = number_of(gps[GPS.GPSImgDirection])
    if heading_deg is None or not 0.0 <= heading_deg <= 360.0:
        raise _UnusableError("it is not within 0 to 360 degrees")
    return heading_deg % 360.0


def _require_fix(gps: Tags) -> None:
    if text_of(gps, GPS.GPSStatus)[:1] == "V":
        raise _UnusableError("the receiver had no fix (GPSStatus V)")

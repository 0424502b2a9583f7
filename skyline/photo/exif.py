"""Place and direction of a photo from what its camera noted in EXIF."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from PIL.ExifTags import GPS

_LOWEST_M, _HIGHEST_M = -500.0, 9000.0


@dataclass(frozen=True, slots=True)
class NotedPlace:
    """Where a photo says that it was taken; what is None it does not say.

    Attributes
    ----------
    lonlat_deg : (float, float), optional
        Longitude and latitude, WGS 84.
    elevation_m : float, optional
        Above sea level.
    heading_deg : float, optional
        Of the optical axis, clockwise from north, in [0, 360).
    is_magnetic : bool
        Whether that is magnetic north; else it is true north, or the camera does not say which.
    accuracy_m : float, optional
        How far off the camera took its position to be.
    """

    lonlat_deg: tuple[float, float] | None = None
    elevation_m: float | None = None
    heading_deg: float | None = None
    is_magnetic: bool = False
    accuracy_m: float | None = None


NOTHING_NOTED = NotedPlace()


def place_from_exif(gps: Mapping[int, object]) -> NotedPlace:
    """Return what a photo's GPS directory (EXIF 2.32, 4.6.6) says of where it was taken."""
    lon = _degrees(gps, GPS.GPSLongitude, GPS.GPSLongitudeRef, "W", 180.0)
    lat = _degrees(gps, GPS.GPSLatitude, GPS.GPSLatitudeRef, "S", 90.0)
    # Cameras without a fix write zeros, or say that what they write is void.
    known = str(gps.get(GPS.GPSStatus, "A")).strip("\0 ").upper() != "V"
    at_all = known and lon is not None and lat is not None and not lon == lat == 0.0
    height = number_of(gps.get(GPS.GPSAltitude))
    if height is not None and gps.get(GPS.GPSAltitudeRef) in (1, b"\x01"):
        height = -height
    if height is not None and not _LOWEST_M <= height <= _HIGHEST_M:
        height = None
    heading = number_of(gps.get(GPS.GPSImgDirection))
    if heading is not None and not 0.0 <= heading <= 360.0:
        heading = None
    accuracy = number_of(gps.get(GPS.GPSHPositioningError))
    reference = str(gps.get(GPS.GPSImgDirectionRef, "")).upper()
    return NotedPlace(
        (float(lon or 0.0), float(lat or 0.0)) if at_all else None,
        height if known else None,
        None if heading is None else heading % 360.0,
        heading is not None and reference.startswith("M"),
        accuracy if at_all and accuracy is not None and accuracy > 0.0 else None,
    )


def _degrees(
    gps: Mapping[int, object], tag: int, ref_tag: int, negative: str, greatest: float
) -> float | None:
    """Return an angle given as degrees, minutes and seconds, and by a letter its side."""
    parts = gps.get(tag)
    if not isinstance(parts, tuple) or len(parts) != 3:
        return None
    numbers = [number_of(part) for part in parts]
    if None in numbers:
        return None
    whole, minutes, seconds = (float(number or 0.0) for number in numbers)
    value = whole + minutes / 60.0 + seconds / 3600.0
    if not 0.0 <= value <= greatest:
        return None
    return -value if str(gps.get(ref_tag, "")).upper().startswith(negative) else value


def number_of(value: object) -> float | None:
    """Return a tag's number where it is one: a rational may be 0/0."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if isfinite(number) else None

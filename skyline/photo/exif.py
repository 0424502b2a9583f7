"""Field of view, place and direction of a photo from what its camera noted in EXIF."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from math import atan, degrees, hypot, isfinite

from PIL.ExifTags import GPS, Base

from skyline.photo.projection import MAX_FOV_DEG, MIN_FOV_DEG

log = logging.getLogger(__name__)

_FULL_FRAME_DIAGONAL_MM = hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""FocalPlaneResolutionUnit: inch, centimetre, millimetre, micrometre; inch where absent."""
_ASPECT_TOLERANCE = 0.02
_LOWEST_M, _HIGHEST_M = -500.0, 9000.0
_MAX_PINHOLE_ASPECT = 2.5
"""Wider photos are stitched or swept panoramas; the lens says nothing about their field of view."""


def fov_from_exif(
    tags: Mapping[int, object], stored_size: tuple[int, int], turned: bool
) -> float | None:
    """Return the horizontal field of view of the upright photo, degrees, or None.

    From FocalLengthIn35mmFilm, which by CIPA DCG-001 compares diagonals, else from FocalLength
    and FocalPlaneXResolution (EXIF 2.32, 4.6.5). None where neither is there, where the photo
    was cropped after it was taken, or where it is a panorama.

    Parameters
    ----------
    tags : mapping
        EXIF tag numbers to values, the main and the Exif directories joined.
    stored_size : (int, int)
        Width and height of the image as stored, before its orientation is applied.
    turned : bool
        Whether its orientation swaps width and height.
    """
    width, height = stored_size
    sensor_width, sensor_height = _sensor_size(tags, stored_size)
    if abs(_aspect(width, height) / _aspect(sensor_width, sensor_height) - 1.0) > _ASPECT_TOLERANCE:
        log.info("EXIF field of view left aside: the photo was cropped")
        return None
    if _aspect(width, height) > _MAX_PINHOLE_ASPECT:
        log.info("EXIF field of view left aside: the photo is a panorama")
        return None
    focal_px = _focal_px(tags, stored_size, sensor_width)
    if focal_px is None:
        return None
    upright_width = height if turned else width
    fov_deg = 2.0 * degrees(atan(upright_width / 2.0 / focal_px))
    return fov_deg if MIN_FOV_DEG <= fov_deg <= MAX_FOV_DEG else None


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
    height = _number(gps.get(GPS.GPSAltitude))
    if height is not None and gps.get(GPS.GPSAltitudeRef) in (1, b"\x01"):
        height = -height
    if height is not None and not _LOWEST_M <= height <= _HIGHEST_M:
        height = None
    heading = _number(gps.get(GPS.GPSImgDirection))
    if heading is not None and not 0.0 <= heading <= 360.0:
        heading = None
    reference = str(gps.get(GPS.GPSImgDirectionRef, "")).upper()
    return NotedPlace(
        (float(lon or 0.0), float(lat or 0.0)) if at_all else None,
        height if known else None,
        None if heading is None else heading % 360.0,
        heading is not None and reference.startswith("M"),
        _positive(gps.get(GPS.GPSHPositioningError)) if at_all else None,
    )


def _degrees(
    gps: Mapping[int, object], tag: int, ref_tag: int, negative: str, greatest: float
) -> float | None:
    """Return an angle given as degrees, minutes and seconds, and by a letter its side."""
    parts = gps.get(tag)
    if not isinstance(parts, tuple) or len(parts) != 3:
        return None
    numbers = [_number(part) for part in parts]
    if None in numbers:
        return None
    whole, minutes, seconds = (float(number or 0.0) for number in numbers)
    value = whole + minutes / 60.0 + seconds / 3600.0
    if not 0.0 <= value <= greatest:
        return None
    return -value if str(gps.get(ref_tag, "")).upper().startswith(negative) else value


def _focal_px(
    tags: Mapping[int, object], stored_size: tuple[int, int], sensor_width: float
) -> float | None:
    """Return the focal length in pixels of the stored image."""
    equivalent_mm = _positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is not None:
        return equivalent_mm * hypot(*stored_size) / _FULL_FRAME_DIAGONAL_MM
    focal_mm = _positive(tags.get(Base.FocalLength))
    per_unit = _positive(tags.get(Base.FocalPlaneXResolution))
    unit = _positive(tags.get(Base.FocalPlaneResolutionUnit))
    unit_mm = _MM_PER_UNIT.get(int(unit or 2))
    if focal_mm is None or per_unit is None or unit_mm is None:
        return None
    return focal_mm * per_unit / unit_mm * stored_size[0] / sensor_width


def _sensor_size(tags: Mapping[int, object], stored_size: tuple[int, int]) -> tuple[float, float]:
    """Return the size the camera noted, which resizing leaves and cropping contradicts."""
    width = _positive(tags.get(Base.ExifImageWidth))
    height = _positive(tags.get(Base.ExifImageHeight))
    if width is None or height is None:
        return float(stored_size[0]), float(stored_size[1])
    # Some phones note the upright size of a photo that is stored lying.
    noted_turned = (width < height) != (stored_size[0] < stored_size[1])
    return (height, width) if noted_turned else (width, height)


def _aspect(width: float, height: float) -> float:
    return max(width, height) / min(width, height)


def _positive(value: object) -> float | None:
    """Return a tag's number where it is one above 0."""
    number = _number(value)
    return number if number is not None and number > 0.0 else None


def _number(value: object) -> float | None:
    """Return a tag's number where it is one: a rational may be 0/0."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if isfinite(number) else None

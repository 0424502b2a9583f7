"""What a photo's camera noted in EXIF: place and direction, and the field of view of its lens.

A field of view is taken where it can be believed. Two sources are compared: the 35 mm equivalent
(CIPA DCG-001 compares diagonals), and the focal length with the resolution of the focal plane
(EXIF 2.32, 4.6.5). Both are of the frame whose size the camera noted. A file of that shape was at
most resized since, which changes nothing. One of another shape was cropped, and what was kept is
at most the frame.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import atan, degrees, hypot, isfinite, log, radians, sin, sqrt

from PIL.ExifTags import GPS, Base

from skyline.photo.projection import MAX_PANORAMA_DEG, MIN_FOV_DEG

_LOWEST_M, _HIGHEST_M = -500.0, 9000.0
_FULL_FRAME_DIAGONAL_MM = hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""FocalPlaneResolutionUnit: inch, centimetre, millimetre, micrometre; inch where absent."""
_ASPECT_TOLERANCE = 0.02
MAX_PINHOLE_ASPECT = 2.5
"""Wider photos are stitched or swept panoramas, or strips; the lens says nothing about those."""
_MAX_FOV_DEG = 135.0
"""Of the frame's diagonal lenses that draw straight lines straight see no more."""
_SENSOR_MM = (2.0, 80.0)
"""Diagonals of sensors, of phones to medium format."""
_AGREE = log(1.1)
"""Estimates of the focal length nearer than this are one: a 35 mm equivalent is rounded."""
_SWEPT = 6.0
"""CustomRendered of a panorama, as Apple's phones note it."""
_SWEPT_HEIGHT, _SWEPT_SD = 0.83, 0.12
"""Part of the camera's height that a panorama has, between 0.7 and nearly all, and how sure its
width is."""
_KEPT_MEAN, _KEPT_SD, _KEPT_MOST = 0.75, 0.5 / sqrt(12.0), 1.05
"""Of the greatest field of view that a crop can have: between half and all of it, evenly."""


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


@dataclass(frozen=True, slots=True)
class Lens:
    """What a file notes of the horizontal field of view of its photo.

    Attributes
    ----------
    fov_deg : float or None
        The likeliest, degrees; None where nothing is known.
    sd_deg : float or None
        Its deviation; None where it is as good as one that a person gives.
    most_deg : float or None
        The greatest that is possible, where the photo was cropped.
    said : str
        Why, in words; empty where the file notes no lens.
    """

    fov_deg: float | None = None
    sd_deg: float | None = None
    most_deg: float | None = None
    said: str = ""


@dataclass(frozen=True, slots=True)
class _Focal:
    """A focal length in diagonals of the frame, the share it may be off, and whence it is."""

    diagonals: float
    share: float | None
    source: str


def place_from_exif(gps: Mapping[int, object]) -> NotedPlace:
    """Return what a photo's GPS directory (EXIF 2.32, 4.6.6) says of where it was taken."""
    lon = _degrees(gps, GPS.GPSLongitude, GPS.GPSLongitudeRef, "W", 180.0)
    lat = _degrees(gps, GPS.GPSLatitude, GPS.GPSLatitudeRef, "S", 90.0)
    # Cameras without a fix write zeros, or say that what they write is void.
    known = str(gps.get(GPS.GPSStatus, "A")).strip("\0 ").upper() != "V"
    place = (lon, lat) if known and lon is not None and lat is not None else None
    if place == (0.0, 0.0):
        place = None
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
        place,
        height if known else None,
        None if heading is None else heading % 360.0,
        heading is not None and reference.startswith("M"),
        _positive(gps.get(GPS.GPSHPositioningError)) if place else None,
    )


def _degrees(
    gps: Mapping[int, object], tag: int, ref_tag: int, negative: str, greatest: float
) -> float | None:
    """Return an angle given as degrees, minutes and seconds, and by a letter its side."""
    parts = gps.get(tag)
    numbers = [_number(part) for part in parts] if isinstance(parts, tuple) else []
    known = [number for number in numbers if number is not None]
    if not len(numbers) == len(known) == 3:
        return None
    value = known[0] + known[1] / 60.0 + known[2] / 3600.0
    if not 0.0 <= value <= greatest:
        return None
    # The difference, since -0.0 would be shown with its sign.
    return 0.0 - value if str(gps.get(ref_tag, "")).upper().startswith(negative) else value


def lens_of(tags: Mapping[int, object], stored_size: tuple[int, int], turned: bool) -> Lens:
    """Return what a photo's EXIF, the main and the Exif directories joined, says of its lens.

    ``stored_size`` is the width and height before the orientation is applied; it is ``turned``
    where that swaps them.
    """
    frame = _frame(tags, stored_size)
    focal, dropped = _focal(tags, frame)
    if focal is None:
        return Lens(said=dropped)
    if max(stored_size) / min(stored_size) > MAX_PINHOLE_ASPECT:
        return Lens(said=f"{focal.source} left aside: the photo is a panorama or a strip")
    kept = _kept(stored_size, frame)
    across = kept[1] if turned else kept[0]
    most_deg = 2.0 * degrees(atan(across / 2.0 / (focal.diagonals * hypot(*frame))))
    if most_deg < MIN_FOV_DEG:
        return Lens(said=f"{focal.source} left aside: {most_deg:.2g} degrees are no photo's")
    said = "; ".join(filter(None, [focal.source, dropped]))
    if _is_whole(stored_size, frame) or _is_unscaled(stored_size, frame):
        sd_deg = None if focal.share is None else degrees(focal.share * sin(radians(most_deg)))
        return Lens(most_deg, sd_deg, None, said)
    cropped = f"{focal.source}, but the photo was cropped: at most {most_deg:.1f} degrees"
    said = "; ".join(filter(None, [cropped, dropped]))
    return Lens(_KEPT_MEAN * most_deg, _KEPT_SD * most_deg, _KEPT_MOST * most_deg, said)


def swept_lens_of(tags: Mapping[int, object], size_px: tuple[int, int]) -> Lens | None:
    """Return what EXIF says of a panorama that a phone swept; None where it does not say so.

    ``size_px`` is the panorama's width and height, upright. Its scale is the camera's, held on end,
    but phones keep more or less of the height.
    """
    if _positive(tags.get(Base.CustomRendered)) != _SWEPT:
        return None
    equivalent_mm = _positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None:
        return Lens(said="EXIF says that the photo is a panorama, and not how wide")
    width, height = size_px
    focal_px = equivalent_mm / 36.0 * height / _SWEPT_HEIGHT
    fov_deg = min(degrees(width / focal_px), MAX_PANORAMA_DEG)
    said = f"EXIF says that the photo is a panorama: about {fov_deg:.0f} degrees"
    return Lens(fov_deg, _SWEPT_SD * fov_deg, MAX_PANORAMA_DEG, said)


def _focal(tags: Mapping[int, object], frame: tuple[float, float]) -> tuple[_Focal | None, str]:
    """Return the focal length to believe, and what was dropped for what reason."""
    equivalent_mm = _positive(tags.get(Base.FocalLengthIn35mmFilm))
    focal_mm = _positive(tags.get(Base.FocalLength))
    sensor_mm = _sensor_diagonal_mm(tags, frame)
    by_film = None if equivalent_mm is None else equivalent_mm / _FULL_FRAME_DIAGONAL_MM
    by_plane = None if focal_mm is None or sensor_mm is None else focal_mm / sensor_mm
    dropped = []
    if by_film is not None and not _is_lens(by_film, focal_mm):
        dropped.append(f"EXIF's 35 mm equivalent of {equivalent_mm:g} mm is no lens's")
        by_film = None
    if by_plane is not None and not _is_lens(by_plane, focal_mm):
        dropped.append("EXIF's focal plane is no camera's")
        by_plane = None
    said = "; ".join(dropped)
    if by_film is None or by_plane is None:
        one = by_film or by_plane
        source = "EXIF's 35 mm equivalent" if by_film else "EXIF's focal plane"
        return None if one is None else _Focal(one, None, source), said
    off = log(by_film / by_plane)
    if abs(off) <= _AGREE:
        return _Focal(by_film, None, "EXIF's 35 mm equivalent, and its focal plane agrees"), said
    source = "EXIF's 35 mm equivalent and its focal plane contradict one another"
    return _Focal(sqrt(by_film * by_plane), abs(off) / 2.0, source), said


def _is_lens(diagonals: float, focal_mm: float | None) -> bool:
    """Whether a focal length, in diagonals of its frame, is one of a lens before a sensor."""
    if 2.0 * degrees(atan(0.5 / diagonals)) > _MAX_FOV_DEG:
        return False
    return focal_mm is None or _SENSOR_MM[0] <= focal_mm / diagonals <= _SENSOR_MM[1]


def _sensor_diagonal_mm(tags: Mapping[int, object], frame: tuple[float, float]) -> float | None:
    """Return the diagonal of what the frame's pixels took of the focal plane."""
    unit_mm = _MM_PER_UNIT.get(int(_positive(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    across = _positive(tags.get(Base.FocalPlaneXResolution))
    if unit_mm is None or across is None:
        return None
    return hypot(*frame) * unit_mm / across


def _frame(tags: Mapping[int, object], stored: tuple[int, int]) -> tuple[float, float]:
    """Return the size the camera noted, which resizing leaves and cropping contradicts.

    Photos on end are noted lying or upright. What fits a file best is taken, and of what fits none
    the wider part.
    """
    width = _positive(tags.get(Base.ExifImageWidth))
    height = _positive(tags.get(Base.ExifImageHeight))
    if width is None or height is None:
        return float(stored[0]), float(stored[1])
    frames = (width, height), (height, width)

    def fit(frame: tuple[float, float]) -> tuple[bool, bool, float]:
        return _is_whole(stored, frame), _is_unscaled(stored, frame), _kept(stored, frame)[0]

    return max(frames, key=fit)


def _kept(stored: tuple[int, int], frame: tuple[float, float]) -> tuple[float, float]:
    """Return the greatest part of a frame, in its pixels, that has the shape of what is stored."""
    if _is_unscaled(stored, frame):
        return float(stored[0]), float(stored[1])
    scale = min(frame[0] / stored[0], frame[1] / stored[1])
    return stored[0] * scale, stored[1] * scale


def _is_whole(stored: tuple[int, int], frame: tuple[float, float]) -> bool:
    return abs(stored[0] / stored[1] / (frame[0] / frame[1]) - 1.0) <= _ASPECT_TOLERANCE


def _is_unscaled(stored: tuple[int, int], frame: tuple[float, float]) -> bool:
    """Whether a file has all columns or all rows of the frame, and no more of the other."""
    return max(stored[0] - frame[0], stored[1] - frame[1]) == 0.0


def _number(value: object) -> float | None:
    """Return a tag's number where it is one: a rational may be 0/0."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if isfinite(number) else None


def _positive(value: object) -> float | None:
    """Return a tag's number where it is one above 0."""
    number = _number(value)
    return number if number is not None and number > 0.0 else None

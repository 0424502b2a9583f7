"""The camera that a photo's EXIF and XMP note: its field of view, its place and its heading.

Tags mean what the standard defines (EXIF 2.32, 4.6.5 and 4.6.6, and 3.0). If a tag that decides the
meaning of a number is missing, the number is not guessed but left aside, with a sentence that gives
the reason.

EXIF notes a lens in two ways: the 35 mm equivalent (CIPA DCG-001 compares diagonals), and the focal
length with the resolution of the focal plane. Each is wrong in whole series of cameras, so one
alone is a hint, and only two that agree are a measurement. Both describe the frame whose size the
camera noted; a panorama notes its own frame in XMP. A file of the frame's shape was at most
resized, which changes nothing. A file of another shape was cropped, and shows at most the frame.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import atan, degrees, exp, hypot, isfinite, log, radians, sin, sqrt
from typing import TypeVar

from PIL.ExifTags import GPS, Base
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError

from skyline.photo.projection import MAX_PANORAMA_DEG, MIN_FOV_DEG, Projection

_FULL_FRAME_DIAGONAL_MM = hypot(36.0, 24.0)
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""FocalPlaneResolutionUnit: inch (also if absent), centimetre, millimetre, micrometre."""
_ASPECT_TOLERANCE = 0.02
MAX_PINHOLE_ASPECT = 2.5
"""Wider photos are stitched or swept panoramas, or strips, whose width no lens determines."""
_MAX_FOV_DEG = 135.0
"""Widest diagonal field of view of lenses that draw straight lines straight."""
_SENSOR_MM = (2.0, 80.0)
"""Diagonals of sensors, from phones to medium format."""
_AGREE = log(1.1)
"""Largest difference of the logarithms of two focal lengths that agree: one is rounded."""
_FILM_ALONE = 0.1
"""Deviation of the logarithm of a 35 mm equivalent: it is rounded to a millimetre (2 %), compares
widths in some cameras (5 %), and is of the sensor before stabilization crops it (8 %)."""
_PLANE_ALONE = 0.5 * log(1.5)
"""Deviation of the logarithm of a focal length from the focal plane: wrong values are off by the
step between two sensor formats, 1.5 (Exiv2's issue 3097), or by the scale of a reduced picture."""
_SWEPT = 6.0
"""Value of CustomRendered that Apple's phones note for a panorama."""
_SWEPT_HEIGHT, _SWEPT_SD = 0.83, 0.12
"""Share of the camera's height that a swept panorama keeps, between 0.7 and nearly all, and the
relative deviation of its width."""
_KEPT_MEAN, _KEPT_SD, _KEPT_MOST = 0.75, 0.5 / sqrt(12.0), 1.05
"""Mean, deviation and greatest value of a crop's field of view, as a share of the greatest
possible: it is taken to lie evenly between half and all of that."""
_GPANO = re.compile(r"GPano:(\w+)\s*(?:=\s*[\"']|>)\s*([\w.]+)")
"""Tags of the namespace http://ns.google.com/photos/1.0/panorama/, however XMP writes them."""

_LOWEST_M, _HIGHEST_M = -500.0, 9000.0
_ERROR_PER_DOP_M = 5.0
"""Error of the ranges that a receiver measures; the satellites' geometry (DOP) multiplies it."""
_DATUM_NAME = re.compile(r"[\w -]{1,30}")
_UP, _DOWN, _UP_ELLIPSOIDAL, _DOWN_ELLIPSOIDAL = range(4)
"""GPSAltitudeRef; EXIF 3.0 added heights above the ellipsoid."""

T = TypeVar("T")
_Tags = Mapping[int, object]


@dataclass(frozen=True, slots=True)
class Lens:
    """The horizontal field of view that a file notes for its photo.

    Attributes
    ----------
    fov_deg : float or None
        The likeliest horizontal field of view; None if nothing is known.
    sd_deg : float or None
        Standard deviation of ``fov_deg``; None if it is as accurate as a value that a user gives.
    most_deg : float or None
        The greatest possible field of view, if the photo was cropped.
    reason : str
        The source of the values in words, or the reason that there are none; empty if the file
        notes no lens.
    """

    fov_deg: float | None = None
    sd_deg: float | None = None
    most_deg: float | None = None
    reason: str = ""


@dataclass(frozen=True, slots=True)
class _Focal:
    """A focal length in diagonals of the frame, and the deviation of its logarithm.

    The deviation is None if two sources agree.
    """

    diagonals: float
    sd: float | None
    source: str


def camera_of(tags: _Tags, xmp: str, size_px: tuple[int, int]) -> tuple[Projection, Lens]:
    """Return the projection and the lens that a photo notes; arguments as of `lens_of`."""
    panorama = panorama_of_xmp(xmp, size_px)
    if panorama is not None:
        return panorama
    swept = swept_lens_of(tags, size_px)
    if swept is not None:
        return Projection.CYLINDRICAL, swept
    return Projection.PERSPECTIVE, lens_of(tags, size_px)


def lens_of(tags: _Tags, size_px: tuple[int, int]) -> Lens:
    """Return the lens noted in a photo's EXIF, whose main and Exif directories are joined.

    ``size_px`` is the width and the height of the file's pixels, upright.
    """
    frame = _frame(tags, size_px)
    focal, dropped = _focal(tags, frame)
    if focal is None:
        return Lens(reason=dropped)
    if max(size_px) / min(size_px) > MAX_PINHOLE_ASPECT:
        return Lens(reason=f"{focal.source} left aside: the photo is a panorama or a strip")
    tangent = _kept_width(size_px, frame) / 2.0 / (focal.diagonals * hypot(*frame))
    fov_deg = 2.0 * degrees(atan(tangent))
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"{focal.source} left aside: {fov_deg:.2g} degrees are no photo's")
    sd_deg = None if focal.sd is None else degrees(focal.sd * sin(radians(fov_deg)))
    if _is_whole(size_px, frame) or _is_unscaled(size_px, frame):
        return Lens(fov_deg, sd_deg, None, "; ".join(filter(None, [focal.source, dropped])))
    reason = f"{focal.source}, but the photo was cropped: at most {fov_deg:.1f} degrees"
    most_deg = _KEPT_MOST * 2.0 * degrees(atan(tangent * exp(2.0 * (focal.sd or 0.0))))
    return Lens(
        _KEPT_MEAN * fov_deg,
        hypot(_KEPT_SD * fov_deg, sd_deg or 0.0),
        most_deg,
        "; ".join(filter(None, [reason, dropped])),
    )


def swept_lens_of(tags: _Tags, size_px: tuple[int, int]) -> Lens | None:
    """Return the field of view of a panorama that a phone swept; None if EXIF notes none.

    ``size_px`` is the panorama's width and height, upright. Its scale is that of the camera held
    upright, but phones keep more or less of the height.
    """
    if _positive(tags.get(Base.CustomRendered)) != _SWEPT:
        return None
    equivalent_mm = _positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None:
        return Lens(reason="EXIF says that the photo is a panorama, but not how wide")
    width, height = size_px
    focal_px = equivalent_mm / 36.0 * height / _SWEPT_HEIGHT
    fov_deg = min(degrees(width / focal_px), MAX_PANORAMA_DEG)
    reason = f"EXIF says that the photo is a panorama: about {fov_deg:.0f} degrees"
    return Lens(fov_deg, _SWEPT_SD * fov_deg, MAX_PANORAMA_DEG, reason)


def panorama_of_xmp(xmp: str, size_px: tuple[int, int]) -> tuple[Projection, Lens] | None:
    """Return the projection and field of view of a panorama; None if XMP notes no panorama.

    ``size_px`` is the width and the height of the file's pixels, upright. XMP notes the size of the
    panorama when it was made and the width of a full turn. A file of that shape shows the whole
    panorama. A file with all its rows or all its columns was cropped to its own size. Any other
    file shows at least its pixels at the panorama's scale, and at most the largest part of its
    shape.
    """
    tags = dict(_GPANO.findall(xmp))
    width, turn, height = (
        _positive(tags.get(name))
        for name in (
            "CroppedAreaImageWidthPixels", "FullPanoWidthPixels", "CroppedAreaImageHeightPixels",
        )
    )  # fmt: skip
    if width is None and turn is None and "ProjectionType" not in tags:
        return None
    noted = tags.get("ProjectionType", Projection.EQUIRECTANGULAR)
    if noted not in {one for one in Projection if one.is_panorama}:
        reason = f"XMP says that the photo's projection is {noted}, which is not known here"
        return Projection.PERSPECTIVE, Lens(reason=reason)
    if width is None or turn is None or width > turn:
        reason = "XMP says that the photo is a panorama, but not how wide"
        return Projection(noted), Lens(reason=reason)
    return Projection(noted), _panorama_lens(size_px, width, height, MAX_PANORAMA_DEG / turn)


def _panorama_lens(
    size_px: tuple[int, int], width: float, height: float | None, deg_per_px: float
) -> Lens:
    """Return the field of view of a file's part of a panorama of the given width and height."""
    kept_px = width if height is None else _kept_width(size_px, (width, height))
    fov_deg = kept_px * deg_per_px
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"XMP's panorama left aside: {fov_deg:.2g} degrees are no photo's")
    if height is None:
        is_known = size_px[0] == width
    else:
        frame, rounding = (width, height), 1.0 / size_px[0] + 1.0 / size_px[1]
        is_known = _is_unscaled(size_px, frame) or _is_whole(size_px, frame, rounding)
    if is_known:
        return Lens(fov_deg, reason="XMP notes a panorama of this shape and scale")
    # Crops are sometimes shrunk, hardly ever enlarged.
    least_deg = deg_per_px * min(float(size_px[0]), 0.5 * kept_px)
    return Lens(
        max(sqrt(least_deg * fov_deg), MIN_FOV_DEG),
        (fov_deg - least_deg) / sqrt(12.0),
        min(_KEPT_MOST * fov_deg, MAX_PANORAMA_DEG),
        f"XMP notes a panorama, but the photo was cropped since: at most {fov_deg:.1f} degrees",
    )


def _focal(tags: _Tags, frame: tuple[float, float]) -> tuple[_Focal | None, str]:
    """Return the likeliest focal length, and the values that were dropped with their reasons."""
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
    reason = "; ".join(dropped)
    if by_film is not None and by_plane is not None:
        middle, off = sqrt(by_film * by_plane), abs(log(by_film / by_plane))
        if off <= _AGREE:
            source = "EXIF's 35 mm equivalent, and its focal plane agrees"
            return _Focal(middle, None, source), reason
        source = "EXIF's 35 mm equivalent and its focal plane contradict one another"
        return _Focal(middle, max(off / 2.0, _FILM_ALONE), source), reason
    if by_film is not None:
        return _Focal(by_film, _FILM_ALONE, "EXIF's 35 mm equivalent alone"), reason
    if by_plane is not None:
        return _Focal(by_plane, _PLANE_ALONE, "EXIF's focal plane alone"), reason
    return None, reason


def _is_lens(diagonals: float, focal_mm: float | None) -> bool:
    """Return whether a focal length, in diagonals of its frame, is possible for lens and sensor."""
    if 2.0 * degrees(atan(0.5 / diagonals)) > _MAX_FOV_DEG:
        return False
    return focal_mm is None or _SENSOR_MM[0] <= focal_mm / diagonals <= _SENSOR_MM[1]


def _sensor_diagonal_mm(tags: _Tags, frame: tuple[float, float]) -> float | None:
    """Return the diagonal of the focal plane that the frame's pixels cover.

    None if EXIF does not note the frame's number of pixels: the file itself may have fewer.
    """
    unit_mm = _MM_PER_UNIT.get(int(_positive(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    across = _positive(tags.get(Base.FocalPlaneXResolution))
    sides = (tags.get(Base.ExifImageWidth), tags.get(Base.ExifImageHeight))
    is_sized = all(_positive(side) for side in sides)
    if unit_mm is None or across is None or not is_sized:
        return None
    return hypot(*frame) * unit_mm / across


def _frame(tags: _Tags, size_px: tuple[int, int]) -> tuple[float, float]:
    """Return the frame size that the camera noted; resizing keeps its shape, cropping does not.

    For a photo taken upright, some cameras note the frame upright and some lying. Of the two the
    better fit to the file is taken; if neither fits, the frame of which the file shows the wider
    part.
    """
    width = _positive(tags.get(Base.ExifImageWidth))
    height = _positive(tags.get(Base.ExifImageHeight))
    if width is None or height is None:
        return float(size_px[0]), float(size_px[1])
    frames = (width, height), (height, width)

    def fit(frame: tuple[float, float]) -> tuple[bool, bool, float]:
        return _is_whole(size_px, frame), _is_unscaled(size_px, frame), _kept_width(size_px, frame)

    return max(frames, key=fit)


def _kept_width(size_px: tuple[int, int], frame: tuple[float, float]) -> float:
    """Return the width of the largest part of a frame, in its pixels, with the shape of a file."""
    if _is_unscaled(size_px, frame):
        return float(size_px[0])
    return size_px[0] * min(frame[0] / size_px[0], frame[1] / size_px[1])


def _is_whole(
    size_px: tuple[int, int], frame: tuple[float, float], tolerance: float = _ASPECT_TOLERANCE
) -> bool:
    """Return whether a file has the shape of a frame."""
    return abs(size_px[0] / size_px[1] / (frame[0] / frame[1]) - 1.0) <= tolerance


def _is_unscaled(size_px: tuple[int, int], frame: tuple[float, float]) -> bool:
    """Return whether a file has all columns or all rows of the frame, and is nowhere larger."""
    return max(size_px[0] - frame[0], size_px[1] - frame[1]) == 0.0


@dataclass(frozen=True, slots=True)
class NotedPlace:
    """The place and the heading noted in a photo; None for values that it does not note.

    Attributes
    ----------
    lonlat_deg : (float, float), optional
        Longitude and latitude, WGS 84.
    elevation_m : float, optional
        Elevation above sea level.
    heading_deg : float, optional
        Heading of the optical axis, clockwise from north, in [0, 360).
    is_magnetic : bool or None
        Whether the heading counts from magnetic north; None if the photo does not note it.
    accuracy_m : float, optional
        The camera's own estimate of the error of its position.
    left_aside : str
        Sentences on GPS tags that cannot be used and the reason, without the position itself.
    """

    lonlat_deg: tuple[float, float] | None = None
    elevation_m: float | None = None
    heading_deg: float | None = None
    is_magnetic: bool | None = False
    accuracy_m: float | None = None
    left_aside: str = ""


NOTHING_NOTED = NotedPlace()


class _UnusableError(Exception):
    """The reason, in words, that a GPS tag cannot be used."""


def place_from_exif(gps: _Tags) -> NotedPlace:
    """Return the place and the heading noted in a photo's GPS directory."""
    left_aside: list[str] = []

    def noted(name: str, read: Callable[[_Tags], T | None]) -> T | None:
        try:
            return read(gps)
        except _UnusableError as why:
            left_aside.append(f"The photo's GPS {name} is left aside: {why}.")
            return None

    place = noted("position", _lonlat_deg)
    elevation_m = noted("altitude", _elevation_m)
    heading_deg = noted("direction", _heading_deg)
    north = {"M": True, "T": False}.get(_text(gps, GPS.GPSImgDirectionRef)[:1])
    accuracy_m = _positive(gps.get(GPS.GPSHPositioningError))
    dop = _positive(gps.get(GPS.GPSDOP))
    if accuracy_m is None and dop is not None:
        accuracy_m = _ERROR_PER_DOP_M * dop
    return NotedPlace(
        place,
        elevation_m,
        heading_deg,
        False if heading_deg is None else north,
        None if place is None else accuracy_m,
        " ".join(left_aside),
    )


def _lonlat_deg(gps: _Tags) -> tuple[float, float] | None:
    """Return longitude and latitude (WGS 84); raises `_UnusableError`."""
    if GPS.GPSLongitude not in gps and GPS.GPSLatitude not in gps:
        return None
    _require_fix(gps)
    lat = _angle_deg(gps, "latitude", GPS.GPSLatitude, GPS.GPSLatitudeRef, "NS", 90.0)
    lon = _angle_deg(gps, "longitude", GPS.GPSLongitude, GPS.GPSLongitudeRef, "EW", 180.0)
    if lon == lat == 0.0:
        raise _UnusableError("latitude and longitude are 0, as cameras without a fix write them")
    datum = _text(gps, GPS.GPSMapDatum) or "WGS 84"
    try:
        crs = CRS.from_user_input(datum) if _DATUM_NAME.fullmatch(datum) else None
    except CRSError:
        crs = None
    if crs is None or not crs.is_geographic:
        raise _UnusableError(f"its datum {datum[:30]!r} is not known")
    lon, lat = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(lon, lat)
    return lon, lat


def _angle_deg(
    gps: _Tags, name: str, tag: int, side_tag: int, sides: str, most_deg: float
) -> float:
    """Return an angle from degrees, minutes and seconds, and its sign from one of two letters."""
    parts = gps.get(tag)
    numbers = [_number(part) for part in parts] if isinstance(parts, tuple) else []
    known = [one for one in numbers if one is not None]
    if not len(numbers) == len(known) == 3:
        raise _UnusableError(f"the {name} is not given as degrees, minutes and seconds")
    angle_deg = known[0] + known[1] / 60.0 + known[2] / 3600.0
    if min(known) < 0.0 or max(known[1:]) > 60.0 or angle_deg > most_deg:
        raise _UnusableError(f"the {name} is outside 0 to {most_deg:g} degrees, 60', 60\"")
    side = _text(gps, side_tag)[:1]
    if side not in tuple(sides):
        raise _UnusableError(f"the {name} does not say whether it is {' or '.join(sides)}")
    # A difference, since -0.0 would be shown with its sign.
    return 0.0 - angle_deg if side == sides[1] else angle_deg


def _elevation_m(gps: _Tags) -> float | None:
    """Return the elevation above sea level; raises `_UnusableError`."""
    if GPS.GPSAltitude not in gps:
        return None
    _require_fix(gps)
    height_m = _number(gps[GPS.GPSAltitude])
    reference = gps.get(GPS.GPSAltitudeRef, _UP)  # The default in the standard.
    reference = _number(int.from_bytes(reference) if isinstance(reference, bytes) else reference)
    if height_m is None:
        raise _UnusableError("it is not a number")
    if reference in (_UP_ELLIPSOIDAL, _DOWN_ELLIPSOIDAL):
        raise _UnusableError("it counts from the ellipsoid, not from sea level")
    if reference not in (_UP, _DOWN):
        raise _UnusableError("it does not say whether it is above or below sea level")
    height_m = -height_m if reference == _DOWN else height_m
    if not _LOWEST_M <= height_m <= _HIGHEST_M:
        raise _UnusableError(f"{height_m:.0f} m is outside {_LOWEST_M:.0f} to {_HIGHEST_M:.0f} m")
    return height_m


def _heading_deg(gps: _Tags) -> float | None:
    if GPS.GPSImgDirection not in gps:
        return None
    heading_deg = _number(gps[GPS.GPSImgDirection])
    if heading_deg is None or not 0.0 <= heading_deg <= 360.0:
        raise _UnusableError("it is not within 0 to 360 degrees")
    return heading_deg % 360.0


def _require_fix(gps: _Tags) -> None:
    if _text(gps, GPS.GPSStatus)[:1] == "V":
        raise _UnusableError("the receiver had no fix (GPSStatus V)")


def _text(gps: _Tags, tag: int) -> str:
    """Return a tag's text in capitals; "" if it has none."""
    value = gps.get(tag, "")
    text = value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
    return text.strip("\0 ").upper()


def _number(value: object) -> float | None:
    """Return a tag's number; None if it is not finite, as the rational 0/0, or no number."""
    try:
        as_float = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return as_float if isfinite(as_float) else None


def _positive(value: object) -> float | None:
    """Return a tag's number if it is above 0, else None."""
    found = _number(value)
    return found if found is not None and found > 0.0 else None

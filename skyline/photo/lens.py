"""The field of view that a photo's EXIF and XMP note, from the values in them that agree.

EXIF notes a lens in up to three ways: the 35 mm equivalent (CIPA DCG-001 compares diagonals), the
focal length with the resolution of the focal plane, and the focal length with the camera's model,
whose sensor is in lensfun's database (https://lensfun.github.io). Each is wrong in whole series of
cameras or in edited files, so one alone is a hint, and only two that agree are a measurement.

All describe the frame whose size the camera noted; a panorama notes its own frame in XMP. A file of
the frame's shape was at most resized, which changes nothing. A file of another shape was cropped,
and shows at most the frame. A file of a shape that no camera takes was cropped too, even if the
noted size agrees with it: programs that crop note the new size.
"""

import re
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from itertools import combinations
from math import atan, degrees, exp, hypot, log, radians, sin, sqrt

from PIL.ExifTags import Base

from skyline.photo.exif import Tags, positive, text_of
from skyline.photo.query import MAX_PANORAMA_DEG, MIN_FOV_DEG, Lens, Projection
from skyline.photo.xmp import Xmp

_FULL_FRAME_MM = hypot(36.0, 24.0)
"""Diagonal of 35 mm film."""
_SEVERAL_SENSORS = re.compile("apple|honor|huawei|lg|microsoft|nokia|samsung sm-", re.IGNORECASE)
"""Phones, whose models do not say which of their cameras took a photo."""
_ONE_SENSOR_RATIO = 1.05
"""Largest ratio of two sensors of one camera, beyond which it has several."""
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
ALONE_SD = 0.1
"""Deviation of the logarithm of a 35 mm equivalent: it is rounded to a millimetre (2 %), compares
widths in some cameras (5 %), and is of the sensor before stabilization crops it (8 %). A focal
length on a known sensor is taken to be as good: converters and crops inside a camera change it."""
_PLANE_ALONE = 0.5 * log(1.5)
"""Deviation of the logarithm of a focal length from the focal plane: wrong values are off by the
step between two sensor formats, 1.5 (Exiv2's issue 3097)."""
_LEAST_PIXELS = 3e6
"""A focal plane with fewer pixels does not count by itself: most such photos were reduced by
programs that note the new size and keep the plane's resolution."""
_SHAPES = (1.0, 4 / 3, 3 / 2, 16 / 9)
"""Width over height of the frames that cameras take."""
_SCREENS = (2.0, 37 / 18, 19 / 9, 13 / 6, 20 / 9)
"""Width over height of the screens that phones take photos for."""
_USUAL_SHAPE = 4 / 3
_SWEPT = 6.0
"""Value of CustomRendered that Apple's phones note for a panorama."""
_SWEPT_HEIGHT, _SWEPT_SD = 0.83, 0.12
"""Share of the camera's height that a swept panorama keeps, between 0.7 and nearly all, and the
relative deviation of its width."""
_CROP_MEAN, _CROP_SD, _CROP_MOST = 0.75, 0.5 / sqrt(12.0), 1.05
"""Mean, deviation and greatest value of a crop's field of view, as a share of the greatest
possible: it is taken to lie evenly between half and all of that."""
_WIDEST_PX = 1e8
"""The widest full turn of a panorama that is believed."""
GPANO = "http://ns.google.com/photos/1.0/panorama"
"""Namespace of the properties of panoramas (GPano, https://developers.google.com/streetview)."""
_NAMES_PANORAMA = re.compile("GPano|photos/1.0/panorama")
"""What the text of a packet contains that notes a panorama."""
_OF_A_LENS = {"rectilinear", Projection.PERSPECTIVE}
"""Names of the projection of photos through a lens."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """The sensor of a camera: the camera's name and the sensor's diagonal."""

    camera: str
    diagonal_mm: float

    @property
    def shape(self) -> float:
        """Width over height: 3:2 for full frame, APS and 1 inch, 4:3 for all others."""
        is_3_to_2 = 24.0 < self.diagonal_mm < 46.0 or 15.0 < self.diagonal_mm < 17.0
        return 3 / 2 if is_3_to_2 else 4 / 3

    def cropped_mm(self, frame: tuple[float, float]) -> float:
        """Return the diagonal of the largest part that has the shape of a frame."""
        kept = max(frame) / min(frame)
        height_mm = self.diagonal_mm / hypot(self.shape, 1.0) * min(self.shape / kept, 1.0)
        return height_mm * hypot(kept, 1.0)


@cache
def _sensors_by_model() -> dict[str, Sensor]:
    """Return the cameras of one known sensor by the keys of their models."""
    found = defaultdict(list)
    with suppress(ImportError):  # There are no wheels for some machines.
        for one in import_module("lensfunpy").Database().cameras:
            if not _SEVERAL_SENSORS.match(f"{one.maker} {one.model}"):
                found[_model_key(one.model)].append(
                    Sensor(one.model, _FULL_FRAME_MM / one.crop_factor)
                )
    return {
        key: sensors[0]
        for key, sensors in found.items()
        if max(one.diagonal_mm for one in sensors)
        < _ONE_SENSOR_RATIO * min(one.diagonal_mm for one in sensors)
    }


def _model_key(model: str) -> str:
    """Return a model without case and spaces, in which makers' notes differ."""
    return "".join(model.split()).upper()


@dataclass(frozen=True, slots=True)
class _FocalLength:
    """A focal length in diagonals of the frame, and the deviation of its logarithm.

    The deviation is None if two sources agree.
    """

    source: str
    diagonals: float
    sd: float | None = ALONE_SD

    def log_ratio(self, other: "_FocalLength") -> float:
        """Return the difference of the logarithms of two focal lengths."""
        return abs(log(self.diagonals / other.diagonals))


def camera_of(tags: Tags, xmp: Xmp, size_px: tuple[int, int]) -> tuple[Projection, Lens]:
    """Return the projection and the lens that a photo notes; arguments as of `lens_of`."""
    panorama = panorama_of_xmp(xmp, size_px)
    if panorama is not None:
        return panorama
    swept = swept_lens_of(tags, size_px)
    if swept is not None:
        return Projection.CYLINDRICAL, swept
    return Projection.PERSPECTIVE, lens_of(tags, size_px)


def lens_of(tags: Tags, size_px: tuple[int, int]) -> Lens:
    """Return the lens noted in a photo's EXIF, whose main and Exif directories are joined.

    ``size_px`` is the width and the height of the file's pixels, upright.
    """
    sensor = _sensors_by_model().get(_model_key(text_of(tags, Base.Model)))
    noted, frame = _frames(tags, size_px, sensor)
    focals, against = _focal_lengths(tags, size_px, noted, frame, sensor)
    if not focals:
        return Lens(reason="; ".join(against))
    focal = _combined(focals)
    if max(size_px) / min(size_px) > MAX_PINHOLE_ASPECT:
        return Lens(reason=f"{focal.source} left aside: the photo is a panorama or a strip")
    tangent = _cropped_width(size_px, frame) / 2.0 / (focal.diagonals * hypot(*frame))
    fov_deg = 2.0 * degrees(atan(tangent))
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"{focal.source} left aside: {fov_deg:.2g} degrees fit no photo")
    sd_deg = None if focal.sd is None else degrees(focal.sd * sin(radians(fov_deg)))
    if _is_whole(size_px, frame) or _is_unscaled(size_px, frame):
        return Lens(fov_deg, sd_deg, None, "; ".join([focal.source, *against]))
    reason = f"{focal.source}, but the photo was cropped from {fov_deg:.1f} degrees"
    most_deg = _CROP_MOST * 2.0 * degrees(atan(tangent * exp(2.0 * (focal.sd or 0.0))))
    return Lens(
        _CROP_MEAN * fov_deg,
        hypot(_CROP_SD * fov_deg, sd_deg or 0.0),
        most_deg,
        "; ".join([reason, *against]),
    )


def swept_lens_of(tags: Tags, size_px: tuple[int, int]) -> Lens | None:
    """Return the field of view of a panorama that a phone swept; None if EXIF notes none.

    ``size_px`` is the panorama's width and height, upright. Its scale is that of the camera held
    upright, but phones keep more or less of the height.
    """
    if positive(tags.get(Base.CustomRendered)) != _SWEPT:
        return None
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None:
        return Lens(reason="EXIF says that the photo is a panorama, but not how wide")
    width, height = size_px
    focal_px = equivalent_mm / 36.0 * height / _SWEPT_HEIGHT
    fov_deg = min(degrees(width / focal_px), MAX_PANORAMA_DEG)
    reason = f"EXIF says that the photo is a panorama: about {fov_deg:.0f} degrees"
    return Lens(fov_deg, _SWEPT_SD * fov_deg, MAX_PANORAMA_DEG, reason)


def panorama_of_xmp(xmp: Xmp, size_px: tuple[int, int]) -> tuple[Projection, Lens] | None:
    """Return the projection and field of view of a panorama; None if XMP notes no panorama.

    ``size_px`` is the width and the height of the file's pixels, upright. XMP notes the size of the
    panorama when it was made and the width of a full turn. A file of that shape shows the whole
    panorama. A file with all its rows or all its columns was cropped to its own size. Any other
    file shows at least its pixels at the panorama's scale, and at most the largest part of its
    shape.
    """
    if _NAMES_PANORAMA.search(xmp.broken):
        reason = "XMP speaks of a panorama, and is damaged: its projection is not known"
        return Projection.PERSPECTIVE, Lens(reason=reason)
    tags = xmp.of(GPANO)
    width, turn, height = (
        positive(tags.get(name))
        for name in (
            "CroppedAreaImageWidthPixels", "FullPanoWidthPixels", "CroppedAreaImageHeightPixels",
        )
    )  # fmt: skip
    if width is None and turn is None and "ProjectionType" not in tags:
        return None
    noted = tags.get("ProjectionType", Projection.EQUIRECTANGULAR).lower()
    if noted in _OF_A_LENS:
        return None
    if noted not in {one for one in Projection if one.is_panorama}:
        reason = f"XMP says that the photo's projection is {noted}, which is not known here"
        return Projection.PERSPECTIVE, Lens(reason=reason)
    if width is None or turn is None or not width <= turn <= _WIDEST_PX:
        reason = "XMP says that the photo is a panorama, but not how wide"
        return Projection(noted), Lens(reason=reason)
    return Projection(noted), _panorama_lens(size_px, width, height, MAX_PANORAMA_DEG / turn)


def _panorama_lens(
    size_px: tuple[int, int], width: float, height: float | None, deg_per_px: float
) -> Lens:
    """Return the field of view of a file's part of a panorama of the given width and height."""
    kept_px = width if height is None else _cropped_width(size_px, (width, height))
    fov_deg = kept_px * deg_per_px
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"XMP's panorama left aside: {fov_deg:.2g} degrees fit no photo")
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
        min(_CROP_MOST * fov_deg, MAX_PANORAMA_DEG),
        f"XMP notes a panorama of {fov_deg:.1f} degrees, but the photo was cropped since",
    )


def _focal_lengths(
    tags: Tags,
    size_px: tuple[int, int],
    noted: tuple[float, float] | None,
    frame: tuple[float, float],
    sensor: Sensor | None,
) -> tuple[list[_FocalLength], list[str]]:
    """Return the focal lengths that EXIF gives, and the reasons against those left aside."""
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    focal_mm = positive(tags.get(Base.FocalLength))
    film = known = None
    against = []
    if equivalent_mm is not None:
        film = _FocalLength("35 mm equivalent", equivalent_mm / _FULL_FRAME_MM)
        if not _is_lens(film.diagonals, focal_mm):
            against.append(f"EXIF's 35 mm equivalent of {equivalent_mm:g} mm fits no lens")
            film = None
    if focal_mm is not None and sensor is not None:
        zoom = max(1.0, positive(tags.get(Base.DigitalZoomRatio)) or 1.0)
        source = f"focal length on the sensor of {sensor.camera}"
        known = _FocalLength(source, focal_mm * zoom / sensor.cropped_mm(frame))
    found = [one for one in (film, known) if one is not None]
    across = _pixels_per_mm(tags)
    if focal_mm is None or noted is None or across is None:
        return found, against
    plane = _FocalLength("focal plane", focal_mm * across / hypot(*noted), _PLANE_ALONE)
    wide = f"EXIF's focal plane would be {max(noted) / across:.1f} mm wide"
    is_of_file = sorted(noted) == sorted(size_px)
    is_like_film = film is not None and film.log_ratio(plane) <= _AGREE
    if not _is_lens(plane.diagonals, focal_mm):
        against.append("EXIF's focal plane fits no camera")
    elif known is not None and known.log_ratio(plane) > _AGREE and not is_like_film:
        against.append(f"{wide}, which that sensor is not")
    elif known is None and is_of_file and _is_reduced(plane, film, noted):
        against.append(f"{wide}: the photo was reduced, and its size noted anew")
    else:
        found.append(plane)
    return found, against


def _is_reduced(plane: _FocalLength, film: _FocalLength | None, noted: tuple[float, float]) -> bool:
    """Return whether a focal plane seems to be that of a reduced picture with its size in it."""
    if film is None:
        return noted[0] * noted[1] < _LEAST_PIXELS
    return log(plane.diagonals / film.diagonals) > _AGREE


def _combined(focals: list[_FocalLength]) -> _FocalLength:
    """Return the middle of the two focal lengths that agree best; of all if none agree."""
    if len(focals) == 1:
        return replace(focals[0], source=f"EXIF's {focals[0].source} alone")
    one, two = min(combinations(focals, 2), key=lambda pair: pair[0].log_ratio(pair[1]))
    middle, off = sqrt(one.diagonals * two.diagonals), one.log_ratio(two)
    both = f"EXIF's {one.source} and its {two.source}"
    if off <= _AGREE:
        return _FocalLength(f"{both} agree", middle, None)
    return _FocalLength(f"{both} contradict one another", middle, max(off / 2.0, ALONE_SD))


def _is_lens(diagonals: float, focal_mm: float | None) -> bool:
    """Return whether a focal length, in diagonals of its frame, is possible for lens and sensor."""
    if 2.0 * degrees(atan(0.5 / diagonals)) > _MAX_FOV_DEG:
        return False
    return focal_mm is None or _SENSOR_MM[0] <= focal_mm / diagonals <= _SENSOR_MM[1]


def _pixels_per_mm(tags: Tags) -> float | None:
    """Return the resolution of the focal plane; None if EXIF does not note it."""
    unit_mm = _MM_PER_UNIT.get(int(positive(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    across = positive(tags.get(Base.FocalPlaneXResolution))
    return None if unit_mm is None or across is None else across / unit_mm


def _frames(
    tags: Tags, size_px: tuple[int, int], sensor: Sensor | None
) -> tuple[tuple[float, float] | None, tuple[float, float]]:
    """Return the frame whose size the camera noted, if it did, and the frame that was taken.

    For a photo taken upright, some cameras note the frame upright and some lying. Of the two the
    better fit to the file is taken; if neither fits, the frame of which the file shows the wider
    part. A file of a shape that no camera takes is a part of the sensor's shape.
    """
    width = positive(tags.get(Base.ExifImageWidth))
    height = positive(tags.get(Base.ExifImageHeight))
    own = float(size_px[0]), float(size_px[1])
    noted = None
    if width is not None and height is not None:

        def fit(frame: tuple[float, float]) -> tuple[bool, bool, float]:
            kept = _cropped_width(size_px, frame)
            return _is_whole(size_px, frame), _is_unscaled(size_px, frame), kept

        noted = max(((width, height), (height, width)), key=fit)
    taken = noted or own
    possible = [*_SHAPES, *_SCREENS]
    if sensor is not None:
        possible = [*_SHAPES] if noted else [sensor.shape]
    shape = max(taken) / min(taken)
    if any(abs(shape / one - 1.0) <= _ASPECT_TOLERANCE for one in possible):
        return noted, taken
    whole = _USUAL_SHAPE if sensor is None else sensor.shape
    return None, (whole, 1.0) if size_px[0] >= size_px[1] else (1.0, whole)


def _cropped_width(size_px: tuple[int, int], frame: tuple[float, float]) -> float:
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

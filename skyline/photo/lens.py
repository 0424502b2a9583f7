"""The field of view that a photo's EXIF and XMP note, from the values in them that agree.

EXIF notes a lens in up to three ways: the 35 mm equivalent (CIPA DCG-001 compares diagonals), the
focal length with the resolution of the focal plane, and the focal length with the camera's model,
whose sensor is in lensfun's database (https://lensfun.github.io). Each is wrong in whole series of
cameras or in edited files, so one alone is a hint, and only two that agree are a measurement.

A digital zoom enlarges the middle of the frame. Apple's phones count it into the equivalent
(Hugin's bug 2064625). Other phones (the same bug) and Olympus (Focus-Points' issue 253) do not. So
a value has two readings, and where no other source says which one is right, both are possible.

A crop mode reads the middle of the sensor. Nikon counts it into the equivalent (Focus-Points' issue
252), Canon into the focal plane alone. So a photo shows the whole sensor of its camera at most.

All describe the frame whose size the camera noted; a panorama notes its own frame in XMP. A file of
the frame's shape was at most resized, which changes nothing. A file of another shape was cropped,
and shows at most the frame. A file of a shape that no camera takes was cropped too, even if the
noted size agrees with it: programs that crop note the new size.
"""

import re
from collections import defaultdict
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from functools import cache
from importlib import import_module
from itertools import combinations, product
from math import atan, degrees, exp, hypot, log, radians, sin, sqrt

from PIL.ExifTags import Base

from skyline.camera import MAX_PANORAMA_DEG, MIN_FOV_DEG, Projection
from skyline.photo.exif import Tags, positive, text_of
from skyline.photo.skyline import Lens
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
_MOST_ZOOM = 100.0
"""The greatest digital zoom of phones."""
_EXPOSURE = timedelta(minutes=1)
"""A camera may note the end of an exposure as the time of change."""
_NARROWEST = 1.8
"""A search reaches down to half the likeliest field of view: so it is at most so many times the
narrowest reading."""
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

    The deviation is None if two sources agree. If the focal length covers readings that differ,
    ``readings`` has the shortest and the longest.
    """

    source: str
    diagonals: float
    sd: float | None = ALONE_SD
    readings: tuple[float, ...] = ()

    def log_ratio(self, other: "_FocalLength") -> float:
        """Return the difference of the logarithms of two focal lengths."""
        return abs(self.longer_by(other))

    def longer_by(self, other: "_FocalLength") -> float:
        """Return how much the logarithm of this focal length is above another one's."""
        return log(self.diagonals / other.diagonals)


_Source = tuple[_FocalLength, ...]
"""The readings of a source: two where a digital zoom may be counted in it or not."""


def _fov_deg(width: float, diagonals: float) -> float:
    """Return the field of view of a width of the frame; width and focal length in diagonals."""
    return 2.0 * degrees(atan(width / 2.0 / diagonals))


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
    known = _on_sensor(tags, frame, sensor)
    sources, against = _focal_lengths(tags, size_px, noted, known)
    if not sources and known is None:
        return Lens(reason="; ".join(against))
    focal = _combined(sources, known)
    if max(size_px) / min(size_px) > MAX_PINHOLE_ASPECT:
        return Lens(reason=f"{focal.source} left aside: the photo is a panorama or a strip")
    width = _cropped_width(size_px, frame) / hypot(*frame)
    fov_deg, source = _fov_deg(width, focal.diagonals), focal.source
    if focal.readings:
        wide_deg, narrow_deg = (_fov_deg(width, one) for one in focal.readings)
        fov_deg = min(fov_deg, _NARROWEST * narrow_deg)
        source += f": {wide_deg:.1f} or {narrow_deg:.1f} degrees"
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"{source} left aside: {fov_deg:.2g} degrees fit no photo")
    sd_deg = None if focal.sd is None else degrees(focal.sd * sin(radians(fov_deg)))
    widest_deg = _fov_deg(width, focal.diagonals * exp(-2.0 * (focal.sd or 0.0)))
    if _is_whole(size_px, frame) or _is_unscaled(size_px, frame):
        most_deg = widest_deg if focal.readings else None
        return Lens(fov_deg, sd_deg, most_deg, "; ".join([source, *against]))
    reason = f"{source}, but the photo was cropped from {fov_deg:.1f} degrees"
    return Lens(
        _CROP_MEAN * fov_deg,
        hypot(_CROP_SD * fov_deg, sd_deg or 0.0),
        _CROP_MOST * widest_deg,
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


def _on_sensor(
    tags: Tags, frame: tuple[float, float], sensor: Sensor | None
) -> _FocalLength | None:
    """Return the focal length on a camera's whole sensor, if both are known."""
    focal_mm = positive(tags.get(Base.FocalLength))
    if focal_mm is None or sensor is None:
        return None
    source = f"focal length on the sensor of {sensor.camera}"
    return _FocalLength(source, focal_mm * _digital_zoom(tags) / sensor.cropped_mm(frame))


def _digital_zoom(tags: Tags) -> float:
    """Return how many times a digital zoom has enlarged the frame; 1 for none or an impossible one.

    EXIF's 0 stands for none.
    """
    zoom = positive(tags.get(Base.DigitalZoomRatio)) or 1.0
    return zoom if 1.0 < zoom <= _MOST_ZOOM else 1.0


def _focal_lengths(
    tags: Tags,
    size_px: tuple[int, int],
    noted: tuple[float, float] | None,
    known: _FocalLength | None,
) -> tuple[list[_Source], list[str]]:
    """Return the focal lengths that EXIF notes, and the reasons against those left aside.

    ``noted`` is the frame whose size the camera noted, ``known`` the focal length on the sensor.
    """
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    focal_mm, zoom = positive(tags.get(Base.FocalLength)), _digital_zoom(tags)
    film: _Source = ()
    against = []
    if equivalent_mm is not None:
        diagonals = equivalent_mm / _FULL_FRAME_MM
        film = _readings(_FocalLength("35 mm equivalent", diagonals), zoom, focal_mm)
        if not film:
            against.append(f"EXIF's 35 mm equivalent of {equivalent_mm:g} mm fits no lens")
    across = _pixels_per_mm(tags)
    if focal_mm is None or noted is None or across is None:
        return [film] if film else [], against
    noted_plane = _FocalLength("focal plane", focal_mm * across / hypot(*noted), _PLANE_ALONE)
    plane = _readings(noted_plane, zoom, focal_mm)
    wide = f"EXIF's focal plane would be {max(noted) / across:.1f} mm wide"
    is_of_file = sorted(noted) == sorted(size_px)
    if not plane:
        against.append("EXIF's focal plane fits no camera")
    elif known is not None and not (
        _agree(plane, (known,)) or _agree(plane, film) or _is_crop(plane, film, known, noted, tags)
    ):
        against.append(f"{wide}, which that sensor is not")
    elif known is None and is_of_file and _is_reduced(plane, film, noted):
        against.append(f"{wide}: the photo was reduced, and its size noted anew")
    else:
        return [source for source in (film, plane) if source], against
    return [film] if film else [], against


def _readings(noted: _FocalLength, zoom: float, focal_mm: float | None) -> _Source:
    """Return what a value may mean beside a digital zoom, which is counted in it or not.

    A reading counts if there could be such a lens, without the zoom.
    """
    lenses = dict.fromkeys((noted.diagonals / zoom, noted.diagonals))
    possible = [diagonals for diagonals in lenses if _is_lens(diagonals, focal_mm)]
    source = noted.source
    if len(possible) > 1:
        source += f", with or without the digital zoom of {zoom:g},"
    return tuple(replace(noted, source=source, diagonals=one * zoom) for one in possible)


def _agree(one: _Source, other: _Source) -> bool:
    """Return whether a reading of one source agrees with a reading of another."""
    return any(a.log_ratio(b) <= _AGREE for a, b in product(one, other))


def _is_crop(
    plane: _Source,
    film: _Source,
    known: _FocalLength,
    noted: tuple[float, float],
    tags: Tags,
) -> bool:
    """Return whether a focal plane may be the part of a sensor that a crop mode reads.

    A program that reduces a photo and notes its new size leaves a small focal plane, too, but few
    pixels, or a later time of change.
    """
    if _agree(film, (known,)) or noted[0] * noted[1] < _LEAST_PIXELS or _was_edited(tags):
        return False
    return min(one.longer_by(known) for one in plane) > _AGREE


def _was_edited(tags: Tags) -> bool:
    """Return whether a file says that it was changed after its photo was taken."""
    taken, changed = (_time_of(tags, tag) for tag in (Base.DateTimeOriginal, Base.DateTime))
    return taken is not None and changed is not None and abs(changed - taken) > _EXPOSURE


def _time_of(tags: Tags, tag: int) -> datetime | None:
    try:
        return datetime.strptime(text_of(tags, tag), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None


def _is_reduced(plane: _Source, film: _Source, noted: tuple[float, float]) -> bool:
    """Return whether a focal plane seems to be that of a reduced picture with its size in it."""
    if not film:
        return noted[0] * noted[1] < _LEAST_PIXELS
    return min(one.longer_by(other) for one, other in product(plane, film)) > _AGREE


def _combined(sources: Sequence[_Source], known: _FocalLength | None) -> _FocalLength:
    """Return the focal length on which most sources agree, or else one that covers them all."""
    every = [*sources, *([(known,)] if known else [])]
    pairs = [pair for two in combinations(every, 2) for pair in product(*two)]
    agreeing = [pair for pair in pairs if _agree(pair[:1], pair[1:])]
    if not agreeing:
        return _without_agreement(sources, known)

    def backing(pair: tuple[_FocalLength, _FocalLength]) -> int:
        return sum(_agree(pair[:1], source) and _agree(pair[1:], source) for source in every)

    most = max(map(backing, agreeing))
    best = sorted(
        (pair for pair in agreeing if backing(pair) == most),
        key=lambda pair: pair[0].log_ratio(pair[1]),
    )
    source = f"EXIF's {best[0][0].source} and its {best[0][1].source} agree"
    middles = [sqrt(one.diagonals * two.diagonals) for one, two in best]
    if log(max(middles) / min(middles)) > _AGREE:
        return _covering(source, middles)
    return _FocalLength(source, middles[0], None)


def _without_agreement(sources: Sequence[_Source], known: _FocalLength | None) -> _FocalLength:
    """Return a focal length that covers all sources, no two of which agree.

    A photo shows no more than its camera's whole sensor, and may show less.
    """
    if not sources and known is not None:
        return replace(known, source=f"EXIF's {known.source} alone")
    readings = [one for source in sources for one in source]
    names = " and its ".join(source[0].source for source in sources)
    is_part = known is not None and min(one.longer_by(known) for one in readings) > _AGREE
    if known is not None and not is_part:
        names += f" and its {known.source}"
        readings.append(known)
    is_alone = len(sources) == 1 and (known is None or is_part)
    found = _covering(
        f"EXIF's {names} {'alone' if is_alone else 'contradict one another'}",
        [one.diagonals for one in readings],
        (readings[0].sd if is_alone else None) or ALONE_SD,
    )
    if known is None or not is_part:
        return found
    sd = max(found.sd or 0.0, 0.5 * found.longer_by(known))
    return replace(found, source=f"{found.source}, a part of what its {known.source} shows", sd=sd)


def _covering(source: str, diagonals: Sequence[float], least_sd: float = ALONE_SD) -> _FocalLength:
    """Return the middle of focal lengths, with all of them within about a deviation."""
    short, long = min(diagonals), max(diagonals)
    sd = max(0.5 * log(long / short), least_sd)
    return _FocalLength(source, sqrt(short * long), sd, (short, long) if short < long else ())


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

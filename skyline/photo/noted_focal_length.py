"""The focal length that a photo's EXIF notes, from values that agree.

EXIF notes a lens in up to three ways: the 35 mm equivalent (CIPA DCG-001 compares diagonals), the
focal length with the resolution of the focal plane, and the focal length with the camera's model,
whose sensor is in lensfun's database (https://lensfun.github.io). Each is wrong in whole series of
cameras or in edited files, so one alone is a hint, and only two that agree are a measurement.

A digital zoom enlarges the middle of the frame. Apple's phones include it in the equivalent
(Hugin's bug 2064625). Other phones (the same bug) and Olympus (Focus-Points' issue 253) do not. So
a value has two readings, and where no other source says which one is right, both are possible.

A square photo or one of 16:9 is cut from a sensor of 4:3 or 3:2, and its equivalent has two
readings as well. Some phones compare the sensor's diagonal: a Galaxy S10's photo of 16:9 fits its
known place at 36.9 degrees, and 52 mm are 36.8 degrees by the sensor's diagonal, 39.9 by the
photo's. Others compare the photo's: Apple computes the equivalent from the photo's pixels
(developer.apple.com/forums, thread 745938).

A crop mode reads the middle of the sensor. Nikon includes it in the equivalent (Focus-Points' issue
252), Canon only in the focal plane. So a photo shows at most the whole sensor of its camera.

All three describe the frame whose size the camera noted (`skyline.photo.frame`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import combinations, product
from math import hypot, log, sqrt

from PIL.ExifTags import Base

from skyline.camera.projection import Projection
from skyline.photo.frame import Size, frame_diagonal
from skyline.photo.sensors import FULL_FRAME_MM, Sensor
from skyline.photo.tags import Tags, noted_time, positive

NOMINAL_SD = 0.025
"""Standard deviation of the logarithm of a focal length that a maker states.

The nominal value is rounded and holds at infinity, and a correction of distortion enlarges the
photo by 2 or 3 %."""
_ROUNDED_MM = 1.0 / sqrt(12.0)
"""Standard deviation of a 35 mm equivalent, which is rounded to a whole millimetre."""
COVERED_SD = 0.1
"""Least standard deviation of the logarithm of a focal length that covers several different
ones."""
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""FocalPlaneResolutionUnit: inch (also if absent), centimetre, millimetre, micrometre."""


@dataclass(frozen=True, slots=True)
class _Limits:
    """Which focal lengths are possible, and which agree."""

    widest_deg: float = 135.0
    """Widest diagonal field of view of lenses that draw straight lines straight."""
    sensor_mm: tuple[float, float] = (2.0, 80.0)
    """Diagonals of sensors, from phones to medium format."""
    agree_log: float = log(1.1)
    """Largest difference of the logarithms of two focal lengths that agree: one of them is
    rounded."""
    plane_sd: float = 0.5 * log(1.5)
    """Standard deviation of the logarithm of a focal length from the focal plane: wrong values are
    off by the step between two sensor formats, 1.5 (Exiv2's issue 3097)."""
    most_zoom: float = 100.0
    """The greatest digital zoom of phones."""
    exposure: timedelta = timedelta(minutes=1)
    """Longest exposure: a camera may note its end as the time of change."""
    least_pixels: float = 3e6
    """A focal plane with fewer pixels does not count by itself: most such photos were reduced by
    programs that note the new size and keep the plane's resolution."""


_LIMITS = _Limits()


@dataclass(frozen=True, slots=True)
class FocalLength:
    """A focal length, and how well it is known."""

    source: str
    """Where it is noted, in words."""
    diagonals: float
    """The focal length divided by the diagonal of the frame."""
    sd: float | None = NOMINAL_SD
    """Standard deviation of its logarithm; None if two sources agree."""
    readings: tuple[float, ...] = ()
    """The shortest and the longest reading, in diagonals, if there are several that differ."""

    def log_ratio(self, other: "FocalLength") -> float:
        """Return the difference of the logarithms of two focal lengths."""
        return abs(self.longer_by(other))

    def longer_by(self, other: "FocalLength") -> float:
        """Return the logarithm of this focal length divided by another."""
        return log(self.diagonals / other.diagonals)


_Source = tuple[FocalLength, ...]
"""The readings of a source: more than one if it may or may not include a digital zoom, or if it may
compare the photo's diagonal or the sensor's."""


def part_fov_deg(width: float, diagonals: float) -> float:
    """Return the field of view of a part of the frame.

    The width of the part and the focal length are in diagonals of the frame.
    """
    return float(Projection.PERSPECTIVE.fov_deg(width / 2.0 / diagonals))


def noted_focal_length(
    tags: Tags, size_px: tuple[int, int], noted: Size | None, frame: Size, sensor: Sensor | None
) -> tuple[FocalLength | None, list[str]]:
    """Return the focal length that EXIF notes, and reasons against values left aside.

    The focal length is None if no value is left. ``size_px`` is the file's width and height.
    ``noted`` is the frame whose size the camera noted, ``frame`` the frame taken, as
    `skyline.photo.frame.frames_of` returns them.
    """
    known = _on_sensor(tags, frame, sensor)
    film, against_film = _film(tags, frame_diagonal(frame, sensor))
    plane, against_plane = _plane(tags, size_px, noted, known, film)
    sources = [source for source in (film, plane) if source]
    against = [reason for reason in (against_film, against_plane) if reason]
    if not sources and known is None:
        return None, against
    return _combined(sources, known), against


def _film(tags: Tags, of_sensor: float) -> tuple[_Source, str]:
    """Return the readings of the 35 mm equivalent, or a reason against it.

    ``of_sensor`` is the frame's diagonal over the sensor's.
    """
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None:
        return (), ""
    sd = hypot(NOMINAL_SD, _ROUNDED_MM / equivalent_mm)
    noted = FocalLength("35 mm equivalent", equivalent_mm / FULL_FRAME_MM, sd)
    film = tuple(
        reading for one in _of_frame_or_sensor(noted, of_sensor) for reading in _readings(one, tags)
    )
    against = "" if film else f"EXIF's 35 mm equivalent of {equivalent_mm:g} mm fits no lens"
    return film, against


def _plane(
    tags: Tags,
    size_px: tuple[int, int],
    noted: Size | None,
    known: FocalLength | None,
    film: _Source,
) -> tuple[_Source, str]:
    """Return the readings by the focal plane, or a reason against it.

    ``known`` is the focal length on the sensor, ``film`` the readings of the 35 mm equivalent.
    """
    focal_mm = positive(tags.get(Base.FocalLength))
    across = _pixels_per_mm(tags)
    if focal_mm is None or noted is None or across is None:
        return (), ""
    diagonals = focal_mm * across / hypot(*noted)
    plane = _readings(FocalLength("focal plane", diagonals, _LIMITS.plane_sd), tags)
    if not plane:
        return (), "EXIF's focal plane fits no camera"
    wide = f"EXIF's focal plane is left aside: it would be {max(noted) / across:.1f} mm wide"
    if known is not None:
        is_backed = _agree(plane, (known,)) or _agree(plane, film)
        if not is_backed and not _is_crop(plane, film, known, noted, tags):
            return (), f"{wide}, and that sensor is not"
    elif sorted(noted) == sorted(size_px) and _is_reduced(plane, film, noted):
        return (), f"{wide}, as in a photo that a program has reduced"
    return plane, ""


def _on_sensor(tags: Tags, frame: Size, sensor: Sensor | None) -> FocalLength | None:
    """Return the focal length on a camera's sensor, if both are known."""
    focal_mm = positive(tags.get(Base.FocalLength))
    if focal_mm is None or sensor is None:
        return None
    source = f"focal length on the sensor of {sensor.camera}"
    return FocalLength(source, focal_mm * _digital_zoom(tags) / sensor.cropped_mm(frame))


def _digital_zoom(tags: Tags) -> float:
    """Return how many times a digital zoom enlarged the frame.

    It is 1 without a zoom. EXIF's 0 also stands for none, and impossible values count as none.
    """
    zoom = positive(tags.get(Base.DigitalZoomRatio)) or 1.0
    return zoom if 1.0 < zoom <= _LIMITS.most_zoom else 1.0


def _of_frame_or_sensor(noted: FocalLength, of_sensor: float) -> _Source:
    """Return the readings of an equivalent whose diagonal is not known.

    It is the frame's or the sensor's; the two differ where the frame is cut from the sensor.
    """
    if of_sensor == 1.0:
        return (noted,)
    source = f"{noted.source} (by the photo's diagonal or the sensor's)"
    return tuple(
        replace(noted, source=source, diagonals=noted.diagonals / share)
        for share in (1.0, of_sensor)
    )


def _readings(noted: FocalLength, tags: Tags) -> _Source:
    """Return what a value may mean if there is a digital zoom.

    It may include the zoom or not. A reading counts if a lens could have its focal length without
    the zoom.
    """
    zoom = _digital_zoom(tags)
    focal_mm = positive(tags.get(Base.FocalLength))
    lenses = dict.fromkeys((noted.diagonals / zoom, noted.diagonals))
    possible = [diagonals for diagonals in lenses if _is_lens(diagonals, focal_mm)]
    source = noted.source
    if len(possible) > 1:
        source += f", with or without the digital zoom of {zoom:g},"
    return tuple(replace(noted, source=source, diagonals=one * zoom) for one in possible)


def _agree(one: _Source, other: _Source) -> bool:
    """Return whether some readings of two sources agree."""
    return any(a.log_ratio(b) <= _LIMITS.agree_log for a, b in product(one, other))


def _is_crop(
    plane: _Source,
    film: _Source,
    known: FocalLength,
    noted: Size,
    tags: Tags,
) -> bool:
    """Return whether a focal plane may come from a crop mode.

    A crop mode reads the middle of the sensor. A program that reduces a photo and notes its new
    size leaves a small focal plane, too, but few pixels, or a later time of change.
    """
    if _agree(film, (known,)) or has_few_pixels(noted) or was_edited(tags):
        return False
    return min(one.longer_by(known) for one in plane) > _LIMITS.agree_log


def was_edited(tags: Tags) -> bool:
    """Return whether a file was changed after its photo was taken."""
    taken, changed = (noted_time(tags, tag) for tag in (Base.DateTimeOriginal, Base.DateTime))
    return taken is not None and changed is not None and abs(changed - taken) > _LIMITS.exposure


def _is_reduced(plane: _Source, film: _Source, noted: Size) -> bool:
    """Return whether a program seems to have reduced a photo.

    The focal plane of such a photo is too small.
    """
    if not film:
        return has_few_pixels(noted)
    return min(one.longer_by(other) for one, other in product(plane, film)) > _LIMITS.agree_log


def _combined(sources: Sequence[_Source], known: FocalLength | None) -> FocalLength:
    """Return the focal length on which most sources agree.

    Where none agree, it covers them all.
    """
    every = [*sources, *([(known,)] if known else [])]
    pairs = [pair for two in combinations(every, 2) for pair in product(*two)]
    agreeing = [pair for pair in pairs if _agree(pair[:1], pair[1:])]
    if not agreeing:
        return _without_agreement(sources, known)

    def backing(pair: tuple[FocalLength, FocalLength]) -> int:
        return sum(_agree(pair[:1], source) and _agree(pair[1:], source) for source in every)

    most = max(map(backing, agreeing))
    best = sorted(
        (pair for pair in agreeing if backing(pair) == most),
        key=lambda pair: pair[0].log_ratio(pair[1]),
    )
    source = f"EXIF's {best[0][0].source} and its {best[0][1].source} agree"
    middles = [sqrt(one.diagonals * two.diagonals) for one, two in best]
    if log(max(middles) / min(middles)) > _LIMITS.agree_log:
        return _covering(source, middles, COVERED_SD)
    return FocalLength(source, middles[0], None)


def _without_agreement(sources: Sequence[_Source], known: FocalLength | None) -> FocalLength:
    """Return a focal length that covers sources that do not agree.

    A photo shows no more than its camera's whole sensor, and may show less.
    """
    if not sources and known is not None:
        return replace(known, source=f"only EXIF's {known.source} gives it")
    readings = [one for source in sources for one in source]
    names = " and its ".join(source[0].source for source in sources)
    is_part = (
        known is not None and min(one.longer_by(known) for one in readings) > _LIMITS.agree_log
    )
    if known is not None and not is_part:
        names += f" and its {known.source}"
        readings.append(known)
    is_alone = len(sources) == 1 and (known is None or is_part)
    found = _covering(
        f"only EXIF's {names} gives it" if is_alone else f"EXIF's {names} contradict each other",
        [one.diagonals for one in readings],
        (readings[0].sd if is_alone else None) or COVERED_SD,
    )
    if known is None or not is_part:
        return found
    sd = max(found.sd or 0.0, 0.5 * found.longer_by(known))
    return replace(found, source=f"{found.source}, and its {known.source} shows more", sd=sd)


def _covering(source: str, diagonals: Sequence[float], least_sd: float) -> FocalLength:
    """Return the middle of focal lengths; its standard deviation covers them."""
    short = min(diagonals)
    long = max(diagonals)
    sd = max(0.5 * log(long / short), least_sd)
    return FocalLength(source, sqrt(short * long), sd, (short, long) if short < long else ())


def has_few_pixels(noted: Size) -> bool:
    """Return whether a noted frame has fewer pixels than cameras have."""
    return noted[0] * noted[1] < _LIMITS.least_pixels


def _is_lens(diagonals: float, focal_mm: float | None) -> bool:
    """Return whether a lens can have a focal length (frame diagonals)."""
    if part_fov_deg(1.0, diagonals) > _LIMITS.widest_deg:
        return False
    return focal_mm is None or _LIMITS.sensor_mm[0] <= focal_mm / diagonals <= _LIMITS.sensor_mm[1]


def _pixels_per_mm(tags: Tags) -> float | None:
    """Return the focal plane's pixels per mm; None if not noted."""
    unit_mm = _MM_PER_UNIT.get(int(positive(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    across = positive(tags.get(Base.FocalPlaneXResolution))
    return None if unit_mm is None or across is None else across / unit_mm

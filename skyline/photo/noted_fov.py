"""The field of view that a photo notes, from values that agree.

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

All three describe the frame whose size the camera noted (`skyline.photo.frame`); a panorama notes
its own frame in XMP (`skyline.photo.noted_panorama`).
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import timedelta
from itertools import combinations, product
from math import degrees, exp, hypot, log, radians, sin, sqrt

from PIL.ExifTags import Base

from skyline.camera.projection import MIN_FOV_DEG, Projection
from skyline.photo.frame import (
    CROP,
    Size,
    cropped_width,
    frame_diagonal,
    frames_of,
    is_bordered,
    is_unscaled,
    is_whole,
)
from skyline.photo.noted_panorama import panorama_of_xmp, swept_lens_of
from skyline.photo.sensors import FULL_FRAME_MM, Sensor, sensor_of
from skyline.photo.skyline import Lens
from skyline.photo.tags import Tags, noted_time, positive, text_of
from skyline.photo.xmp import Xmp

MAX_PINHOLE_ASPECT = 2.5
"""Wider photos are stitched or swept panoramas, or strips, whose width no lens determines."""
NOMINAL_SD = 0.025
"""Standard deviation of the logarithm of a focal length that a maker states.

The nominal value is rounded and holds at infinity, and a correction of distortion enlarges the
photo by 2 or 3 %."""
_ROUNDED_MM = 1.0 / sqrt(12.0)
"""Standard deviation of a 35 mm equivalent, which is rounded to a whole millimetre."""
_COVERED_SD = 0.1
"""Least standard deviation of the logarithm of a focal length that covers several different
ones."""
_CAMERA_RAW = "http://ns.adobe.com/camera-raw-settings/1.0"
"""Namespace of the settings of Lightroom and Camera Raw."""
_FISHEYE = re.compile("FISH-?EYE")
"""A part of the names of lenses that are fisheyes, in capitals."""
_MM_PER_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
"""FocalPlaneResolutionUnit: inch (also if absent), centimetre, millimetre, micrometre."""


@dataclass(frozen=True, slots=True)
class _Focal:
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
    narrowest: float = 1.8
    """Largest ratio of the likeliest field of view to the narrowest reading: a search reaches down
    to half the likeliest."""
    least_pixels: float = 3e6
    """A focal plane with fewer pixels does not count by itself: most such photos were reduced by
    programs that note the new size and keep the plane's resolution."""


@dataclass(frozen=True, slots=True)
class CropShares:
    """Shares of photos that show less than their files note.

    The photos have frames of the camera's shape.

    Stabilization, digital zooms, crop modes, and programs that crop and note the new size narrow
    what is shown, and nothing widens it. Of 22 photographs with one source, most of them resized,
    4 were narrower by more than 3 %: hence `resized`. The other shares are guesses around it.
    """

    as_written: float = 0.05
    """For files of the noted size, unedited and with as many pixels as cameras have."""
    resized: float = 0.2
    """For files that a program has written again."""
    edited: float = 0.3
    """For files that name an editor as their program, or that were changed later."""
    agreeing: float = 0.25
    """Factor if two sources agree: a camera's crop would be in only one of them."""


_FOCAL = _Focal()
CROP_SHARES = CropShares()
_EDITORS = (
    "PHOTOSHOP", "LIGHTROOM", "GIMP", "SNAPSEED", "PICASA", "DARKTABLE", "RAWTHERAPEE", "LUMINAR",
    "CAPTURE ONE", "AFFINITY", "PAINT", "PIXELMATOR", "DXO", "PHOTOLAB", "ACDSEE", "GPHOTO",
    "XNVIEW", "IRFANVIEW", "DIGIKAM", "APERTURE", "PHOTOS 1", "ON1", "CANVA", "POLARR",
)  # fmt: skip
"""Names in EXIF's Software of programs with which people crop, in capitals."""


@dataclass(frozen=True, slots=True)
class _FocalLength:
    """A focal length, and how well it is known."""

    source: str
    """Where it is noted, in words."""
    diagonals: float
    """The focal length divided by the diagonal of the frame."""
    sd: float | None = NOMINAL_SD
    """Standard deviation of its logarithm; None if two sources agree."""
    readings: tuple[float, ...] = ()
    """The shortest and the longest reading, in diagonals, if there are several that differ."""

    def log_ratio(self, other: "_FocalLength") -> float:
        """Return the difference of the logarithms of two focal lengths."""
        return abs(self.longer_by(other))

    def longer_by(self, other: "_FocalLength") -> float:
        """Return the logarithm of this focal length divided by another."""
        return log(self.diagonals / other.diagonals)


_Source = tuple[_FocalLength, ...]
"""The readings of a source: more than one if it may or may not include a digital zoom, or if it may
compare the photo's diagonal or the sensor's."""


def _fov_deg(width: float, diagonals: float) -> float:
    """Return the field of view of a part of the frame.

    Its width and the focal length are in diagonals of the frame.
    """
    return float(Projection.PERSPECTIVE.fov_deg(width / 2.0 / diagonals))


def _was_cropped(xmp: Xmp) -> bool:
    """Return whether XMP notes a crop that the pixels show.

    Lightroom and Camera Raw note it. A crop that is only noted, in a file that was not exported, is
    not applied.
    """
    noted = xmp.of(_CAMERA_RAW)
    return all(noted.get(name, "").lower() == "true" for name in ("HasCrop", "AlreadyApplied"))


def camera_of(
    tags: Tags,
    xmp: Xmp,
    size_px: tuple[int, int],
    photo_px: tuple[int, int] | None = None,
) -> tuple[Projection, Lens]:
    """Return the projection and the lens that are noted for a file.

    ``tags`` and ``size_px`` are as in `lens_of`. ``photo_px`` is the size of the photo within any
    borders of the file.
    """
    panorama = panorama_of_xmp(xmp, size_px)
    if panorama is not None:
        return panorama
    swept = swept_lens_of(tags, size_px)
    if swept is not None:
        return Projection.CYLINDRICAL, swept
    if _FISHEYE.search(text_of(tags, Base.LensModel)):
        reason = "EXIF names a fisheye as its lens, but not how wide the photo is"
        return Projection.FISHEYE, Lens(reason=reason)
    if photo_px is None or not is_bordered(size_px, photo_px):
        return Projection.PERSPECTIVE, lens_of(tags, size_px, _was_cropped(xmp))
    # Where the noted size is the file's, it is not of the camera's frame.
    size = positive(tags.get(Base.ExifImageWidth)), positive(tags.get(Base.ExifImageHeight))
    if size in (size_px, size_px[::-1]):
        sizes = (Base.ExifImageWidth, Base.ExifImageHeight)
        tags = {tag: value for tag, value in tags.items() if tag not in sizes}
    lens = lens_of(tags, photo_px, _was_cropped(xmp))
    return Projection.PERSPECTIVE, lens.beside_border(size_px[0] / photo_px[0])


def lens_of(tags: Tags, size_px: tuple[int, int], is_cropped: bool = False) -> Lens:
    """Return the lens that a photo's EXIF notes.

    ``tags`` has the values of both the main and the Exif directory. ``size_px`` is the width and
    the height of the file's pixels, upright. ``is_cropped`` says that a program has cropped the
    photo, even if its shape does not.
    """
    sensor = sensor_of(text_of(tags, Base.Model))
    noted, frame = frames_of(tags, size_px, sensor)
    known = _on_sensor(tags, frame, sensor)
    of_sensor = frame_diagonal(frame, sensor)
    sources, against = _focal_lengths(tags, size_px, noted, known, of_sensor)
    if not sources and known is None:
        return Lens(reason="; ".join(against))
    focal = _combined(sources, known)
    if max(size_px) / min(size_px) > MAX_PINHOLE_ASPECT:
        return Lens(reason=f"{focal.source}, which holds for no panorama or strip")
    width = cropped_width(size_px, frame) / hypot(*frame)
    fov_deg = _fov_deg(width, focal.diagonals)
    source = focal.source
    if focal.readings:
        wide_deg, narrow_deg = (_fov_deg(width, one) for one in focal.readings)
        fov_deg = min(fov_deg, _FOCAL.narrowest * narrow_deg)
        source += f": {wide_deg:.1f} or {narrow_deg:.1f} degrees"
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"{source}: {fov_deg:.2g} degrees, which fit no photo")
    fov_sd_deg = None if focal.sd is None else degrees(focal.sd * sin(radians(fov_deg)))
    widest_deg = _fov_deg(width, focal.diagonals * exp(-2.0 * (focal.sd or 0.0)))
    if not is_cropped and (is_whole(size_px, frame) or is_unscaled(size_px, frame)):
        most_fov_deg = widest_deg if focal.readings else None
        reason = "; ".join([source, *against])
        crop_share = _crop_share(tags, size_px, noted, focal)
        return Lens(fov_deg, fov_sd_deg, most_fov_deg, reason, crop_share)
    reason = f"{source}, but the photo was cropped from {fov_deg:.1f} degrees"
    return Lens(
        CROP.mean * fov_deg,
        hypot(CROP.sd * fov_deg, fov_sd_deg or 0.0),
        CROP.most * widest_deg,
        "; ".join([reason, *against]),
    )


def _on_sensor(tags: Tags, frame: Size, sensor: Sensor | None) -> _FocalLength | None:
    """Return the focal length on a camera's sensor, if both are known."""
    focal_mm = positive(tags.get(Base.FocalLength))
    if focal_mm is None or sensor is None:
        return None
    source = f"focal length on the sensor of {sensor.camera}"
    return _FocalLength(source, focal_mm * _digital_zoom(tags) / sensor.cropped_mm(frame))


def _digital_zoom(tags: Tags) -> float:
    """Return how many times a digital zoom enlarged the frame.

    It is 1 without a zoom. EXIF's 0 also stands for none, and impossible values count as none.
    """
    zoom = positive(tags.get(Base.DigitalZoomRatio)) or 1.0
    return zoom if 1.0 < zoom <= _FOCAL.most_zoom else 1.0


def _focal_lengths(
    tags: Tags,
    size_px: tuple[int, int],
    noted: Size | None,
    known: _FocalLength | None,
    of_sensor: float,
) -> tuple[list[_Source], list[str]]:
    """Return the focal lengths in EXIF, and reasons against those left aside.

    ``noted`` is the frame whose size the camera noted, ``known`` the focal length on the sensor,
    ``of_sensor`` the frame's diagonal over the sensor's.
    """
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    focal_mm = positive(tags.get(Base.FocalLength))
    zoom = _digital_zoom(tags)
    film: _Source = ()
    against = []
    if equivalent_mm is not None:
        diagonals = equivalent_mm / FULL_FRAME_MM
        sd = hypot(NOMINAL_SD, _ROUNDED_MM / equivalent_mm)
        noted_film = _FocalLength("35 mm equivalent", diagonals, sd)
        film = tuple(
            reading
            for one in _of_frame_or_sensor(noted_film, of_sensor)
            for reading in _readings(one, zoom, focal_mm)
        )
        if not film:
            against.append(f"EXIF's 35 mm equivalent of {equivalent_mm:g} mm fits no lens")
    across = _pixels_per_mm(tags)
    if focal_mm is None or noted is None or across is None:
        return [film] if film else [], against
    noted_plane = _FocalLength("focal plane", focal_mm * across / hypot(*noted), _FOCAL.plane_sd)
    plane = _readings(noted_plane, zoom, focal_mm)
    wide = f"EXIF's focal plane is left aside: it would be {max(noted) / across:.1f} mm wide"
    is_of_file = sorted(noted) == sorted(size_px)
    if not plane:
        against.append("EXIF's focal plane fits no camera")
    elif known is not None and not (
        _agree(plane, (known,)) or _agree(plane, film) or _is_crop(plane, film, known, noted, tags)
    ):
        against.append(f"{wide}, and that sensor is not")
    elif known is None and is_of_file and _is_reduced(plane, film, noted):
        against.append(f"{wide}, as in a photo that a program has reduced")
    else:
        return [source for source in (film, plane) if source], against
    return [film] if film else [], against


def _of_frame_or_sensor(noted: _FocalLength, of_sensor: float) -> _Source:
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


def _readings(noted: _FocalLength, zoom: float, focal_mm: float | None) -> _Source:
    """Return what a value may mean if there is a digital zoom.

    It may include the zoom or not. A reading counts if a lens could have its focal length without
    the zoom.
    """
    lenses = dict.fromkeys((noted.diagonals / zoom, noted.diagonals))
    possible = [diagonals for diagonals in lenses if _is_lens(diagonals, focal_mm)]
    source = noted.source
    if len(possible) > 1:
        source += f", with or without the digital zoom of {zoom:g},"
    return tuple(replace(noted, source=source, diagonals=one * zoom) for one in possible)


def _agree(one: _Source, other: _Source) -> bool:
    """Return whether some readings of two sources agree."""
    return any(a.log_ratio(b) <= _FOCAL.agree_log for a, b in product(one, other))


def _is_crop(
    plane: _Source,
    film: _Source,
    known: _FocalLength,
    noted: Size,
    tags: Tags,
) -> bool:
    """Return whether a focal plane may come from a crop mode.

    A crop mode reads the middle of the sensor. A program that reduces a photo and notes its new
    size leaves a small focal plane, too, but few pixels, or a later time of change.
    """
    if _agree(film, (known,)) or _is_small(noted) or _was_edited(tags):
        return False
    return min(one.longer_by(known) for one in plane) > _FOCAL.agree_log


def _was_edited(tags: Tags) -> bool:
    """Return whether a file was changed after its photo was taken."""
    taken, changed = (noted_time(tags, tag) for tag in (Base.DateTimeOriginal, Base.DateTime))
    return taken is not None and changed is not None and abs(changed - taken) > _FOCAL.exposure


def _crop_share(
    tags: Tags, size_px: tuple[int, int], noted: Size | None, focal: _FocalLength
) -> float:
    """Return the probability that an apparently whole frame was cropped.

    The standard deviation of several readings covers crops already.
    """
    if focal.sd is not None and focal.sd >= _COVERED_SD:
        return 0.0
    software = text_of(tags, Base.Software)
    if _was_edited(tags) or any(name in software for name in _EDITORS):
        share = CROP_SHARES.edited
    elif noted is None or sorted(noted) != sorted(size_px) or _is_small(noted):
        share = CROP_SHARES.resized
    else:
        share = CROP_SHARES.as_written
    return share * (CROP_SHARES.agreeing if focal.sd is None else 1.0)


def _is_reduced(plane: _Source, film: _Source, noted: Size) -> bool:
    """Return whether a program seems to have reduced a photo.

    The focal plane of such a photo is too small.
    """
    if not film:
        return _is_small(noted)
    return min(one.longer_by(other) for one, other in product(plane, film)) > _FOCAL.agree_log


def _combined(sources: Sequence[_Source], known: _FocalLength | None) -> _FocalLength:
    """Return the focal length on which most sources agree.

    Where none agree, it covers them all.
    """
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
    if log(max(middles) / min(middles)) > _FOCAL.agree_log:
        return _covering(source, middles, _COVERED_SD)
    return _FocalLength(source, middles[0], None)


def _without_agreement(sources: Sequence[_Source], known: _FocalLength | None) -> _FocalLength:
    """Return a focal length that covers sources that do not agree.

    A photo shows no more than its camera's whole sensor, and may show less.
    """
    if not sources and known is not None:
        return replace(known, source=f"only EXIF's {known.source} gives it")
    readings = [one for source in sources for one in source]
    names = " and its ".join(source[0].source for source in sources)
    is_part = known is not None and min(one.longer_by(known) for one in readings) > _FOCAL.agree_log
    if known is not None and not is_part:
        names += f" and its {known.source}"
        readings.append(known)
    is_alone = len(sources) == 1 and (known is None or is_part)
    found = _covering(
        f"only EXIF's {names} gives it" if is_alone else f"EXIF's {names} contradict each other",
        [one.diagonals for one in readings],
        (readings[0].sd if is_alone else None) or _COVERED_SD,
    )
    if known is None or not is_part:
        return found
    sd = max(found.sd or 0.0, 0.5 * found.longer_by(known))
    return replace(found, source=f"{found.source}, and its {known.source} shows more", sd=sd)


def _covering(source: str, diagonals: Sequence[float], least_sd: float) -> _FocalLength:
    """Return the middle of focal lengths; its standard deviation covers them."""
    short = min(diagonals)
    long = max(diagonals)
    sd = max(0.5 * log(long / short), least_sd)
    return _FocalLength(source, sqrt(short * long), sd, (short, long) if short < long else ())


def _is_small(noted: Size) -> bool:
    """Return whether a noted frame has fewer pixels than cameras have."""
    return noted[0] * noted[1] < _FOCAL.least_pixels


def _is_lens(diagonals: float, focal_mm: float | None) -> bool:
    """Return whether a lens can have a focal length (frame diagonals)."""
    if _fov_deg(1.0, diagonals) > _FOCAL.widest_deg:
        return False
    return focal_mm is None or _FOCAL.sensor_mm[0] <= focal_mm / diagonals <= _FOCAL.sensor_mm[1]


def _pixels_per_mm(tags: Tags) -> float | None:
    """Return the focal plane's pixels per mm; None if not noted."""
    unit_mm = _MM_PER_UNIT.get(int(positive(tags.get(Base.FocalPlaneResolutionUnit)) or 2))
    across = positive(tags.get(Base.FocalPlaneXResolution))
    return None if unit_mm is None or across is None else across / unit_mm

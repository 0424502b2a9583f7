"""The projection and the field of view that a photo's file notes.

EXIF notes a lens (`skyline.photo.noted_focal_length`), and the file may show only a part of the
frame that it took (`skyline.photo.frame`). A panorama notes its own frame in XMP
(`skyline.photo.noted_panorama`).
"""

import re
from dataclasses import dataclass
from math import degrees, exp, hypot, radians, sin

from PIL.ExifTags import Base

from skyline.camera.projection import MIN_FOV_DEG, Projection
from skyline.photo.frame import (
    CROP,
    Size,
    cropped_width,
    frames_of,
    is_bordered,
    is_unscaled,
    is_whole,
)
from skyline.photo.noted_focal_length import (
    COVERED_SD,
    FocalLength,
    has_few_pixels,
    noted_focal_length,
    part_fov_deg,
    was_edited,
)
from skyline.photo.noted_panorama import panorama_of_xmp, swept_lens_of
from skyline.photo.sensors import sensor_of
from skyline.photo.skyline import Lens
from skyline.photo.tags import Tags, positive, text_of
from skyline.photo.xmp import Xmp

MAX_PINHOLE_ASPECT = 2.5
"""Wider photos are stitched or swept panoramas, or strips, whose width no lens determines."""
_MOST_NARROWING = 1.8
"""Largest ratio of the likeliest field of view to the narrowest reading: a search reaches down to
half the likeliest."""
_CAMERA_RAW = "http://ns.adobe.com/camera-raw-settings/1.0"
"""Namespace of the settings of Lightroom and Camera Raw."""
_FISHEYE = re.compile("FISH-?EYE")
"""A part of the names of lenses that are fisheyes, in capitals."""


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


CROP_SHARES = CropShares()
_EDITORS = (
    "PHOTOSHOP", "LIGHTROOM", "GIMP", "SNAPSEED", "PICASA", "DARKTABLE", "RAWTHERAPEE", "LUMINAR",
    "CAPTURE ONE", "AFFINITY", "PAINT", "PIXELMATOR", "DXO", "PHOTOLAB", "ACDSEE", "GPHOTO",
    "XNVIEW", "IRFANVIEW", "DIGIKAM", "APERTURE", "PHOTOS 1", "ON1", "CANVA", "POLARR",
)  # fmt: skip
"""Names in EXIF's Software of programs with which people crop, in capitals."""


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
    focal, against = noted_focal_length(tags, size_px, noted, frame, sensor)
    if focal is None:
        return Lens(reason="; ".join(against))
    if max(size_px) / min(size_px) > MAX_PINHOLE_ASPECT:
        return Lens(reason=f"{focal.source}, which holds for no panorama or strip")
    width = cropped_width(size_px, frame) / hypot(*frame)
    fov_deg = part_fov_deg(width, focal.diagonals)
    source = focal.source
    if focal.readings:
        wide_deg, narrow_deg = (part_fov_deg(width, one) for one in focal.readings)
        fov_deg = min(fov_deg, _MOST_NARROWING * narrow_deg)
        source += f": {wide_deg:.1f} or {narrow_deg:.1f} degrees"
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"{source}: {fov_deg:.2g} degrees, which fit no photo")
    fov_sd_deg = None if focal.sd is None else degrees(focal.sd * sin(radians(fov_deg)))
    widest_deg = part_fov_deg(width, focal.diagonals * exp(-2.0 * (focal.sd or 0.0)))
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


def _crop_share(
    tags: Tags, size_px: tuple[int, int], noted: Size | None, focal: FocalLength
) -> float:
    """Return the probability that an apparently whole frame was cropped.

    The standard deviation of several readings covers crops already.
    """
    if focal.sd is not None and focal.sd >= COVERED_SD:
        return 0.0
    software = text_of(tags, Base.Software)
    if was_edited(tags) or any(name in software for name in _EDITORS):
        share = CROP_SHARES.edited
    elif noted is None or sorted(noted) != sorted(size_px) or has_few_pixels(noted):
        share = CROP_SHARES.resized
    else:
        share = CROP_SHARES.as_written
    return share * (CROP_SHARES.agreeing if focal.sd is None else 1.0)

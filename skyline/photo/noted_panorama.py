"""The projection and the field of view that a panorama's file notes."""

import re
from math import degrees, sqrt

from PIL.ExifTags import Base

from skyline.camera.projection import MAX_PANORAMA_DEG, MIN_FOV_DEG, Projection
from skyline.photo.frame import CROP, cropped_width, is_unscaled, is_whole
from skyline.photo.skyline import Lens
from skyline.photo.tags import Tags, positive
from skyline.photo.xmp import Xmp

GPANO = "http://ns.google.com/photos/1.0/panorama"
"""Namespace of the properties of panoramas (GPano, https://developers.google.com/streetview)."""
_NAMES_PANORAMA = re.compile("GPano|photos/1.0/panorama")
"""Text that every packet that notes a panorama contains."""
_OF_A_LENS = {"rectilinear", Projection.PERSPECTIVE}
"""The names that XMP has for the projection of photos through a lens."""
_WIDEST_PX = 1e8
"""The widest full turn of a panorama that is plausible."""
_SWEPT = 6.0
"""Value of CustomRendered that Apple's phones note for a panorama."""
_SWEPT_HEIGHT = 0.83
"""Share of the camera's height that a swept panorama keeps: between 0.7 and nearly all."""
_TALLEST = 4.0 / 3.0
"""Greatest height over width of a panorama that was swept sideways: it begins with a whole frame,
held upright."""
_SWEPT_SD = 0.12
"""Relative standard deviation of a swept panorama's width."""


def panorama_of_xmp(xmp: Xmp, size_px: tuple[int, int]) -> tuple[Projection, Lens] | None:
    """Return the projection and field of view of a panorama in XMP.

    Returns None if XMP notes no panorama. ``size_px`` is the width and the height of the file's
    pixels, upright. XMP notes the size of the panorama when it was made and the width of a full
    turn. A file of the panorama's shape shows all of it. A file with all of the panorama's rows or
    columns was cropped, and not scaled. Any other file shows at most the largest part of the
    panorama that has the file's shape, and at least its pixels at the panorama's scale.
    """
    if _NAMES_PANORAMA.search(xmp.broken):
        reason = "XMP mentions a panorama, but is damaged: its projection is not known"
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
    if noted not in set(Projection):
        reason = f"XMP says that the photo's projection is {noted}, which is not known here"
        return Projection.PERSPECTIVE, Lens(reason=reason)
    is_fisheye = noted == Projection.FISHEYE
    if is_fisheye or width is None or turn is None or not width <= turn <= _WIDEST_PX:
        kind = "fisheye" if is_fisheye else "panorama"
        reason = f"XMP says that the photo is a {kind}, but not how wide"
        return Projection(noted), Lens(reason=reason)
    return Projection(noted), _panorama_lens(size_px, width, height, MAX_PANORAMA_DEG / turn)


def _panorama_lens(
    size_px: tuple[int, int], width: float, height: float | None, deg_per_px: float
) -> Lens:
    """Return the field of view of a file's part of a panorama."""
    kept_px = width if height is None else cropped_width(size_px, (width, height))
    fov_deg = kept_px * deg_per_px
    if fov_deg < MIN_FOV_DEG:
        return Lens(reason=f"XMP's panorama left aside: {fov_deg:.2g} degrees fit no photo")
    if height is None:
        is_known = size_px[0] == width
    else:
        frame = width, height
        # Each side was rounded to a pixel.
        rounding = 1.0 / size_px[0] + 1.0 / size_px[1]
        is_known = is_unscaled(size_px, frame) or is_whole(size_px, frame, rounding)
    if is_known:
        return Lens(fov_deg, reason="XMP notes a panorama of this shape and scale")
    # Crops are sometimes shrunk, hardly ever enlarged.
    least_deg = deg_per_px * min(float(size_px[0]), 0.5 * kept_px)
    return Lens(
        max(sqrt(least_deg * fov_deg), MIN_FOV_DEG),
        (fov_deg - least_deg) / sqrt(12.0),
        min(CROP.most * fov_deg, MAX_PANORAMA_DEG),
        f"XMP notes a panorama of {fov_deg:.1f} degrees, but the photo was cropped since",
    )


def swept_lens_of(tags: Tags, size_px: tuple[int, int]) -> Lens | None:
    """Return the field of view of a panorama that a phone swept.

    Returns None if EXIF notes no such panorama. ``size_px`` is the panorama's width and height,
    upright. A panorama has the scale of the camera held upright, but phones keep more or less of
    the height.
    """
    if positive(tags.get(Base.CustomRendered)) != _SWEPT:
        return None
    equivalent_mm = positive(tags.get(Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None:
        return Lens(reason="EXIF says that the photo is a panorama, but not how wide")
    width, height = size_px
    if height > _TALLEST * width:
        return Lens(reason="EXIF says that the photo is a panorama, swept up or down")
    focal_px = equivalent_mm / 36.0 * height / _SWEPT_HEIGHT
    fov_deg = min(degrees(width / focal_px), MAX_PANORAMA_DEG)
    reason = f"EXIF says that the photo is a panorama: about {fov_deg:.0f} degrees"
    return Lens(fov_deg, _SWEPT_SD * fov_deg, MAX_PANORAMA_DEG, reason)

"""The skyline of a photo, a sky mask or a trace."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL.Image import Image

from skyline.arrays import UInt8Array
from skyline.camera.projection import Projection
from skyline.errors import InputError, numbers_of
from skyline.files.tables import is_table
from skyline.photo.extract import extract_skyline
from skyline.photo.image import Picture
from skyline.photo.noted_fov import MAX_PINHOLE_ASPECT
from skyline.photo.photo import Photo, read_photo
from skyline.photo.sky_mask import is_sky_mask, skyline_of_mask
from skyline.photo.skyline import PhotoSkyline, check_in_picture
from skyline.photo.trace import read_trace
from skyline.photo.user_sky_model import model_skyline

_log = logging.getLogger(__name__)


def read_skyline(
    path: Picture,
    fov_deg: float | None = None,
    *,
    projection: Projection | None = None,
    sky_model: Any = None,
) -> PhotoSkyline:
    """Read the skyline of a trace, a sky mask or a photo.

    A picture that is nearly black and white is a sky mask.

    Parameters
    ----------
    path, fov_deg, projection
        As in `read_photo`; a file may be a trace, too.
    sky_model : onnxruntime.InferenceSession or path, optional
        Segments the sky in photos; see `skyline.photo.user_sky_model`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be used, or no skyline is found in it.
    """
    if is_table(path):
        return read_trace(path, fov_deg, projection)
    return find_skyline(read_photo(path, fov_deg, projection=projection), sky_model)


def named_skyline(
    photo: Picture | PhotoSkyline, fov_deg: float | None = None
) -> tuple[str, PhotoSkyline]:
    """Return a photo's file name and skyline.

    The name is empty for pixels and for a skyline. The skyline has the given field of view, or else
    its own. Raises as `read_skyline`, and `InputError` for anything but one photo.
    """
    if fov_deg is not None:
        error = f"the field of view is {fov_deg!r}; expected a number of degrees"
        (fov_deg,) = numbers_of([fov_deg], 1, error)
    if isinstance(photo, PhotoSkyline):
        check_in_picture(photo)
        return "", photo if fov_deg is None else photo.with_fov(fov_deg)
    if not isinstance(photo, str | Path | Image | np.ndarray):
        raise InputError(
            f"the photo is of type {type(photo).__name__}; expected one path, PIL image, array of "
            "uint8 or PhotoSkyline"
        )
    return str(photo) if isinstance(photo, str | Path) else "", read_skyline(photo, fov_deg)


def find_skyline(photo: Photo, sky_model: Any = None) -> PhotoSkyline:
    """Find the skyline in a photo or a sky mask.

    It has the file's notes on the camera. A warning is logged for a wide photo that notes no lens
    and no panorama. Raises `InputError` where no skyline is found.
    """
    height, width = photo.rgb.shape[:2]
    is_noted = photo.fov_deg is not None or photo.projection.spreads_angles
    if not is_noted and width > MAX_PINHOLE_ASPECT * height:
        _log.warning(
            "%s has %d x %d px and is matched as a strip of a photo; if it is a panorama, give "
            "--projection cylindrical and --fov-deg",
            photo.name,
            width,
            height,
        )
    try:
        if is_sky_mask(photo.rgb):
            return replace(photo.described(skyline_of_mask(photo.rgb)), picture=None)
        if sky_model is None:
            skyline = extract_skyline(photo.rgb)
        else:
            skyline = model_skyline(photo.rgb, sky_model)
    except InputError as error:
        raise InputError(f"{photo.name}: {error}") from error
    return photo.described(skyline)


def read_picture(path: str | Path) -> UInt8Array | None:
    """Return a photo's pixels; None for a trace or a mask.

    Pixels are (H, W, 3) uint8 RGB. Raises as `read_photo`.
    """
    if is_table(path):
        return None
    rgb = read_photo(path).rgb
    return None if is_sky_mask(rgb) else rgb

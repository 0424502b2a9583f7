"""Query files to query skylines, and a picture of what was found."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyline.errors import InputError
from skyline.photo.decode import decode_image
from skyline.photo.extract import extract_skyline
from skyline.photo.frame import UInt8Array
from skyline.photo.mask import is_sky_mask, skyline_of_mask
from skyline.photo.query import QuerySkyline, check_fov_deg
from skyline.photo.trace import read_trace

_SKYLINE_RGB = (255, 0, 60)


def read_query(path: str | Path, fov_deg: float | None = None) -> QuerySkyline:
    """Read a query: a trace (``.csv``), a sky mask (nearly black and white), else a photo.

    Parameters
    ----------
    path : str or Path
    fov_deg : float, optional
        Horizontal field of view, degrees, 1 to 179; by default the photo's EXIF is asked.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be used, or no skyline is found in it.
    """
    if fov_deg is not None:
        check_fov_deg(fov_deg)
    if Path(path).suffix.lower() == ".csv":
        return read_trace(path, fov_deg)
    return extract_photo(path, fov_deg)[1]


def extract_photo(
    path: str | Path, fov_deg: float | None = None
) -> tuple[UInt8Array, QuerySkyline]:
    """Read a photo or a sky mask and find its skyline; as `read_query`, with the pixels.

    Returns
    -------
    image : (H, W, 3) uint8
        RGB, upright, the pixels that the skyline's rows count.
    query : QuerySkyline
    """
    decoded = decode_image(path)
    if min(decoded.rgb.shape[:2]) < 2:
        height, width = decoded.rgb.shape[:2]
        raise InputError(f"{path} has {width} x {height} px; expected a photo or a sky mask")
    find = skyline_of_mask if is_sky_mask(decoded.rgb) else extract_skyline
    try:
        query = find(decoded.rgb)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return decoded.rgb, replace(query, fov_deg=decoded.fov_deg if fov_deg is None else fov_deg)


def read_picture(path: str | Path) -> UInt8Array | None:
    """Return a query's photo (H, W, 3) uint8 RGB, upright; None for a trace or a sky mask.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        It cannot be decoded.
    """
    if Path(path).suffix.lower() == ".csv":
        return None
    image = decode_image(path).rgb
    return None if is_sky_mask(image) else image


def write_overlay(photo: UInt8Array, query: QuerySkyline, path: str | Path) -> None:
    """Write a photo (H, W, 3) uint8 RGB as PNG with the skyline's trusted columns drawn on it.

    Raises
    ------
    InputError
        The skyline is of an image of another size, or the file cannot be written.
    """
    height, width = photo.shape[:2]
    if (width, height) != (query.width_px, query.height_px):
        raise InputError(
            f"the skyline is of an image of {query.width_px} x {query.height_px} px, the photo has "
            f"{width} x {height}; expected the same image"
        )
    drawn = photo.copy()
    thickness = max(1, round(width / 1000))
    for run in _runs(query):
        points = np.stack([run, np.rint(query.row_px[run])], axis=1).astype(np.int32)
        cv2.polylines(drawn, [points], False, _SKYLINE_RGB, thickness)
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    try:
        Image.fromarray(drawn).save(partial, format="PNG", compress_level=1)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise InputError(
            f"{path} cannot be written ({error.strerror}); name a file in a folder that exists"
        ) from error


def _runs(query: QuerySkyline) -> list[np.ndarray]:
    """Return the columns of each unbroken run of trusted ones."""
    columns = np.flatnonzero(query.trusted)
    return np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1)

"""Query files to query skylines, and a picture of what was found."""

import io
import logging
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyline.arrays import UInt8Array
from skyline.errors import InputError
from skyline.files import write_whole
from skyline.photo.decode import Photo, decode_image
from skyline.photo.extract import extract_skyline
from skyline.photo.lens import MAX_PINHOLE_ASPECT
from skyline.photo.mask import is_sky_mask, skyline_of_mask
from skyline.photo.projection import Projection
from skyline.photo.query import QuerySkyline, check_of_image
from skyline.photo.sky_model import SkySession, load_sky_model, model_skyline
from skyline.photo.trace import read_trace

log = logging.getLogger(__name__)

SkyModel = SkySession | str | Path | None

_SKYLINE_RGB = (255, 0, 60)


def read_query(
    path: str | Path,
    fov_deg: float | None = None,
    *,
    projection: Projection | None = None,
    sky_model: SkyModel = None,
) -> QuerySkyline:
    """Read a query: a trace (``.csv``), a sky mask (nearly black and white), else a photo.

    Parameters
    ----------
    path : str or Path
    fov_deg : float, optional
        Horizontal field of view, degrees: 1 to 179, of a panorama to 360; by default the photo's
        EXIF or XMP is asked.
    projection : Projection, optional
        By default perspective, unless the photo's XMP says that it is a panorama.
    sky_model : SkySession or path, optional
        Finds the sky in photos; see `load_sky_model`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The file cannot be used, or no skyline is found in it.
    """
    check_fov(fov_deg, projection)
    if Path(path).suffix.lower() == ".csv":
        return read_trace(path, fov_deg, projection)
    return extract_photo(path, fov_deg, projection=projection, sky_model=sky_model)[1]


def extract_photo(
    path: str | Path,
    fov_deg: float | None = None,
    *,
    projection: Projection | None = None,
    sky_model: SkyModel = None,
) -> tuple[UInt8Array, QuerySkyline]:
    """Read a photo or a sky mask and find its skyline; as `read_query`, with the pixels.

    These are (H, W, 3) uint8 RGB, upright.
    """
    photo = read_photo(path, fov_deg, projection=projection)
    _doubt_strip(path, photo)
    try:
        query = _find(photo.rgb, sky_model)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return photo.rgb, photo.described(query)


def read_photo(
    path: str | Path, fov_deg: float | None = None, *, projection: Projection | None = None
) -> Photo:
    """Read a photo or a sky mask: its pixels, upright, and what its file notes of them.

    Parameters
    ----------
    path : str or Path
    fov_deg, projection
        As of `read_query`.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        It cannot be decoded, or is a sliver.
    """
    check_fov(fov_deg, projection)
    decoded = decode_image(path)
    # What the lens was says nothing of a panorama, nor where a person knows better.
    is_as_noted = projection in (None, decoded.projection)
    lens = decoded.lens if fov_deg is None and is_as_noted else None
    if fov_deg is None and (lens is not None or decoded.lens is None):
        fov_deg = decoded.fov_deg
    projection = projection or decoded.projection
    height, width = decoded.rgb.shape[:2]
    if min(height, width) < 2:
        raise InputError(f"{path} has {width} x {height} px; expected a photo or a sky mask")
    return Photo(decoded.rgb, fov_deg, projection, decoded.place, lens)


def _doubt_strip(path: str | Path, photo: Photo) -> None:
    """Warn of a photo that has the shape of a panorama, where nobody says that it is none."""
    height, width = photo.rgb.shape[:2]
    is_said = photo.fov_deg is not None or photo.projection is not Projection.PERSPECTIVE
    if not is_said and width > MAX_PINHOLE_ASPECT * height:
        log.warning(
            "%s has %d x %d px and is matched as a strip of a photo; if it is a panorama, give "
            "--projection cylindrical and --fov-deg",
            path,
            width,
            height,
        )


def check_fov(fov_deg: float | None, projection: Projection | None) -> None:
    """Refuse an impossible field of view before a file is looked at; raises `InputError`."""
    if fov_deg is not None:
        (projection or Projection.PERSPECTIVE).check_fov_deg(fov_deg)


def _find(image: UInt8Array, sky_model: SkyModel) -> QuerySkyline:
    if is_sky_mask(image):
        return skyline_of_mask(image)
    if sky_model is None:
        return extract_skyline(image)
    if isinstance(sky_model, str | Path):
        sky_model = load_sky_model(sky_model)
    return model_skyline(image, sky_model)


def read_picture(path: str | Path) -> UInt8Array | None:
    """Return a query's photo (H, W, 3) uint8 RGB, upright; None for a trace or a sky mask.

    Raises as `read_photo`.
    """
    if Path(path).suffix.lower() == ".csv":
        return None
    image = read_photo(path).rgb
    return None if is_sky_mask(image) else image


def write_overlay(photo: UInt8Array, query: QuerySkyline, path: str | Path) -> None:
    """Write a photo (H, W, 3) uint8 RGB as PNG with the skyline's trusted columns drawn on it.

    Raises `InputError` where the skyline is of an image of another size, or the file cannot be
    written.
    """
    check_of_image(query, photo.shape)
    drawn = photo.copy()
    thickness = max(1, round(query.width_px / 1000))
    columns = np.flatnonzero(query.trusted)
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        points = np.stack([run, np.rint(query.row_px[run])], axis=1).astype(np.int32)
        cv2.polylines(drawn, [points], False, _SKYLINE_RGB, thickness)
    picture = io.BytesIO()
    Image.fromarray(drawn).save(picture, format="PNG", compress_level=1)
    write_whole(Path(path), picture.getvalue())

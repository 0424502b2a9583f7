"""A photo at its full size with its skyline drawn, to check what was found."""

import io
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from skyline.arrays import UInt8Array
from skyline.errors import suffix_of
from skyline.files.disk import write_whole
from skyline.photo.skyline import PhotoSkyline, check_of_image

OVERLAYS = (".png",)
_SKYLINE_RGB = (255, 0, 60)
_OTHER_CREST_RGB = (255, 160, 0)


def write_overlay(rgb: UInt8Array, skyline: PhotoSkyline, path: str | Path) -> None:
    """Write a photo as PNG with its skyline drawn on it.

    Only trusted columns are drawn; other crests that may be the skyline have another colour. The
    pixels are (H, W, 3) uint8. Raises `InputError` if the skyline belongs to an image of another
    size, the file is not named .png, or it cannot be written.
    """
    suffix_of(path, OVERLAYS)
    check_of_image(skyline, rgb.shape)
    drawn = rgb.copy()
    thickness = max(1, round(skyline.width_px / 1000))
    other_px = skyline.other_crest_px()
    columns = np.flatnonzero(np.isfinite(other_px))
    rows = np.rint(other_px[columns]).astype(np.intp)
    for down in range(thickness):
        drawn[np.clip(rows + down, 0, len(drawn) - 1), columns] = _OTHER_CREST_RGB
    columns = np.flatnonzero(skyline.trusted)
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        points = np.stack([run, np.rint(skyline.row_px[run])], axis=1).astype(np.int32)
        cv2.polylines(drawn, [points], False, _SKYLINE_RGB, thickness)
    picture = io.BytesIO()
    Image.fromarray(drawn).save(picture, format="PNG", compress_level=1)
    write_whole(Path(path), picture.getvalue())

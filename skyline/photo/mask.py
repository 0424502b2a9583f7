"""Sky masks: images drawn by a person or a program, white for sky and black for ground."""

import numpy as np

from skyline.arrays import Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.query import QuerySkyline

_NEARLY = 24
"""Levels from black or white that still count as such: masks saved as JPEG ring."""
_MIN_SHARE = 0.98
"""Share of a mask's pixels that are nearly black or white; the rest is its smoothed border."""
_SAMPLES = 500
_MIDDLE = 127.5


def is_sky_mask(image: UInt8Array) -> bool:
    """Return whether an RGB image (H, W, 3) uint8 is grey, and nearly all of it black or white.

    About five hundred rows and columns are looked at.
    """
    step_down, step_across = (max(1, side // _SAMPLES) for side in image.shape[:2])
    sample = image[::step_down, ::step_across].astype(np.int16)
    grey = sample[:, :, 1]
    coloured = np.abs(sample - grey[:, :, np.newaxis]).max(axis=2) > _NEARLY
    extreme = (grey <= _NEARLY) | (grey >= 255 - _NEARLY)
    return not coloured.any() and float(extreme.mean()) >= _MIN_SHARE


def skyline_of_mask(image: UInt8Array) -> QuerySkyline:
    """Return the border of each column's topmost ground; NaN where a column has no sky above it.

    A smoothed border is found to a fraction of a pixel, halfway from white to black. Raises
    `InputError` where no column of the mask, (H, W, 3) uint8, has sky (white) above ground.
    """
    row_px, _ = topmost_border(image[:, :, 1].astype(np.float64), _MIDDLE)
    drawn = np.isfinite(row_px)
    if not drawn.any():
        raise InputError(
            "no skyline found: the mask has no column with sky (white) above ground (black); "
            "expected white for the sky"
        )
    return QuerySkyline(row_px, drawn.astype(np.float64), image.shape[1], len(image))


def topmost_border(sky: Float64Array, middle: float) -> tuple[Float64Array, IntArray]:
    """Return where each column (w,) of how much is sky (h, w) first falls below a middle.

    That is to a fraction of a row, NaN where it never does or begins below, and the row of the
    first pixel of ground.
    """
    is_ground = sky < middle
    first = np.argmax(is_ground, axis=0)
    # A column that starts with ground has its skyline above the image, one without below it.
    seen = is_ground.any(axis=0) & (first > 0)
    columns = np.arange(sky.shape[1])
    above, below = sky[first - 1, columns], sky[first, columns]
    row_px = first - 1 + (above - middle) / np.where(seen, above - below, 1.0)
    return np.where(seen, row_px, np.nan), first

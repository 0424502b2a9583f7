"""Sky masks: white for sky, black for ground."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.skyline import PhotoSkyline


@dataclass(frozen=True, slots=True)
class _Mask:
    """Limits within which an image is a sky mask."""

    nearly: int = 24
    """Levels within which a pixel counts as black or white: JPEG makes edges of masks ring."""
    least_share: float = 0.98
    """Least share of a mask's pixels that are nearly black or white; the rest is its border."""
    samples: int = 500
    """Rows and columns that are sampled."""
    most_changes: float = 15.0
    """Most changes between black and white down a column, on average: masks of photos have about 2,
    dithered photos 90 or more."""
    middle: float = 127.5
    """Level halfway from black to white."""
    flat_px: float = 1.0
    """A border within this distance of its median is straight there, like a frame."""
    most_flat: float = 0.9
    """A border that is straight in more than this share of the columns may belong to a frame."""
    most_white: float = 0.1
    """The border belongs to a frame round white ground if more than this share of the pixels below
    it are white."""


_MASK = _Mask()


def is_sky_mask(image: UInt8Array) -> bool:
    """Return whether an image is a sky mask.

    A mask is grey, nearly all black or white, in few areas. About five hundred rows and columns of
    the image, (H, W, 3) uint8, are sampled. A dithered photo is not a mask.
    """
    step_down, step_across = (max(1, side // _MASK.samples) for side in image.shape[:2])
    sample = image[::step_down, ::step_across].astype(np.int16)
    grey = sample[:, :, 1]
    coloured = np.abs(sample - grey[:, :, np.newaxis]).max(axis=2) > _MASK.nearly
    extreme = (grey <= _MASK.nearly) | (grey >= 255 - _MASK.nearly)
    changes = np.count_nonzero(np.diff(grey >= _MASK.middle, axis=0)) / grey.shape[1]
    is_extreme = float(extreme.mean()) >= _MASK.least_share
    return not coloured.any() and is_extreme and changes <= _MASK.most_changes


def skyline_of_mask(image: UInt8Array) -> PhotoSkyline:
    """Return the border above each column's topmost ground.

    The row is NaN in a column without sky above ground. A smoothed border is found to a fraction of
    a pixel, halfway from white to black. Raises `InputError` if no column of the mask, (H, W, 3)
    uint8, has sky (white) above ground, if more columns begin with black above white than have a
    skyline, or if white ground in a white frame is taken for sky.
    """
    sky = image[:, :, 1].astype(np.float64)
    row_px, first = topmost_border(sky, _MASK.middle)
    wrong = _what_is_wrong(sky, row_px, first)
    if wrong:
        raise InputError(
            "no skyline found: the picture is only black and white, as a sky mask is, and has "
            f"{wrong}; expected white for the sky, black for the ground, and no frame"
        )
    trust = np.isfinite(row_px).astype(np.float64)
    return PhotoSkyline(row_px, trust, image.shape[1], len(image))


def _what_is_wrong(sky: Float64Array, row_px: Float64Array, first: IntArray) -> str:
    """Return why a picture is not a sky mask, or ""."""
    drawn = np.isfinite(row_px)
    white = np.count_nonzero(sky >= _MASK.middle, axis=0)
    begins_black = sky[0] < _MASK.middle
    if np.count_nonzero((white > _MASK.most_white * len(sky)) & begins_black) > drawn.sum():
        return "black above white, as one with white ground or in a black frame"
    if not drawn.any():
        return "no sky above ground"
    median_px = np.nanmedian(row_px)
    is_flat = np.mean(np.abs(row_px - median_px)[drawn] <= _MASK.flat_px) > _MASK.most_flat
    below = (len(sky) - first)[drawn].sum()
    if is_flat and (white - first)[drawn].sum() > _MASK.most_white * below:
        return (
            f"a straight border at row {median_px:.0f} and white below it, as one with white "
            "ground in a white frame"
        )
    return ""


def topmost_border(sky: Float64Array, middle: float) -> tuple[Float64Array, IntArray]:
    """Return the row where each column first falls below a middle value.

    The row (w,) is fractional, NaN if the column of the image (h, w) never falls or starts below
    the middle. The second array is the row of the first pixel of ground.
    """
    is_ground = sky < middle
    first = np.argmax(is_ground, axis=0)
    # The skyline lies above the image if a column starts with ground, below it if it has none.
    seen = is_ground.any(axis=0) & (first > 0)
    columns = np.arange(sky.shape[1])
    above = sky[first - 1, columns]
    below = sky[first, columns]
    row_px = first - 1 + (above - middle) / np.where(seen, above - below, 1.0)
    return np.where(seen, row_px, np.nan), first

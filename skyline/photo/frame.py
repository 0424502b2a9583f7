"""What of an image is photo: uniform borders and caption bars are not."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array, UInt8Array
from skyline.errors import InputError
from skyline.photo.query import QuerySkyline

MIN_CONTENT_PX = 32
"""Smallest width and height in which a skyline is looked for."""
MAX_ASPECT = 30.0
"""Longest side over shortest; full circles of a low panorama have about 12."""

_COLOUR_TOLERANCE = 10
"""Greatest difference per channel within one uniform border; JPEG rings by a few levels."""
_BAR_SHARE = 0.6
"""Share of a row that must be a bar's own colour; the rest may be its caption."""
_EDGE_SHARE = 0.9
"""Share of the first row of content that must differ from the bar, but for the borders at its
ends: bars end in a straight line."""
_BAR_BLUR_PX = 3
"""Rows beyond a bar that resizing and JPEG have mixed with it."""
_MAX_BAR_SHARE = 0.3
"""Tallest bar, as a share of the image."""
_SAMPLES = 500
"""Pixels of a row that are looked at, at least; of a shorter row all."""


@dataclass(frozen=True, slots=True)
class Content:
    """The rectangle of an image that is photo: half-open ranges of rows and columns."""

    top: int
    bottom: int
    left: int
    right: int

    def crop(self, image: UInt8Array) -> UInt8Array:
        """Return the photo inside its borders, a view."""
        return image[self.top : self.bottom, self.left : self.right]

    def skyline(
        self, row_px: Float64Array, confidence: Float64Array, shape: tuple[int, ...]
    ) -> QuerySkyline:
        """Return the skyline of an image of a shape (H, W, ...) from that of its photo, (w,) each.

        Columns without a row (NaN) are masked, and so is all beside the photo.
        """
        height, width = shape[:2]
        rows, confidences = np.full(width, np.nan), np.zeros(width)
        inside = slice(self.left, self.right)
        rows[inside] = row_px + self.top
        confidences[inside] = np.where(np.isfinite(row_px), confidence, 0.0)
        return QuerySkyline(rows, confidences, width, height)


def content_of(image: UInt8Array) -> Content:
    """Find the photo inside uniform borders and caption bars.

    A bar is a run of rows (or columns) from the image's edge, mostly of one colour, that ends
    in a straight line: the next row differs from that colour nearly everywhere. Overcast sky
    and dark ground are uniform too, but they end in a skyline. Raises `InputError` where less than
    32 x 32 pixels are left of the image (H, W, 3) uint8, or it is a sliver.
    """
    height, width = image.shape[:2]
    if max(height, width) > MAX_ASPECT * min(height, width):
        raise InputError(
            f"the image has {width} x {height} px; expected a photo or a panorama, sides of at "
            f"most 1 to {MAX_ASPECT:g}"
        )
    top = _bar_length(image)
    bottom = len(image) - _bar_length(image[::-1])
    sideways = image[top:bottom].transpose(1, 0, 2)
    left = _bar_length(sideways)
    right = len(sideways) - _bar_length(sideways[::-1])
    content = Content(top, bottom, left, right)
    if min(bottom - top, right - left) < MIN_CONTENT_PX:
        raise InputError(
            f"the photo has {width} x {height} px, {max(right - left, 0)} x "
            f"{max(bottom - top, 0)} within its borders; expected at least {MIN_CONTENT_PX} x "
            f"{MIN_CONTENT_PX}: use a larger photo"
        )
    return content


def _bar_length(image: UInt8Array) -> int:
    """Return how many rows at the start of the image are a bar."""
    longest = int(_MAX_BAR_SHARE * len(image))
    if longest < 1:
        return 0
    image = image[:, :: max(1, image.shape[1] // _SAMPLES)]
    colour = np.median(image[0], axis=0)
    rows = range(longest + 1)
    length = next((k for k in rows if _alike(image[k], colour).mean() < _BAR_SHARE), 0)
    ends_straight = any(_is_content(row, colour) for row in image[length : length + _BAR_BLUR_PX])
    return length + _BAR_BLUR_PX if length and ends_straight else 0


def _is_content(row: UInt8Array, colour: Float64Array) -> bool:
    """Return whether a row (N, 3) differs from a bar's colour nearly everywhere.

    Borders of that colour at the row's ends are left out, as long as most of the row remains.
    """
    differs = np.flatnonzero(~_alike(row, colour))
    if differs.size < _BAR_SHARE * len(row):
        return False
    return bool(differs.size >= _EDGE_SHARE * (differs[-1] + 1 - differs[0]))


def _alike(pixels: UInt8Array, colour: Float64Array) -> BoolArray:
    """Return which of pixels (N, 3) are of a colour."""
    return np.asarray(np.abs(pixels - colour).max(axis=-1) <= _COLOUR_TOLERANCE)

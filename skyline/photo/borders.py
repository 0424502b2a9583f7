"""The photo in an image, inside uniform borders and caption bars."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array, UInt8Array
from skyline.errors import InputError
from skyline.photo.skyline import PhotoSkyline


@dataclass(frozen=True, slots=True)
class _Bars:
    """Limits within which rows and columns are a border or caption."""

    least_content_px: int = 32
    """Smallest width and height in which a skyline is searched."""
    most_aspect: float = 30.0
    """Greatest ratio of the sides; a low panorama of a full turn has about 12."""
    colour_tolerance: int = 10
    """Greatest difference per channel within a uniform border; JPEG rings by a few levels."""
    same_share: float = 0.6
    """Share of a row that must have the bar's colour; the rest may be its caption."""
    edge_share: float = 0.9
    """Share of the first row of content, without the borders at its ends, that must differ from the
    bar, since bars end in a straight line."""
    blur_px: int = 3
    """Rows beyond a bar that resizing and JPEG mix with it."""
    longest_share: float = 0.3
    """Tallest bar, as a share of the image."""
    samples: int = 500
    """Least number of pixels sampled from a row; shorter rows are read whole."""


_BARS = _Bars()


@dataclass(frozen=True, slots=True)
class Content:
    """The part of an image that is photo.

    Rows and columns are half-open ranges.

    Attributes
    ----------
    height_px, width_px : int
        Size of the whole image.
    top, bottom, left, right : int
        Rows and columns of the photo in it.
    """

    height_px: int
    width_px: int
    top: int
    bottom: int
    left: int
    right: int

    @classmethod
    def whole(cls, image: UInt8Array) -> "Content":
        """Return all of an image (H, W, 3) as content."""
        height, width = image.shape[:2]
        return cls(height, width, 0, height, 0, width)

    def crop(self, image: UInt8Array) -> UInt8Array:
        """Return the photo inside its borders as a view of the image."""
        return image[self.top : self.bottom, self.left : self.right]

    def skyline(
        self, row_px: Float64Array, trust: Float64Array, crests: Float64Array | None = None
    ) -> PhotoSkyline:
        """Return the image's skyline from the rows of its photo.

        The rows and the trust are (w,), the crests (K, w). Columns without a row (NaN) and columns
        beside the photo are masked.
        """
        inside = slice(self.left, self.right)
        image_row_px = np.full(self.width_px, np.nan)
        image_row_px[inside] = row_px + self.top
        image_trust = np.zeros(self.width_px)
        image_trust[inside] = np.where(np.isfinite(row_px), trust, 0.0)
        image_crests = None
        if crests is not None:
            image_crests = np.full((len(crests), self.width_px), np.nan)
            image_crests[:, inside] = crests + self.top
        return PhotoSkyline(
            image_row_px, image_trust, self.width_px, self.height_px, crests=image_crests
        )


def content_of(image: UInt8Array) -> Content:
    """Find the photo inside uniform borders and caption bars.

    A bar is a run of rows (or columns) from the image's edge, mostly of one colour, that ends in a
    straight line: the next row differs from that colour nearly everywhere. Overcast sky and dark
    ground are uniform too, but they end in a skyline. Raises `InputError` if less than 32 x 32
    pixels of the image (H, W, 3) uint8 remain, or if it is a sliver.
    """
    height, width = image.shape[:2]
    if max(height, width) > _BARS.most_aspect * min(height, width):
        raise InputError(
            f"the image has {width} x {height} px; expected a photo or a panorama, sides of at "
            f"most 1 to {_BARS.most_aspect:g}"
        )
    top = _bar_length(image)
    bottom = len(image) - _bar_length(image[::-1])
    sideways = image[top:bottom].transpose(1, 0, 2)
    left = _bar_length(sideways)
    right = len(sideways) - _bar_length(sideways[::-1])
    least_px = _BARS.least_content_px
    if min(bottom - top, right - left) < least_px:
        raise InputError(
            f"the photo has {width} x {height} px, {max(right - left, 0)} x "
            f"{max(bottom - top, 0)} within its borders; expected at least {least_px} x "
            f"{least_px}: use a larger photo"
        )
    return Content(height, width, top, bottom, left, right)


def _bar_length(image: UInt8Array) -> int:
    """Return how many rows at the image's start form a bar."""
    longest = int(_BARS.longest_share * len(image))
    if longest < 1:
        return 0
    image = image[:, :: max(1, image.shape[1] // _BARS.samples)]
    colour = np.median(image[0], axis=0)
    rows = range(longest + 1)
    length = next((k for k in rows if _alike(image[k], colour).mean() < _BARS.same_share), 0)
    ends_straight = any(_is_content(row, colour) for row in image[length : length + _BARS.blur_px])
    return length + _BARS.blur_px if length and ends_straight else 0


def _is_content(row: UInt8Array, colour: Float64Array) -> bool:
    """Return whether a row (N, 3) shows more than a bar.

    It does if nearly all of it differs from the bar's colour. Borders of that colour at the row's
    ends are ignored, as long as most of the row remains.
    """
    differs = np.flatnonzero(~_alike(row, colour))
    if differs.size < _BARS.same_share * len(row):
        return False
    return bool(differs.size >= _BARS.edge_share * (differs[-1] + 1 - differs[0]))


def _alike(pixels: UInt8Array, colour: Float64Array) -> BoolArray:
    """Return which pixels (N, 3) have a colour, within the tolerance."""
    return np.asarray(np.abs(pixels - colour).max(axis=-1) <= _BARS.colour_tolerance)

"""Skylines in the haze above the one that was found first.

The network that finds skylines sees a whole photo, and dark ground and bright sky take up the range
of brightness there. Far ranges in haze differ from the sky by a few levels only, and may be taken
for sky; then the ridge in front of them is taken for the skyline. A second look shows the network a
band about this ridge, in which everything below the ridge is painted over with the colours just
above it. Where it finds a skyline in the band, that skyline is farther away.

It may also be a cloud. So it does not replace the first skyline, but is an alternative for a photo
that would have no answer otherwise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.photo.borders import Content, content_of
from skyline.photo.extract import Extraction
from skyline.photo.skyline import PhotoSkyline


@dataclass(frozen=True, slots=True)
class _Look:
    """The band about a skyline, and what counts as a farther skyline."""

    above_share: float = 0.12
    """Height of the band above the highest row of the skyline, as a share of all rows. A higher
    band holds more sky, whose brightness leaves less to the haze."""
    below_share: float = 0.04
    """Height of the band below the lowest row, as a share of all rows."""
    least_px: int = 32
    """A band of fewer rows shows nothing."""
    painted_px: int = 2
    """Rows above the skyline whose colours are painted over the ground."""
    smoothed_px: int = 9
    """Columns over which these colours are averaged."""
    apart_share: float = 0.01
    """A farther skyline lies at least this much higher, as a share of all rows."""
    doubted: float = 0.2
    """Columns where a farther skyline has more trust than this are not known to have the nearer
    one."""
    least_share: float = 0.1
    """A farther skyline is trusted in at least this share of the columns."""
    most: int = 2
    """Most looks: layers of haze may hide one another."""


_LOOK = _Look()


def farther_skylines(skyline: PhotoSkyline) -> Iterator[PhotoSkyline]:
    """Yield a photo's farther skylines, if any, each farther than the last.

    None is found for a trace, a mask, and a skyline that a person has corrected. Columns in which
    nothing farther is seen keep the skyline given.
    """
    for _ in range(_LOOK.most):
        farther = _looked_beyond(skyline)
        if farther is None:
            return
        skyline = farther
        yield skyline


def _looked_beyond(skyline: PhotoSkyline) -> PhotoSkyline | None:
    """Return the next farther skyline; None where there is none."""
    if skyline.picture is None or skyline.is_drawn or not skyline.trusted.any():
        return None
    band = _Band.about(skyline, skyline.picture)
    if len(band.pixels) < _LOOK.least_px:
        return None
    found = Extraction(band.painted(), Content.whole(band.pixels))
    is_higher = band.ridge_row - found.row_px > _LOOK.apart_share * band.photo_rows
    trust = np.where(is_higher, found.trust, 0.0)
    row = np.where(found.skyline(found.row_px, trust).trusted, found.row_px, np.nan)
    row_px, trust = band.in_columns(row, skyline.width_px), band.in_columns(trust, skyline.width_px)
    is_seen = np.isfinite(row_px)
    if is_seen.mean() < _LOOK.least_share:
        return None
    is_doubted = trust > _LOOK.doubted
    return replace(
        skyline,
        row_px=np.where(is_doubted, band.in_photo(row_px), skyline.row_px),
        trust=np.where(is_doubted, np.where(is_seen, trust, 0.0), skyline.trust),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """The rows of a picture about the skyline of its photo."""

    pixels: UInt8Array
    """(h, w, 3) uint8."""
    ridge_row: Float64Array
    """(w,) float64. Rows of the skyline in the band."""
    top: int
    """The picture's row where the band begins."""
    left: int
    """The picture's column where it begins."""
    photo_rows: int
    """Rows of the picture without its borders."""
    scale: float
    """Pixels of the picture over pixels of the photo."""

    @classmethod
    def about(cls, skyline: PhotoSkyline, picture: UInt8Array) -> "_Band":
        """Return the band about a skyline."""
        content = content_of(picture)
        photo = content.crop(picture)
        scale = picture.shape[1] / skyline.width_px
        trusted = np.flatnonzero(skyline.trusted)
        column_px = (np.arange(content.left, content.right) + 0.5) / scale - 0.5
        row_px = np.interp(column_px, trusted, skyline.row_px[trusted])
        row = (row_px + 0.5) * scale - 0.5 - content.top
        above = max(0, int(row.min() - _LOOK.above_share * len(photo)))
        below = int(row.max() + _LOOK.below_share * len(photo))
        top = content.top + above
        return cls(photo[above:below], row - above, top, content.left, len(photo), scale)

    def painted(self) -> UInt8Array:
        """Return the band, its ground painted with the colours above the skyline."""
        first = np.floor(self.ridge_row - _LOOK.painted_px).astype(np.intp)
        first = first.clip(0, len(self.pixels) - 1)
        above = self.pixels[first, np.arange(len(first))][np.newaxis]
        window = (_LOOK.smoothed_px, 1)
        colours = cv2.blur(above, window, borderType=cv2.BORDER_REPLICATE)
        is_below = np.arange(len(self.pixels))[:, np.newaxis] >= first
        return np.where(is_below[..., np.newaxis], colours, self.pixels)

    def in_columns(self, values: Float64Array, width_px: int) -> Float64Array:
        """Return values (w,) of the band in the photo's columns; NaN outside."""
        at = (np.arange(width_px) + 0.5) * self.scale - 0.5 - self.left
        within = np.interp(at, np.arange(len(values)), values, left=np.nan, right=np.nan)
        return np.asarray(within)

    def in_photo(self, row: Float64Array) -> Float64Array:
        """Return the photo's rows from rows of the band."""
        return np.asarray((row + self.top + 0.5) / self.scale - 0.5)

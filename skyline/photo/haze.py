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
    """The band that is looked at, and what counts as a farther skyline."""

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
    picture = skyline.picture
    if picture is None or skyline.is_drawn or not skyline.trusted.any():
        return None
    content = content_of(picture)
    photo = content.crop(picture)
    scale = picture.shape[1] / skyline.width_px
    trusted = np.flatnonzero(skyline.trusted)
    columns_px = (np.arange(content.left, content.right) + 0.5) / scale - 0.5
    row_px = np.interp(columns_px, trusted, skyline.row_px[trusted])
    row = (row_px + 0.5) * scale - 0.5 - content.top
    top = max(0, int(row.min() - _LOOK.above_share * len(photo)))
    band = photo[top : int(row.max() + _LOOK.below_share * len(photo))]
    if len(band) < _LOOK.least_px:
        return None
    found = Extraction(_painted(band, row - top), Content.whole(band))
    trust = np.where(row - top - found.row_px > _LOOK.apart_share * len(photo), found.trust, 0.0)
    at = (np.arange(skyline.width_px) + 0.5) * scale - 0.5 - content.left
    inside = (at > -1.0) & (at < len(row))
    nearest = np.rint(at).astype(np.intp).clip(0, len(row) - 1)
    is_doubted = inside & (trust[nearest] > _LOOK.doubted)
    seen = found.skyline(found.row_px, trust)
    is_seen = is_doubted & seen.trusted[nearest]
    if is_seen.mean() < _LOOK.least_share:
        return None
    rows = np.interp(at, np.arange(len(row)), found.row_px) + top + content.top
    known = np.where(is_seen, (rows + 0.5) / scale - 0.5, np.nan)
    return replace(
        skyline,
        row_px=np.where(is_doubted, known, skyline.row_px),
        trust=np.where(is_doubted, np.where(is_seen, trust[nearest], 0.0), skyline.trust),
    )


def _painted(band: UInt8Array, row: Float64Array) -> UInt8Array:
    """Return a band (h, w, 3) with the colours above rows (w,) painted over all below them."""
    first = np.floor(row - _LOOK.painted_px).astype(np.intp).clip(0, len(band) - 1)
    above = band[first, np.arange(len(first))][np.newaxis]
    window = (_LOOK.smoothed_px, 1)
    colours = cv2.blur(above, window, borderType=cv2.BORDER_REPLICATE)
    is_below = np.arange(len(band))[:, np.newaxis] >= first
    return np.where(is_below[..., np.newaxis], colours, band)

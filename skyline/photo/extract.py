"""Photo to query skyline: the likeliest path through the columns, refined along its edge.

A skyline is one border row per column. A path is cheap where a network says that the skyline runs
and where there is an edge, and it is not steep; dynamic programming finds the cheapest exactly. The
path is found at about 0.4 million pixels, then refined to sub-pixel in a narrow band of the full
photo. A column is trusted where the network holds it likely that the skyline runs along the path.
"""

import logging
from dataclasses import dataclass
from math import ceil
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.evidence import Evidence, gather_evidence, to_lab
from skyline.photo.query import QuerySkyline

log = logging.getLogger(__name__)

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

TRUST_THRESHOLD = 0.59
"""Columns of less confidence are masked."""
MIN_TRUSTED_SHARE = 0.1
"""A photo with a smaller share of trusted columns has no skyline."""
_SMOOTHED_PX = 9
"""Working columns over which confidence is averaged."""

STEPS = (8, 0.1, 3.0)
"""Of a path at working size; see `shortest_path`."""
FORBIDDEN = 1e3

_REFINE_STEPS = (2, 0.05, 1.0)
"""Of a path along the edge of the full photo."""
_REFINE_REACH = 1.5
"""Working pixels by which a working path may be off; at least three photo pixels are searched."""


def extract_skyline(image: UInt8Array) -> QuerySkyline:
    """Find the skyline of a photo.

    Uniform borders and caption bars are set aside; columns whose skyline is not clear, lies on
    the photo's edge or is hidden are masked, not guessed. Raises `InputError` for an image that is
    not (H, W, 3) uint8 RGB, too small, or without a skyline.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise InputError(
            f"image has shape {image.shape} and type {image.dtype}; expected (H, W, 3) uint8 RGB"
        )
    extraction = Extraction.of(image)
    query = extraction.query(extraction.row_px, extraction.confidence)
    content = extraction.content
    share = float(query.trusted[content.left : content.right].mean())
    log.debug("skyline trusted in %.0f %% of the columns", 100.0 * share)
    if share < MIN_TRUSTED_SHARE:
        raise InputError(
            f"no skyline found: {100.0 * share:.0f} % of the columns show a clear border between "
            f"sky and ground, expected at least {100.0 * MIN_TRUSTED_SHARE:.0f} %; draw it as a "
            "trace (CSV column_px,row_px) or a mask (PNG, white = sky)"
        )
    return query


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


@dataclass(frozen=True, slots=True, eq=False)
class Extraction:
    """A photo's skyline with what it was found from, so that it can be found again."""

    shape: tuple[int, int]
    """Height and width of the image."""
    content: Content
    """What of the image is photo."""
    photo: UInt8Array
    """(H, W, 3) uint8. That part."""
    evidence: Evidence
    path: IntArray
    """(w,) intp. The path found at working size."""
    row_px: Float64Array
    confidence: Float64Array
    """``row_px``, ``confidence``: (W,) float64. Of the photo's columns, whether trusted or not."""

    @classmethod
    def of(cls, image: UInt8Array) -> Self:
        """Find the skyline of an image (H, W, 3) uint8; raises as `content_of`."""
        content = content_of(image)
        photo = content.crop(image)
        evidence = gather_evidence(photo)
        path = shortest_path(evidence.cost, *STEPS)
        row_px, confidence = on_photo(photo, evidence, path)
        height, width = image.shape[:2]
        return cls((height, width), content, photo, evidence, path, row_px, confidence)

    def query(self, row_px: Float64Array, confidence: Float64Array) -> QuerySkyline:
        """Return rows of the photo's columns as a query of the image, doubtful ones masked."""
        trusted_px = np.where(confidence >= TRUST_THRESHOLD, row_px, np.nan)
        return self.content.skyline(trusted_px, confidence, self.shape)


def on_photo(
    photo: UInt8Array, evidence: Evidence, path: IntArray, columns: slice = slice(None)
) -> tuple[Float64Array, Float64Array]:
    """Return the rows of a working path, refined on the photo, and the confidence in them, 0 to 1.

    Both are of some of the photo's columns.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415  (slow to load)

    at_work, whole = to_work_columns(photo.shape[1], evidence)[columns], np.arange(len(path))
    row = (np.interp(at_work, whole, path) + 0.5) / evidence.row_scale - 0.5
    sure = evidence.confidence(path)
    smooth = uniform_filter1d(sure, _SMOOTHED_PX, mode="nearest")
    smooth = np.minimum(smooth, np.where(sure > 0.0, 1.0, 0.0))
    refined = _refined(photo[:, columns], row, evidence.row_scale)
    return refined, np.interp(at_work, whole, smooth)


def to_work_columns(width: int, evidence: Evidence) -> Float64Array:
    """Return where each photo column's centre lies at working size."""
    at_work = (np.arange(width) + 0.5) * evidence.cost.shape[1] / width - 0.5
    return np.asarray(at_work, dtype=np.float64)


def _refined(photo: UInt8Array, row: Float64Array, scale: float) -> Float64Array:
    """Return the rows of the steepest change near a path, to sub-pixel.

    Within a band around the path a second shortest path follows the greatest difference between
    the two pixels above and the two below a border; a parabola through the three differences
    around it gives the fraction.
    """
    height, width = photo.shape[:2]
    reach = max(3, ceil(_REFINE_REACH / scale))
    centre = np.round(row).astype(np.intp)
    # Borders r - 0.5 for r = centre - reach ... centre + reach need two more rows either side.
    rows = centre + np.arange(-reach - 2, reach + 2)[:, np.newaxis]
    lab = to_lab(photo[np.clip(rows, 0, height - 1), np.arange(width)])
    below, above = lab[2:-1] + lab[3:], lab[:-3] + lab[1:-2]
    step = np.linalg.norm(below - above, axis=2) / 2.0
    strength = step / (step.max(axis=0) + 1.0)
    best = shortest_path((-strength).astype(np.float32), *_REFINE_STEPS)
    columns = np.arange(width)
    inner = np.clip(best, 1, len(step) - 2)
    before, at, after = (step[inner + k, columns] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    peaked = bend < 0.0
    shift = np.where(peaked, 0.5 * (before - after) / np.where(peaked, bend, 1.0), 0.0)
    return np.asarray(centre - reach + inner - 0.5 + np.clip(shift, -0.5, 0.5), dtype=np.float64)


def shortest_path(
    cost: Float32Array, reach: int, price_per_row: float, jump_price: float
) -> IntArray:
    """Return the cheapest path's row in each column, (W,) intp, for costs (H, W) float32.

    A step of up to ``reach`` rows costs a price for each, and one of any size, at a cliff, a trunk
    or the edge of an occluder, ``jump_price``.
    """
    n_rows, n_columns = cost.shape
    offsets = np.arange(-reach, reach + 1)
    step_price = (price_per_row * np.abs(offsets)).astype(np.float32)
    rows = np.arange(n_rows)
    best = cost[:, 0]
    arrived_from = np.zeros((n_columns, n_rows), dtype=np.int32)
    padded = np.full(n_rows + 2 * reach, np.inf, dtype=np.float32)
    reachable = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    for column in range(1, n_columns):
        padded[reach : reach + n_rows] = best
        candidates = reachable + step_price
        choice = np.argmin(candidates, axis=1)
        stepped = candidates[rows, choice]
        start = int(np.argmin(best))
        jumped = best[start] + np.float32(jump_price)
        best = cost[:, column] + np.minimum(stepped, jumped)
        arrived_from[column] = np.where(stepped <= jumped, rows + offsets[choice], start)
    row = np.empty(n_columns, dtype=np.intp)
    row[-1] = int(np.argmin(best))
    for column in range(n_columns - 1, 0, -1):
        row[column - 1] = arrived_from[column, row[column]]
    return row


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

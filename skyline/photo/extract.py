"""Photo to query skyline: the likeliest path through the columns, refined along its edge.

A skyline is one border row per column. A network gives the odds of the border in every pixel
(``sky.onnx.gz``; ``python -m skyline_training sky-model``). Its encoder was trained on real
photographs (ImageNet), and then all of it on drawn mountains, clouds, trees and windows. A path is
cheap where the network expects the skyline and where there is an edge, and if it is not steep;
dynamic programming finds the cheapest path exactly, at about 0.4 million pixels (up to 1 of a
panorama). It is then refined to sub-pixel in a narrow band of the full photo. A column is trusted
if the network gives a high probability that the skyline runs along the path.
"""

import gzip
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from math import ceil, log, sqrt
from threading import Lock
from typing import Self

import cv2
import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.skyline import PhotoSkyline

_MIN_CONTENT_PX = 32
"""Smallest width and height in which a skyline is looked for."""
_MAX_ASPECT = 30.0
"""Longest side over shortest; a low panorama of a full turn has about 12."""

_COLOUR_TOLERANCE = 10
"""Greatest difference per channel within a uniform border; JPEG rings by a few levels."""
_BAR_SHARE = 0.6
"""Share of a row that must have the bar's colour; the rest may be its caption."""
_EDGE_SHARE = 0.9
"""Share of the first row of content, without the borders at its ends, that must differ from the
bar: bars end in a straight line."""
_BAR_BLUR_PX = 3
"""Rows beyond a bar that resizing and JPEG mix with it."""
_MAX_BAR_SHARE = 0.3
"""Tallest bar, as a share of the image."""
_SAMPLES = 500
"""Least number of pixels sampled from a row; shorter rows are read whole."""

TRUST_THRESHOLD = 0.7
"""Columns of lower trust are masked; `skyline-bench sky-masks` measures how many are, and how
many of the others are right."""
_MIN_TRUSTED_SHARE = 0.1
"""A photo with a smaller share of trusted columns has no skyline."""
_SMOOTHED_PX = 9
"""Working columns over which trust is averaged."""

STEPS = (8, 0.1, 3.0)
"""Arguments ``reach``, ``price_per_row`` and ``jump_price`` of `shortest_path` at working size."""
FORBIDDEN = 1e3
"""Cost of a pixel that the skyline must not cross."""

_REFINE_STEPS = (2, 0.05, 1.0)
"""The same arguments along the edge in the full photo."""
_REFINE_REACH = 1.5
"""Largest error of a working path, in working pixels; at least three photo pixels are searched."""

_NETWORK_PIXELS = 230_000
"""Size of the network's input for photos of 3 to 2."""
_ASPECT_SCALE = (0.7, 2.6)
"""Least and greatest factor on it for other aspects: a panorama must be seen as tall as a photo,
and an upright photo as finely as one that lies."""
_LEAST_PIXELS = 110_000
"""Smaller photos are enlarged to this size, others never."""
_MULTIPLE_PX = 32
"""The sides of the network's input are multiples of this."""
_WORK_PIXELS = 400_000
"""Working size of photos, at which their edges and the path along them are found. It grows with the
aspect of panoramas as the network's input does."""

_LEVELS = (1.0, 99.0)
"""Percentiles of a channel that become its darkest and its brightest value."""

_LEAST_LOG_SHARE = -10.0
"""Floor of the log-probability, or the network would decide alone in scenes unknown to it."""
_EDGE_REACH_SHARE = 0.02
"""Neighbourhood up and down, as a share of all rows, whose sharpest edge counts fully."""
_FULL_SHARE = 0.5
"""An edge with at least this share of the sharpest edge's strength counts fully too: rock against
sky must not lose to snow against rock."""
_EDGE_FLOOR = 3.0
"""L*a*b* difference, typical of JPEG and noise, that halves an edge."""
_SAME_SHARE = 0.01
"""Two rows nearer than this share of all rows count as the same skyline."""

_CRESTS = 3
"""Crests of a column that may be its skyline."""
_LEAST_PROBABILITY = 0.1
"""Less likely crests are none."""
_APART_SHARE = 0.03
"""Least distance between two crests, as a share of all rows."""

_network_lock = Lock()


def extract_skyline(image: UInt8Array) -> PhotoSkyline:
    """Find the skyline of a photo (H, W, 3) uint8 RGB.

    Uniform borders and caption bars are cut off. Columns whose skyline is unclear, on the photo's
    edge or hidden are masked, not guessed. Raises `InputError` if the image is too small, a sliver,
    or shows no skyline.
    """
    extraction = Extraction.of(image)
    query = extraction.query(extraction.row_px, extraction.trust)
    content = extraction.content
    share = float(query.trusted[content.left : content.right].mean())
    if share < _MIN_TRUSTED_SHARE:
        raise InputError(
            f"no skyline found: {100.0 * share:.0f} % of the columns show a clear border between "
            f"sky and ground, expected at least {100.0 * _MIN_TRUSTED_SHARE:.0f} %; draw it as a "
            "trace (CSV column_px,row_px) or a mask (PNG, sky pure white, ground black)"
        )
    return query


@dataclass(frozen=True, slots=True)
class Content:
    """The part of an image (``height``, ``width``) inside its borders: half-open ranges."""

    height: int
    width: int
    top: int
    bottom: int
    left: int
    right: int

    def crop(self, image: UInt8Array) -> UInt8Array:
        """Return the photo inside its borders as a view of the image."""
        return image[self.top : self.bottom, self.left : self.right]

    def skyline(
        self, row_px: Float64Array, trust: Float64Array, crests: Float64Array | None = None
    ) -> PhotoSkyline:
        """Return the skyline of the image from the rows (w,) and crests (3, w) of its photo.

        Columns without a row (NaN) and columns beside the photo are masked.
        """
        rows, trusts = np.full(self.width, np.nan), np.zeros(self.width)
        inside = slice(self.left, self.right)
        rows[inside] = row_px + self.top
        trusts[inside] = np.where(np.isfinite(row_px), trust, 0.0)
        whole = None
        if crests is not None:
            whole = np.full((_CRESTS, self.width), np.nan)
            whole[:, inside] = crests + self.top
        return PhotoSkyline(rows, trusts, self.width, self.height, crests=whole)


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The network's probabilities and the path's costs of a photo at working size, (h, w)."""

    share: Float32Array
    """(h, w) float32. Probability that the column's skyline runs through the pixel. The sum over a
    column is the probability that it shows a skyline at all."""
    cost: Float32Array
    """(h, w) float32. Cost of a path through the pixel: a full edge is worth a factor e in
    probability."""

    def trust(self, row: IntArray) -> Float64Array:
        """Return the probability (w,) that the skyline runs along a path (w,)."""
        height, width = self.share.shape
        summed = np.vstack([np.zeros((1, width)), np.cumsum(self.share, axis=0, dtype=np.float64)])
        near = max(2, round(_SAME_SHARE * height))
        columns = np.arange(width)
        above = summed[np.clip(row - near, 0, height), columns]
        inside = summed[np.clip(row + near + 1, 0, height), columns] - above
        # A path along the photo's edge has found the edge, not a skyline.
        return np.where((row <= 1) | (row >= height - 2), 0.0, inside)

    def crests(self) -> Float64Array:
        """Return the rows (3, w) of each column's crests, the likeliest first.

        Crests that are not likely are NaN.
        """
        height, width = self.share.shape
        near, apart = max(2, round(_SAME_SHARE * height)), round(_APART_SHARE * height)
        left, rows = self.share.copy(), np.arange(height)[:, np.newaxis]
        left[:2] = left[-2:] = 0.0
        found = np.full((_CRESTS, width), np.nan)
        for rank in range(_CRESTS):
            row = cv2.GaussianBlur(left, (1, 2 * near + 1), 0).argmax(axis=0)
            likely = np.where(np.abs(rows - row) <= near, left, 0.0).sum(axis=0)
            found[rank] = np.where(likely >= _LEAST_PROBABILITY, row, np.nan)
            left[np.abs(rows - row) <= apart] = 0.0
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Extraction:
    """A photo's skyline with the evidence and the path from which it was found."""

    content: Content
    """The part of the image that is photo."""
    photo: UInt8Array
    """(H, W, 3) uint8. The pixels of that part."""
    evidence: Evidence
    path: IntArray
    """(w,) intp. The cheapest path at working size."""
    row_px: Float64Array
    trust: Float64Array
    """``row_px``, ``trust``: (W,) float64. Row and trust of every column of the photo,
    trusted or not."""

    @classmethod
    def of(cls, image: UInt8Array) -> Self:
        """Find the skyline of an image (H, W, 3) uint8; raises as `content_of`."""
        content = content_of(image)
        photo = content.crop(image)
        evidence = gather_evidence(photo)
        path = shortest_path(evidence.cost, *STEPS)
        row_px, trust = on_photo(photo, evidence, path)
        return cls(content, photo, evidence, path, row_px, trust)

    def query(self, row_px: Float64Array, trust: Float64Array) -> PhotoSkyline:
        """Return rows of the photo's columns as a query of the image, with doubtful ones masked."""
        trusted_px = np.where(trust >= TRUST_THRESHOLD, row_px, np.nan)
        scale = len(self.evidence.cost) / len(self.photo)
        crests = (self.evidence.crests() + 0.5) / scale - 0.5
        at = np.rint(to_work_columns(self.photo.shape[1], self.evidence)).astype(np.intp)
        return self.content.skyline(trusted_px, trust, crests[:, at])


def on_photo(
    photo: UInt8Array, evidence: Evidence, path: IntArray, columns: slice = slice(None)
) -> tuple[Float64Array, Float64Array]:
    """Return the rows of a working path, refined on the photo, and their trust, 0 to 1.

    Both arrays cover the given columns of the photo.
    """
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415  (slow to load)

    at_work, whole = to_work_columns(photo.shape[1], evidence)[columns], np.arange(len(path))
    scale = len(evidence.cost) / len(photo)
    row = (np.interp(at_work, whole, path) + 0.5) / scale - 0.5
    sure = evidence.trust(path)
    smooth = uniform_filter1d(sure, _SMOOTHED_PX, mode="nearest")
    smooth = np.minimum(smooth, np.where(sure > 0.0, 1.0, 0.0))
    refined = _refined(photo[:, columns], row, scale)
    return refined, np.interp(at_work, whole, smooth)


def to_work_columns(width: int, evidence: Evidence) -> Float64Array:
    """Return the position at working size of each photo column's centre."""
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

    A step of up to ``reach`` rows costs ``price_per_row`` for each row; a step of any size, as at a
    cliff, a trunk or the edge of an occluder, costs ``jump_price``.
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
    and dark ground are uniform too, but they end in a skyline. Raises `InputError` if less than
    32 x 32 pixels of the image (H, W, 3) uint8 remain, or if it is a sliver.
    """
    height, width = image.shape[:2]
    if max(height, width) > _MAX_ASPECT * min(height, width):
        raise InputError(
            f"the image has {width} x {height} px; expected a photo or a panorama, sides of at "
            f"most 1 to {_MAX_ASPECT:g}"
        )
    top = _bar_length(image)
    bottom = len(image) - _bar_length(image[::-1])
    sideways = image[top:bottom].transpose(1, 0, 2)
    left = _bar_length(sideways)
    right = len(sideways) - _bar_length(sideways[::-1])
    content = Content(height, width, top, bottom, left, right)
    if min(bottom - top, right - left) < _MIN_CONTENT_PX:
        raise InputError(
            f"the photo has {width} x {height} px, {max(right - left, 0)} x "
            f"{max(bottom - top, 0)} within its borders; expected at least {_MIN_CONTENT_PX} x "
            f"{_MIN_CONTENT_PX}: use a larger photo"
        )
    return content


def _bar_length(image: UInt8Array) -> int:
    """Return the number of rows at the start of the image that form a bar."""
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

    Borders of that colour at the row's ends are ignored, as long as most of the row remains.
    """
    differs = np.flatnonzero(~_alike(row, colour))
    if differs.size < _BAR_SHARE * len(row):
        return False
    return bool(differs.size >= _EDGE_SHARE * (differs[-1] + 1 - differs[0]))


def _alike(pixels: UInt8Array, colour: Float64Array) -> BoolArray:
    """Return which pixels (N, 3) have a colour, within the tolerance."""
    return np.asarray(np.abs(pixels - colour).max(axis=-1) <= _COLOUR_TOLERANCE)


def gather_evidence(photo: UInt8Array) -> Evidence:
    """Reduce a photo (H, W, 3) uint8 RGB to working size and collect the evidence for a skyline."""
    height, width = photo.shape[:2]
    wanted = _WORK_PIXELS * max(1.0, _aspect_scale(height, width))
    shrink = min(1.0, sqrt(wanted / (height * width)))
    h, w = max(1, round(height * shrink)), max(1, round(width * shrink))
    small = np.asarray(cv2.resize(photo, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
    odds = _network_odds(small)
    # Odds of no skyline, relative to a row of the enlarged picture.
    none = log(h / len(odds))
    odds = np.asarray(cv2.resize(odds, (w, h), interpolation=cv2.INTER_LINEAR), np.float32)
    greatest = np.maximum(odds.max(axis=0), none)
    share = np.exp(odds - greatest)
    share /= share.sum(axis=0) + np.exp(none - greatest)
    likely = np.maximum(np.log(share + np.float32(1e-12)), _LEAST_LOG_SHARE)
    cost = -likely - _edges(to_lab(small))
    return Evidence(share, np.asarray(cost, dtype=np.float32))


def to_lab(rgb: UInt8Array) -> Float32Array:
    """Convert (..., 3) uint8 RGB, three axes, to float32 CIE L*a*b*."""
    scaled = np.ascontiguousarray(rgb, dtype=np.float32) / np.float32(255.0)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), dtype=np.float32)


@lru_cache(maxsize=1)
def _network() -> cv2.dnn.Net:
    packed = files("skyline.photo").joinpath("sky.onnx.gz").read_bytes()
    return cv2.dnn.readNetFromONNX(np.frombuffer(gzip.decompress(packed), dtype=np.uint8))


def levelled(rgb: UInt8Array) -> Float32Array:
    """Return (H, W, 3) from -1 to 1, each channel scaled to its own range, which removes a tint."""
    low, high = np.percentile(rgb.reshape(-1, 3), _LEVELS, axis=0).astype(np.float32)
    share = (rgb - low) / np.maximum(high - low, np.float32(1.0))
    return np.asarray(2.0 * np.clip(share, 0.0, 1.0) - 1.0, dtype=np.float32)


def _aspect_scale(height: int, width: int) -> float:
    return float(np.clip(max(width / height, height / width) / 1.5, *_ASPECT_SCALE))


def _network_odds(photo: UInt8Array) -> Float32Array:
    """Return log-odds (h', w') of a column's skyline in each pixel against no skyline."""
    height, width = photo.shape[:2]
    wanted = _NETWORK_PIXELS * _aspect_scale(height, width)
    shrink = sqrt(min(wanted, max(height * width, _LEAST_PIXELS)) / (height * width))
    h, w = (max(1, round(side * shrink / _MULTIPLE_PX)) * _MULTIPLE_PX for side in (height, width))
    small = np.asarray(cv2.resize(photo, (w, h), interpolation=cv2.INTER_AREA), np.uint8)
    picture = np.empty((1, 4, h, w), dtype=np.float32)
    picture[0, :3] = levelled(small).transpose(2, 0, 1)
    picture[0, 3] = np.linspace(-1.0, 1.0, h, dtype=np.float32)[:, np.newaxis]
    with _network_lock:
        _network().setInput(picture)
        scores = _network().forward()
    return np.asarray(scores[0, 0], dtype=np.float32)


def _edges(lab: Float32Array) -> Float32Array:
    """Return edges (h, w), 0 where smooth and 1 on nearly the sharpest edge up and down from it."""
    across = cv2.Sobel(lab, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    down = cv2.Sobel(lab, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    steepness = np.sqrt((across**2 + down**2).sum(axis=2))
    reach = max(2, round(_EDGE_REACH_SHARE * len(lab)))
    sharpest = cv2.dilate(steepness, np.ones((2 * reach + 1, 1), dtype=np.uint8))
    edges = steepness / (_FULL_SHARE * sharpest + _EDGE_FLOOR)
    return np.asarray(np.minimum(edges, 1.0), dtype=np.float32)

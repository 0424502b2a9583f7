"""From a photo to its skyline: the likeliest path through the columns.

A skyline is one border row per column. A network gives the odds of the border in every pixel. A
path is cheap if it runs where the network expects the skyline and along an edge, and is not steep;
dynamic programming finds the cheapest path exactly, in a picture reduced to about 0.4 million
pixels (up to 1 million for a panorama). The path is then refined to sub-pixel in a narrow band of
the full photo. A column is trusted if the network gives a high probability that the skyline runs
along the path.

A person corrects the skyline by strokes of a brush. A stroke marks pixels as sky or as ground; the
skyline is then the cheapest path that respects the marks. A drawn line is the skyline itself.
Columns that no stroke changes keep the skyline found first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, log, sqrt

import cv2
import numpy as np

from skyline.arrays import Float32Array, Float64Array, IntArray, UInt8Array
from skyline.errors import InputError
from skyline.photo.borders import Content, content_of
from skyline.photo.cheapest_path import Steps, cheapest_path
from skyline.photo.photo import Photo
from skyline.photo.sky_mask import is_sky_mask, skyline_of_mask
from skyline.photo.sky_network import aspect_scale, network_odds
from skyline.photo.skyline import PhotoSkyline, check_of_image
from skyline.photo.strokes import Stroke, StrokeKind, forbidden, painted


@dataclass(frozen=True, slots=True)
class _Search:
    """The search for a path, and its refinement on the photo."""

    pixels: int = 400_000
    """Working size of photos. It grows with the aspect of panoramas as the network's input does."""
    forbidden_cost: float = 1e3
    """Cost of a pixel that the skyline must not cross."""
    least_log_share: float = -10.0
    """Floor of the log-probability: without it, the network alone would decide in scenes that are
    unknown to it."""
    edge_reach_share: float = 0.02
    """Neighbourhood up and down, as a share of all rows, whose sharpest edge counts fully."""
    full_edge_share: float = 0.5
    """An edge with at least this share of the sharpest edge's strength counts fully too: rock
    against sky must not lose to snow against rock."""
    edge_floor: float = 3.0
    """L*a*b* difference, typical of JPEG and noise, that halves an edge."""
    refined_reach: float = 1.5
    """Largest error of a working path, in working pixels; at least three photo pixels are
    searched."""


@dataclass(frozen=True, slots=True)
class _Trust:
    """Which columns are trusted, and what else may be their skyline."""

    least: float = 0.7
    """Columns of lower trust are masked; `skyline-bench sky-masks` measures how many these are, and
    how many of the others are right."""
    least_share: float = 0.1
    """A photo with a smaller share of trusted columns has no skyline."""
    smoothed_px: int = 9
    """Working columns over which trust is averaged."""
    same_share: float = 0.01
    """Two rows nearer than this share of all rows count as the same skyline."""
    crests: int = 3
    """Most crests of a column that may be its skyline."""
    least_probability: float = 0.1
    """A row of lower probability is not a crest."""
    apart_share: float = 0.03
    """Least distance between two crests, as a share of all rows."""


_SEARCH = _Search()
_STEPS = Steps(reach=8, row_price=0.1, jump_price=3.0)
"""The steps of the path at working size."""
_REFINED_STEPS = Steps(reach=2, row_price=0.05, jump_price=1.0)
"""The steps of the path along the edge in the full photo."""
_TRUST = _Trust()
_BESIDE_PX = 64
"""Columns on each side of changed ones that are refined again with them."""


def extract_skyline(image: UInt8Array) -> PhotoSkyline:
    """Find the skyline of a photo (H, W, 3) uint8 RGB.

    Uniform borders and caption bars are cut off. Columns whose skyline is unclear, on the photo's
    edge or hidden are masked, not guessed. Raises `InputError` if the image is too small, a sliver,
    or shows no skyline.
    """
    found = Extraction(image)
    skyline = found.skyline(found.row_px, found.trust)
    share = float(skyline.trusted[found.content.left : found.content.right].mean())
    if share < _TRUST.least_share:
        raise InputError(
            f"no skyline found: {100.0 * share:.0f} % of the columns show a clear border between "
            f"sky and ground, expected at least {100.0 * _TRUST.least_share:.0f} %; draw it as a "
            "trace (CSV column_px,row_px) or a mask (PNG, sky pure white, ground black)"
        )
    return skyline


class Correction:
    """A photo whose skyline is found again after each stroke.

    Parameters
    ----------
    photo : Photo
    beside_px : int
        Columns to either side of a stroke that are refined again with its own columns.

    Raises
    ------
    InputError
        The photo is too small or a sliver.
    """

    def __init__(self, photo: Photo, beside_px: int = _BESIDE_PX) -> None:
        self._photo = photo
        self._beside_px = beside_px
        self._extraction = Extraction(photo.rgb)
        self._mask = skyline_of_mask(photo.rgb) if is_sky_mask(photo.rgb) else None

    def solve(
        self, strokes: Sequence[Stroke] = (), start: PhotoSkyline | None = None
    ) -> PhotoSkyline:
        """Return the skyline under the given strokes; later ones override earlier ones.

        ``start`` is the skyline to which the strokes are applied, for example a trace. By default
        it is extracted from the photo, or is the border of a sky mask. The result may have no
        trusted column. Its field of view and projection are the photo's.

        Raises `InputError` if ``start`` belongs to an image of another size.
        """
        given = self._mask if start is None else start
        content = self._extraction.content
        if given is None:
            row_px = self._extraction.row_px.copy()
            trust = self._extraction.trust.copy()
        else:
            check_of_image(given, (content.height_px, content.width_px))
            row_px = given.row_px[content.left : content.right] - content.top
            trust = given.trust[content.left : content.right].copy()
        inside = [stroke.in_crop(content.left, content.top) for stroke in strokes]
        self._find_again(inside, row_px, trust)
        for stroke in inside:
            self._apply(stroke, row_px, trust)
        skyline = self._extraction.skyline(row_px, np.where(np.isfinite(row_px), trust, 0.0))
        if given is not None:
            # A mask or a trace may have rows in the borders beside the photo; they are kept.
            beside = np.ones(skyline.width_px, dtype=bool)
            beside[content.left : content.right] = False
            skyline = replace(
                skyline,
                row_px=np.where(beside, given.row_px, skyline.row_px),
                trust=np.where(beside, given.trust, skyline.trust),
            )
        is_drawn = bool(strokes) or start is not None
        return replace(self._photo.described(skyline), is_drawn=is_drawn)

    def _find_again(
        self, strokes: Sequence[Stroke], row_px: Float64Array, trust: Float64Array
    ) -> None:
        """Update rows and trust of the columns that painted pixels change."""
        extraction = self._extraction
        labels = painted(strokes, extraction.photo.shape[:2], extraction.cost.shape)
        if not labels.any():
            return
        cost = np.where(
            forbidden(labels), extraction.cost + np.float32(_SEARCH.forbidden_cost), extraction.cost
        )
        path = cheapest_path(cost, _STEPS)
        changed = (path != extraction.path) | (labels != 0).any(axis=0)
        columns = np.flatnonzero(changed[extraction.nearest_work_columns()])
        around = slice(max(columns[0] - self._beside_px, 0), columns[-1] + self._beside_px + 1)
        found_px, found_trust = extraction.on_photo(path, around)
        row_px[columns] = found_px[columns - around.start]
        trust[columns] = found_trust[columns - around.start]

    def _apply(self, stroke: Stroke, row_px: Float64Array, trust: Float64Array) -> None:
        """Update the rows and the trust of the columns under a stroke."""
        height, width = self._extraction.photo.shape[:2]
        columns = stroke.columns(width)
        if stroke.kind is StrokeKind.LINE:
            row_px[columns] = np.clip(stroke.rows_at(columns), -0.5, height - 0.5)
            trust[columns] = 1.0
        elif stroke.kind is StrokeKind.ERASE:
            trust[columns] = 0.0
        else:
            touched = columns[np.isfinite(row_px[columns])]
            # A person has looked at these columns.
            trust[touched] = np.maximum(trust[touched], _TRUST.least)


class Extraction:
    """A photo's skyline, and the probabilities and costs that led to it.

    Attributes
    ----------
    content : Content
        The part of the image that is photo.
    photo : (H, W, 3) uint8
        The pixels of that part.
    share : (h, w) float32
        At working size, the probability that the column's skyline runs through the pixel. Its sum
        over a column is the probability that the column shows a skyline at all.
    cost : (h, w) float32
        Cost of a path through the pixel: a full edge is worth a factor e in probability.
    path : (w,) intp
        The cheapest path at working size.
    row_px, trust : (W,) float64
        Row and trust of every column of the photo, trusted or not.
    """

    def __init__(self, image: UInt8Array, content: Content | None = None) -> None:
        """Find the skyline in an image's content; by default without borders."""
        self.content = content_of(image) if content is None else content
        self.photo = self.content.crop(image)
        small = _at_working_size(self.photo)
        self.share = _skyline_share(small)
        likely = np.maximum(np.log(self.share + np.float32(1e-12)), _SEARCH.least_log_share)
        self.cost = np.asarray(-likely - _edges(_lab_of(small)), dtype=np.float32)
        self.path = cheapest_path(self.cost, _STEPS)
        self.row_px, self.trust = self.on_photo(self.path)
        crests = (crests_of(self.share) + 0.5) / self._scale - 0.5
        self._crests = crests[:, self.nearest_work_columns()]

    @property
    def _scale(self) -> float:
        """Rows at working size over rows of the photo."""
        return len(self.cost) / len(self.photo)

    def _work_columns(self) -> Float64Array:
        """Return the position at working size of each photo column's centre."""
        width = self.photo.shape[1]
        at_work = (np.arange(width) + 0.5) * self.cost.shape[1] / width - 0.5
        return np.asarray(at_work, dtype=np.float64)

    def nearest_work_columns(self) -> IntArray:
        """Return the working column that is nearest to each photo column, (W,)."""
        nearest = np.rint(self._work_columns()).astype(np.intp)
        return nearest.clip(0, self.cost.shape[1] - 1)

    def on_photo(
        self, path: IntArray, columns: slice = slice(None)
    ) -> tuple[Float64Array, Float64Array]:
        """Return the rows of a working path, refined, and their trust.

        Both arrays cover the given columns of the photo.
        """
        at_work = self._work_columns()[columns]
        whole = np.arange(len(path))
        row = (np.interp(at_work, whole, path) + 0.5) / self._scale - 0.5
        sure = _trust_along(self.share, path)
        window = (1, _TRUST.smoothed_px)
        smooth = cv2.blur(sure[:, np.newaxis], window, borderType=cv2.BORDER_REPLICATE)[:, 0]
        smooth = np.minimum(smooth, np.where(sure > 0.0, 1.0, 0.0))
        refined = _refined(self.photo[:, columns], row, self._scale)
        return refined, np.interp(at_work, whole, smooth)

    def skyline(self, row_px: Float64Array, trust: Float64Array) -> PhotoSkyline:
        """Return the image's skyline, without columns whose trust is too low."""
        trusted_px = np.where(trust >= _TRUST.least, row_px, np.nan)
        return self.content.skyline(trusted_px, trust, self._crests)


def _at_working_size(photo: UInt8Array) -> UInt8Array:
    height, width = photo.shape[:2]
    wanted = _SEARCH.pixels * max(1.0, aspect_scale(height, width))
    shrink = min(1.0, sqrt(wanted / (height * width)))
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    return np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)


def _skyline_share(small: UInt8Array) -> Float32Array:
    """Return the probability (h, w) that the skyline runs through each pixel."""
    height, width = small.shape[:2]
    odds = network_odds(small)
    # Odds of no skyline, relative to a row of the enlarged picture.
    none = log(height / len(odds))
    odds = np.asarray(cv2.resize(odds, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
    greatest = np.maximum(odds.max(axis=0), none)
    share = np.exp(odds - greatest)
    return np.asarray(share / (share.sum(axis=0) + np.exp(none - greatest)), dtype=np.float32)


def _lab_of(rgb: UInt8Array) -> Float32Array:
    """Convert (..., 3) uint8 RGB, three axes, to float32 CIE L*a*b*."""
    scaled = np.ascontiguousarray(rgb, dtype=np.float32) / np.float32(255.0)
    return np.asarray(cv2.cvtColor(scaled, cv2.COLOR_RGB2LAB), dtype=np.float32)


def _edges(lab: Float32Array) -> Float32Array:
    """Return edges (h, w): 0 where smooth, 1 on the sharpest edges.

    An edge is sharp if none above or below it is much sharper.
    """
    across = cv2.Sobel(lab, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    down = cv2.Sobel(lab, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    steepness = np.sqrt((across**2 + down**2).sum(axis=2))
    reach = max(2, round(_SEARCH.edge_reach_share * len(lab)))
    sharpest = cv2.dilate(steepness, np.ones((2 * reach + 1, 1), dtype=np.uint8))
    edges = steepness / (_SEARCH.full_edge_share * sharpest + _SEARCH.edge_floor)
    return np.asarray(np.minimum(edges, 1.0), dtype=np.float32)


def _trust_along(share: Float32Array, path: IntArray) -> Float64Array:
    """Return the probability (w,) that the skyline runs along a path (w,)."""
    height, width = share.shape
    summed = np.vstack([np.zeros((1, width)), np.cumsum(share, axis=0, dtype=np.float64)])
    near = _near_rows(height)
    columns = np.arange(width)
    above = summed[np.clip(path - near, 0, height), columns]
    inside = summed[np.clip(path + near + 1, 0, height), columns] - above
    # A path along the photo's edge has found the edge, not a skyline.
    return np.where((path <= 1) | (path >= height - 2), 0.0, inside)


def crests_of(share: Float32Array) -> Float64Array:
    """Return the rows (3, w) of each column's crests, the likeliest first.

    ``share`` (h, w) is the probability that the skyline runs through a pixel. Crests that are not
    likely are NaN.
    """
    height, width = share.shape
    near = _near_rows(height)
    apart = round(_TRUST.apart_share * height)
    rows = np.arange(height)[:, np.newaxis]
    left = share.copy()
    left[:2] = 0.0
    left[-2:] = 0.0
    found = np.full((_TRUST.crests, width), np.nan)
    for rank in range(_TRUST.crests):
        row = cv2.GaussianBlur(left, (1, 2 * near + 1), 0).argmax(axis=0)
        likely = np.where(np.abs(rows - row) <= near, left, 0.0).sum(axis=0)
        found[rank] = np.where(likely >= _TRUST.least_probability, row, np.nan)
        left[np.abs(rows - row) <= apart] = 0.0
    return found


def _near_rows(height: int) -> int:
    return max(2, round(_TRUST.same_share * height))


def _refined(photo: UInt8Array, row: Float64Array, scale: float) -> Float64Array:
    """Return the rows of the steepest change near a path, to sub-pixel.

    Within a band around the path, a second cheapest path follows the greatest difference between
    the two pixels above and the two below a border; a parabola through the three differences around
    the border gives the fraction.
    """
    height, width = photo.shape[:2]
    reach = max(3, ceil(_SEARCH.refined_reach / scale))
    centre = np.round(row).astype(np.intp)
    # Borders r - 0.5 for r = centre - reach ... centre + reach need two more rows either side.
    rows = centre + np.arange(-reach - 2, reach + 2)[:, np.newaxis]
    lab = _lab_of(photo[np.clip(rows, 0, height - 1), np.arange(width)])
    below = lab[2:-1] + lab[3:]
    above = lab[:-3] + lab[1:-2]
    step = np.linalg.norm(below - above, axis=2) / 2.0
    strength = step / (step.max(axis=0) + 1.0)
    best = cheapest_path((-strength).astype(np.float32), _REFINED_STEPS)
    columns = np.arange(width)
    inner = np.clip(best, 1, len(step) - 2)
    before, at, after = (step[inner + k, columns] for k in (-1, 0, 1))
    bend = before - 2.0 * at + after
    peaked = bend < 0.0
    shift = np.where(peaked, 0.5 * (before - after) / np.where(peaked, bend, 1.0), 0.0)
    return np.asarray(centre - reach + inner - 0.5 + np.clip(shift, -0.5, 0.5), dtype=np.float64)

r"""Contours: ridges below a photo's skyline, as evidence for an answer.

Where a ridge hides ground behind it, a photo has an edge. The terrain model shows such ridges from
a pose, too, below the skyline by which the pose was found. At the right place they lie on edges of
the photo; at a wrong one they do so by chance. To see what chance does in this photo, the ridges
are shifted up and down.

A ridge is cut into pieces. The strength of a piece at a shift is the mean gradient across it,
relative to the gradients around it; noise and texture, which change sign, cancel. A piece may lie
some pixels off, as far as the errors of the pose and of the terrain model allow. Its score u is the
rank of its greatest strength there among those at all shifts, as a normal deviate. With the lengths
l of the pieces, and the root mean square s of the same sum at the other shifts, the ridges lie on
edges by

.. math::

    z = \frac{\sum l u}{s' \sqrt{\sum l^2}}, \quad s' = \max(1, s)

deviations from chance. Long edges that look alike at several ridges, as layers of haze have, raise
s. The log odds of an answer change by

.. math::

    b\,(z - z_0)

within limits: right places have more than :math:`z_0`, wrong ones less.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, Rows, UInt8Array
from skyline.camera.projection import Projection
from skyline.geodesy.earth import Curvature
from skyline.match.solver import TEMPERATURE
from skyline.photo.image import made_smaller
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose import ROUGHLY_WITHIN_M, Pose
from skyline.terrain.heightfield import HeightField
from skyline.terrain.ridges import ridges_around


@dataclass(frozen=True, slots=True)
class _Rules:
    """Rules for pieces of ridges, and for edges on them.

    Pixels are of the photo's shades, about 0.07 degrees. The values were set before they were
    measured.
    """

    longer_side_px: int = 800
    """Longer side of the shades: a pixel of 0.07 degrees is 10 m at 8 km, about the height error of
    ridges there."""
    profile_step_px: int = 2
    """Columns from one profile of the terrain to the next."""
    linked_px: float = 4.0
    """Greatest change of a ridge's row from profile to profile."""
    linked_ratio: float = 1.25
    """Greatest ratio of a ridge's distances from profile to profile."""
    least_points: int = 4
    """Least number of points of a ridge."""
    smooth_profiles: float = 1.5
    """Standard deviation, in profiles, over which a ridge is smoothed along itself."""
    piece_deg: tuple[float, float] = (1.2, 3.0)
    """Least and greatest length of a piece."""
    below_share: float = 0.012
    """Ground counts from this share of the longer side below the skyline: a wrong place whose
    skyline fits has the edges next to it, too."""
    pose_deg: float = 0.1
    """Error of a direction from a fitted pose."""
    play_errors: float = 1.5
    """Greatest distance of an edge from its piece, in expected errors."""
    most_play_px: int = 6
    """Ridges close to the eye need more, and are left out: some edge always lies within it."""
    most_shift_px: int = 32
    """Greatest shift up or down, which shows what chance does."""
    least_shifts: int = 10
    """Least number of shifts that show what chance does."""
    blur_px: float = 1.2
    """Standard deviation of the blur before gradients are taken."""
    around_px: int = 41
    """Side of the square around a gradient with whose gradients it is compared."""
    faint: float = 0.25
    """Least root mean square of the gradients in such a square, in grey values a pixel; anything
    fainter, such as fog and silhouettes, says nothing."""
    greatest: float = 3.0
    """Greatest gradient, as a multiple of that root mean square: a strong edge counts no more than
    an edge."""
    seen_share: float = 0.7
    """Least share of a piece that lies on ground that counts."""


@dataclass(frozen=True, slots=True)
class _Odds:
    """How deviations change the odds of an answer."""

    slope: float = 1.0
    even: float = 1.5
    """``slope``, ``even``: b and z_0, rounded from a logistic fit (docs/method.md)."""
    most: float = math.log(10.0)
    """Greatest change of the log odds: few photographs were fitted to."""


_RULES = _Rules()
_ODDS = _Odds()


@dataclass(frozen=True, slots=True, eq=False)
class _Gradients:
    """Gradients (h, w) of a photo's shades, relative to the gradients around."""

    across: Float32Array
    down: Float32Array
    counts: BoolArray
    """(h, w). Whether a pixel shows ground that counts."""


@dataclass(frozen=True, slots=True, eq=False)
class _Points(Rows):
    """N points of ridges in a photo's shades, by azimuth."""

    azimuth: IntArray
    """(N,). Index of the azimuth."""
    column: Float64Array
    row: Float64Array
    distance_m: Float64Array
    play_px: Float64Array
    """(N,). Greatest distance of an edge from the point."""


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """P pieces of ridges in a photo's shades, with N points."""

    column: Float64Array
    row: Float64Array
    slope_rad: Float64Array
    """(N,). Angle of the ridge in the picture; positive where it falls to the right."""
    begin: IntArray
    """(P,). First point of each piece."""
    play_px: IntArray
    """(P,). Greatest distance of an edge from the piece."""

    @property
    def lengths(self) -> IntArray:
        """Number of points of each piece (P,)."""
        return np.diff(self.begin, append=len(self.column))


def weighed_by_contours(
    candidates: Sequence[Pose], photo: PhotoSkyline, terrain: HeightField, curvature: Curvature
) -> tuple[Pose, ...]:
    """Return a photo's candidates, best first, weighed by its contours.

    The best candidate and those near it are one answer, whose odds change; the others share the
    rest, as before. Nothing changes for a trace or a mask, which have no contours, for a panorama
    and a fisheye, on which this was not measured, and for poses that were not refined.
    """
    best = candidates[0]
    if best.confidence_1km is None or best.confidence is None or not best.refined:
        return tuple(candidates)
    if photo.picture is None or photo.projection is not Projection.PERSPECTIVE:
        return tuple(candidates)
    gradients = _gradients_of(_shades_of(photo.picture), photo)
    # Where areas overlap, poses near the best one may be on another terrain model.
    near = [
        one
        for one in candidates
        if one.area == best.area and one.is_same_answer(best, ROUGHLY_WITHIN_M)
    ]
    factors = [
        _factor(_deviations(_pieces_of(photo, one, terrain, curvature, gradients), gradients))
        for one in near
    ]
    weights = [math.exp((best.cost - one.cost) / TEMPERATURE) for one in near]
    factor = float(np.average(factors, weights=weights))
    before = best.confidence_1km
    after = before * factor / (before * factor + 1.0 - before)
    own = after / before if before > 0.0 else 1.0
    others = (1.0 - after) / (1.0 - before) if before < 1.0 else 1.0
    return tuple(
        one.times_as_sure(own if one.is_same_answer(best, ROUGHLY_WITHIN_M) else others)
        for one in candidates
    )


def _factor(deviations: float | None) -> float:
    """Return the factor by which deviations from chance change odds."""
    if deviations is None:
        return 1.0
    change = _ODDS.slope * (deviations - _ODDS.even)
    return math.exp(min(max(change, -_ODDS.most), _ODDS.most))


def _shades_of(picture: UInt8Array) -> UInt8Array:
    """Return a photo's grey values (h, w)."""
    small = made_smaller(picture, _RULES.longer_side_px)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _gradients_of(shades: UInt8Array, photo: PhotoSkyline) -> _Gradients:
    """Return a photo's gradients, and the ground below its skyline that counts."""
    height, width = shades.shape
    smooth = cv2.GaussianBlur(shades.astype(np.float32), (0, 0), _RULES.blur_px)
    across = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    down = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
    scale = width / photo.width_px
    trusted = np.flatnonzero(photo.trusted)
    row = np.interp(_in_photo(np.arange(width), scale), trusted, photo.row_px[trusted])
    top = _in_shades(row, scale) + _RULES.below_share * max(width, height)
    ground = (np.arange(height)[:, np.newaxis] > top).astype(np.float32)
    power, share = (
        cv2.boxFilter(one, -1, (_RULES.around_px,) * 2, borderType=cv2.BORDER_CONSTANT)
        for one in ((across**2 + down**2) * ground, ground)
    )
    rms = np.sqrt(np.maximum(power, 0.0) / np.maximum(share, 1e-6))
    counts = (ground > 0.0) & (rms >= _RULES.faint)
    unit = np.where(counts, rms, np.inf)
    most = _RULES.greatest
    return _Gradients(
        np.clip(across / unit, -most, most), np.clip(down / unit, -most, most), counts
    )


def _in_photo(px: Float64Array | IntArray, scale: float) -> Float64Array:
    """Return pixels of the photo from pixels of its shades.

    Centres are at whole numbers.
    """
    return np.asarray((px + 0.5) / scale - 0.5, dtype=np.float64)


def _in_shades(px: Float64Array, scale: float) -> Float64Array:
    """Return pixels of the shades from pixels of the photo."""
    return np.asarray((px + 0.5) * scale - 0.5, dtype=np.float64)


def _pieces_of(
    photo: PhotoSkyline,
    pose: Pose,
    terrain: HeightField,
    curvature: Curvature,
    gradients: _Gradients,
) -> _Pieces:
    """Return the pieces of ridges that a pose shows on counted ground."""
    height, width = gradients.counts.shape
    scale = width / photo.width_px
    camera = pose.camera(photo)
    columns_px = _in_photo(np.arange(0, width, _RULES.profile_step_px), scale)
    azimuth_deg, _ = camera.directions(columns_px, photo.height_px / 2.0)
    eye_m = pose.easting_m, pose.northing_m, pose.eye_elevation_m
    ridges = ridges_around(terrain, curvature, eye_m, np.radians(azimuth_deg))
    at_px = camera.pixels(azimuth_deg[ridges.azimuth], ridges.elevation_tan)
    column, row = (_in_shades(px, scale) for px in at_px)
    step_deg = float(np.median(np.abs(np.diff(azimuth_deg))))
    error_deg = np.hypot(_RULES.pose_deg, np.degrees(terrain.height_sd_m / ridges.distance_m))
    play_px = np.ceil(_RULES.play_errors * error_deg * _RULES.profile_step_px / step_deg)
    points = _Points(ridges.azimuth, column, row, ridges.distance_m, play_px)
    points = points[
        (np.abs(column - (width - 1) / 2.0) < width / 2.0)
        & (np.abs(row - (height - 1) / 2.0) < height / 2.0)
        & (play_px <= _RULES.most_play_px)
    ]
    at = (np.rint(px).astype(np.intp) for px in (points.row, points.column))
    return _cut(points[gradients.counts[*at]], step_deg)


def _cut(points: _Points, step_deg: float) -> _Pieces:
    """Return the pieces of ridges along azimuths that are a step apart."""
    least, most = (length / step_deg for length in _RULES.piece_deg)
    parts = [np.zeros((4, 0))]
    for path in _paths(points):
        if len(path) < max(least, _RULES.least_points):
            continue
        along = points[path]
        column, row = _smooth(along.column), _smooth(along.row)
        slope_rad = np.arctan2(np.gradient(row), np.gradient(column))
        whole = np.stack([column, row, slope_rad, along.play_px])
        parts += np.array_split(whole, max(1, round(len(path) / most)), axis=1)
    lengths = [part.shape[1] for part in parts[1:]]
    play_px = [math.ceil(np.median(part[3])) for part in parts[1:]]
    begin = np.cumsum([0, *lengths])[:-1]
    column, row, slope_rad, _ = np.concatenate(parts, axis=1)
    return _Pieces(column, row, slope_rad, begin, np.array(play_px, dtype=np.intp))


def _smooth(px: Float64Array) -> Float64Array:
    """Return rows or columns smoothed along a ridge."""
    size = 2 * math.ceil(4.0 * _RULES.smooth_profiles) + 1
    smooth = cv2.GaussianBlur(
        px[:, np.newaxis],
        (1, size),
        0.0,
        sigmaY=_RULES.smooth_profiles,
        borderType=cv2.BORDER_REPLICATE,
    )
    return np.asarray(smooth[:, 0])


_normal_deviates = np.vectorize(NormalDist().inv_cdf, otypes=[np.float64])
"""The normal deviates of probabilities. SciPy's take a tenth of a second to load."""


def _paths(points: _Points) -> list[IntArray]:
    """Return the points of each ridge from left to right.

    Two points of neighbouring azimuths are linked if each is the nearest to the other.
    """
    starts = np.searchsorted(points.azimuth, np.arange(points.azimuth.max(initial=0) + 2))
    log_m = np.log(points.distance_m)
    path_of = np.arange(len(points))
    for left, middle, right in zip(starts[:-2], starts[1:-1], starts[2:], strict=True):
        if not left < middle < right:
            continue
        apart = np.abs(points.row[middle:right] - points.row[left:middle, np.newaxis])
        farther = np.abs(log_m[middle:right] - log_m[left:middle, np.newaxis])
        apart[farther > math.log(_RULES.linked_ratio)] = np.inf
        after = apart.argmin(axis=1)
        before = apart.argmin(axis=0)
        is_mutual = before[after] == np.arange(middle - left)
        linked = np.flatnonzero(is_mutual & (apart.min(axis=1) <= _RULES.linked_px))
        path_of[middle + after[linked]] = path_of[left + linked]
    order = np.argsort(path_of, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(path_of[order])) + 1)


def _deviations(pieces: _Pieces, gradients: _Gradients) -> float | None:
    """Return how well pieces lie on edges, in deviations from chance.

    None if there are no pieces, or too few shifts to know chance.
    """
    middle = _RULES.most_shift_px
    scores = _scores(_strengths(pieces, gradients), pieces.play_px)
    weight = pieces.lengths * np.isfinite(scores)
    all_weight = weight[middle].sum()
    if all_weight == 0.0:
        return None
    norm = np.sqrt(np.square(weight).sum(axis=1))
    total = (np.nan_to_num(scores) * weight).sum(axis=1) / np.where(norm > 0.0, norm, 1.0)
    is_chance = weight.sum(axis=1) >= 0.5 * all_weight
    is_chance[middle] = False
    if is_chance.sum() < _RULES.least_shifts:
        return None
    return float(total[middle] / max(1.0, np.sqrt(np.mean(np.square(total[is_chance])))))


def _strengths(pieces: _Pieces, gradients: _Gradients) -> Float64Array:
    """Return the strengths of pieces at shifts of -S to S rows.

    They are (2 S + 1, P), and -inf where too little of a piece lies on ground that counts.
    """
    height = len(gradients.counts)
    shift = np.arange(-_RULES.most_shift_px, _RULES.most_shift_px + 1)
    column = np.rint(pieces.column).astype(np.intp)
    row = np.rint(pieces.row + shift[:, np.newaxis]).astype(np.intp)
    inside = (row >= 0) & (row < height)
    row = np.clip(row, 0, height - 1)
    counts = inside & gradients.counts[row, column]
    across, down = gradients.across[row, column], gradients.down[row, column]
    over = down * np.cos(pieces.slope_rad) - across * np.sin(pieces.slope_rad)
    over = np.where(counts, over, 0.0)
    seen = np.add.reduceat(counts.astype(np.float64), pieces.begin, axis=1)
    mean = np.abs(np.add.reduceat(over, pieces.begin, axis=1)) / np.maximum(seen, 1.0)
    return np.where(seen >= _RULES.seen_share * pieces.lengths, mean, -np.inf)


def _scores(strengths: Float64Array, play_px: IntArray) -> Float64Array:
    """Return the pieces' ranks at each shift, (2 S + 1, P).

    The ranks are normal deviates; NaN at shifts that are neither 0 nor used for chance, and for
    pieces whose chance is not known.
    """
    away = np.abs(np.arange(len(strengths)) - _RULES.most_shift_px)
    scores = np.full(strengths.shape, np.nan)
    for piece, play in enumerate(play_px):
        padded = np.pad(strengths[:, piece], play, constant_values=-np.inf)
        best = sliding_window_view(padded, 2 * play + 1).max(axis=1)
        # What may lie on an edge by its own errors is no chance.
        is_chance = (away > 2 * play) & (away <= away[0] - play)
        known = np.flatnonzero(np.isfinite(best) & (is_chance | (away == 0)))
        if away[known].min(initial=1) > 0 or len(known) <= _RULES.least_shifts:
            continue
        ordered = np.sort(best[known])
        rank = sum(np.searchsorted(ordered, best[known], side) for side in ("left", "right"))
        scores[known, piece] = _normal_deviates(0.5 * rank / len(known))
    return scores

"""The paper's matcher (section 3): keypoints, Chamfer, RANSAC affine, distance after warping.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, so
that a stored view ends nowhere. Each query keypoint corresponds to the stored keypoint of a
location with the nearest local skyline; RANSAC finds the affine map that most correspondences
agree on; the score is the rms distance in px between the warped query skyline and the stored
one, taken vertically. The affine map also says where the optical axis went: heading, pitch, roll.
"""

from dataclasses import dataclass, field
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.features import NO_KEYPOINT, local_patches, polyline_vertices
from skyline.matching.alignment import align_curves
from skyline.matching.chamfer import mean_squared_px2, nearest_patches
from skyline.matching.profiles import TANGENT_PER_PX, Profiles
from skyline.matching.query import Attitudes, QueryCurves, QueryRays
from skyline.matching.ranking import Candidate, Fits, select

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.intp]

_CHUNK = 64
"""Locations at a time."""

_LOCAL_BINS = 12
"""How far to either side of a keypoint the points of its local skyline lie that RANSAC is given."""

_VOTE_TURNS = 1.0 / 64.0
_REACH_TURNS = 1.0 / 32.0

_RANSAC_CONFIDENCE = 0.99
_RANSAC_REFINEMENTS = 10


@dataclass(frozen=True, slots=True)
class PaperMatcher:
    """The paper's matcher over whole 360 degree profiles.

    Attributes
    ----------
    attitudes : Attitudes
        Assumed pitches and rolls; the affine map takes up what lies between.
    tolerance_px : float
        Of the query's polyline; best that of the store's.
    max_keypoints : int
        Of the query.
    patch_half_px, patch_step_px : float
        Reach of a local skyline to either side of its keypoint and distance of its samples.
    shortlist : int
        Stored patches a query patch is compared with by Chamfer distance.
    directions : int
        Directions tried at a location: those that most correspondences agree on.
    inlier_px : float
        RANSAC's threshold.
    iterations : int
        RANSAC's most.
    min_inliers : int
        Fewer are no fit; at least 3.
    max_scale : float
        Singular values of the map must lie between 1 / max_scale and max_scale.
    max_turn_deg : float
        Greatest turn of the map in the image.
    min_overlap : float
        Least share of the query's weight that must land on known profile, in (0, 1].
    separation_m : float
        Candidates are at least this far apart.
    """

    attitudes: Attitudes = field(default_factory=Attitudes)
    tolerance_px: float = 1.0
    max_keypoints: int = 64
    patch_half_px: float = 40.0
    patch_step_px: float = 4.0
    shortlist: int = 4
    directions: int = 3
    inlier_px: float = 4.0
    iterations: int = 300
    min_inliers: int = 3
    max_scale: float = 1.25
    max_turn_deg: float = 15.0
    min_overlap: float = 0.8
    separation_m: float = 0.0

    def __post_init__(self) -> None:
        if self.min_inliers < 3:
            raise InputError(
                f"least number of inliers is {self.min_inliers}; an affine map needs at least 3"
            )
        if not 0.0 < self.min_overlap <= 1.0:
            raise InputError(f"least overlap is {self.min_overlap}; expected above 0, at most 1")
        if not self.max_scale >= 1.0:
            raise InputError(f"greatest scale is {self.max_scale}; expected at least 1")

    def rank(self, profiles: Profiles, query: QueryRays, top: int) -> list[Candidate]:
        """Return the best candidates, best first; see `Matcher.rank`."""
        return select(profiles, self.fit(profiles, query), query.fov_deg, top, self.separation_m)

    def fit(self, profiles: Profiles, query: QueryRays) -> Fits:
        """Return the best pose at every location; score in px, infinite where nothing fits."""
        curves = QueryCurves.of(query, self.attitudes, profiles.bins)
        offsets = self._offsets(profiles.bin_px)
        assumed = [
            _Query.of(curves, row, self._keypoints(curves, row), offsets, profiles.bin_px)
            for row in range(len(curves.y))
        ]
        parts = []
        for start in range(0, len(profiles), _CHUNK):
            stored = _Stored.of(profiles, slice(start, start + _CHUNK), offsets)
            fits = Fits.none(len(stored.y_px))
            for query_part in assumed:
                fits = fits.best_with(self._fit_chunk(stored, query_part))
            parts.append(fits)
        return Fits.concatenate(parts)

    def _offsets(self, bin_px: float) -> IntArray:
        """Return the offsets of a patch's samples in bins, symmetric about 0."""
        step = max(1, round(self.patch_step_px / bin_px))
        half = max(1, round(self.patch_half_px / bin_px / step))
        return np.arange(-half, half + 1, dtype=np.intp) * step

    def _keypoints(self, curves: QueryCurves, row: int) -> IntArray:
        """Return the bins of the query's keypoints at one attitude."""
        tolerance = self.tolerance_px * TANGENT_PER_PX
        table = polyline_vertices(curves.y[row : row + 1], tolerance, self.max_keypoints)
        keypoints: IntArray = table[table != NO_KEYPOINT].astype(np.intp)
        return keypoints

    def _fit_chunk(self, stored: "_Stored", query: "_Query") -> Fits:
        """Return the fits of one assumed attitude at a chunk of locations."""
        locations = len(stored.y_px)
        if not stored.bins.shape[1] or not len(query.bins):
            return Fits.none(locations)
        squared = mean_squared_px2(
            query.patches, stored.patches, min_known=3 * query.patches.shape[1] // 4
        )
        nearest, distance = nearest_patches(
            query.patches, stored.patches, squared, stored.step_px, self.shortlist
        )
        raw_shift = np.take_along_axis(stored.bins, nearest, axis=1) - query.bins
        fits, left = Fits.none(locations), np.isfinite(distance)
        for _ in range(self.directions):
            shift, agreeing = agreeing_shifts(raw_shift, left, stored.y_px.shape[1])
            fits = fits.best_with(self._fit_direction(stored, query, shift, agreeing))
            left &= ~agreeing
        return fits

    def _fit_direction(
        self, stored: "_Stored", query: "_Query", shift: IntArray, agreeing: NDArray[np.bool_]
    ) -> Fits:
        """Return the fits of the correspondences that agree on a direction."""
        source, target = _corresponding_points(query, stored, shift)
        used = agreeing[:, :, np.newaxis] & np.isfinite(target[..., 1] + source[..., 1])
        affine = np.stack(
            [
                self._affine(source[used_here], target_here[used_here])
                for target_here, used_here in zip(target, used, strict=True)
            ]
        )
        affine = align_curves(
            affine, query.points_px, query.weight, stored.y_px, stored.bin_px, self.inlier_px
        )
        affine[~self.plausible(affine)] = np.nan
        score = _distance_after_warp_px(affine, query, stored, self.min_overlap)
        return _pose(affine, score, query, stored)

    def _affine(self, source: Float64Array, target: Float64Array) -> Float64Array:
        """Return the (2, 3) map most correspondences agree on, NaN for none.

        OpenCV seeds this RANSAC itself, with a constant: equal input has equal output.
        """
        if len(source) >= self.min_inliers:
            # Keypoints of a low skyline lie nearly on a line, which leaves an affine map's
            # action across it open; a similarity is then what they can tell.
            for estimate in (cv2.estimateAffine2D, cv2.estimateAffinePartial2D):
                affine, inliers = estimate(
                    source,
                    target,
                    method=cv2.RANSAC,
                    ransacReprojThreshold=self.inlier_px,
                    maxIters=self.iterations,
                    confidence=_RANSAC_CONFIDENCE,
                    refineIters=_RANSAC_REFINEMENTS,
                )
                if affine is None or inliers.sum() < self.min_inliers:
                    continue
                found = np.asarray(affine, dtype=np.float64)
                if self.plausible(found):
                    return found
        return np.full((2, 3), np.nan)

    def plausible(self, affine: Float64Array) -> NDArray[np.bool_]:
        """Return which maps (..., 2, 3) neither mirror nor turn nor scale too much."""
        linear = np.where(np.isfinite(affine), affine, 0.0)[..., :2]
        scales = np.linalg.svd(linear, compute_uv=False)
        turn_deg = np.degrees(np.arctan2(linear[..., 1, 0], linear[..., 0, 0]))
        return np.asarray(
            (np.linalg.det(linear) > 0.0)
            & (scales[..., 0] <= self.max_scale)
            & (scales[..., 1] >= 1.0 / self.max_scale)
            & (np.abs(turn_deg) <= self.max_turn_deg)
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Query:
    """The query at one assumed attitude: R curve points and Q keypoints, in px."""

    points_px: Float64Array  # (R, 2), x from the optical axis
    weight: Float64Array  # (R,)
    bins: IntArray  # (Q,)
    local_bins: IntArray  # (3,), of points of a local skyline relative to its keypoint
    local_px: Float64Array  # (Q, 3, 2), those points
    patches: Float32Array  # (Q, S)
    pitch_deg: float
    roll_deg: float

    @classmethod
    def of(
        cls, curves: QueryCurves, row: int, keypoints: IntArray, offsets: IntArray, bin_px: float
    ) -> Self:
        y_px = curves.y[row] / TANGENT_PER_PX
        x_px = (np.arange(len(y_px)) - len(y_px) // 2) * bin_px
        seen = curves.weight[row] > 0.0
        local_bins = np.array([-1, 0, 1], dtype=np.intp) * (offsets[-1] // 2)
        near = np.clip(keypoints[:, np.newaxis] + local_bins, 0, len(y_px) - 1)
        rows = np.zeros(len(keypoints), dtype=np.intp)
        patches = local_patches(y_px[np.newaxis], rows, keypoints, offsets, wrap=True)
        return cls(
            np.stack([x_px[seen], y_px[seen]], axis=1),
            curves.weight[row, seen],
            keypoints,
            local_bins,
            np.stack([x_px[near], y_px[near]], axis=-1),
            patches.astype(np.float32),
            float(curves.pitch_deg[row]),
            float(curves.roll_deg[row]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Stored:
    """C locations of a store: curves and, padded to the most, K keypoints each, in px."""

    y_px: Float32Array  # (C, B)
    bins: IntArray  # (C, K), 0 where padded
    patches: Float32Array  # (C, K, S), NaN where padded
    bin_px: float
    step_px: float

    @classmethod
    def of(cls, profiles: Profiles, rows: slice, offsets: IntArray) -> Self:
        y_px = profiles.y[rows] / np.float32(TANGENT_PER_PX)
        start, stop, _ = rows.indices(len(profiles))
        begin = profiles.keypoint_start[start : stop + 1]
        count = np.diff(begin)
        row = np.repeat(np.arange(len(count)), count)
        slot = np.arange(begin[-1] - begin[0]) - (begin[:-1] - begin[0])[row]
        bin_ = profiles.keypoint_bin[begin[0] : begin[-1]]
        bins = np.zeros((len(count), int(count.max(initial=0))), dtype=np.intp)
        bins[row, slot] = bin_
        patches = np.full((*bins.shape, len(offsets)), np.nan, dtype=np.float32)
        patches[row, slot] = local_patches(y_px, row, bin_, offsets, wrap=True)
        step_px = profiles.bin_px * float(offsets[1] - offsets[0])
        return cls(y_px, bins, patches, profiles.bin_px, step_px)

    def at(self, bins: IntArray) -> Float32Array:
        """Return y in px (C, ...) at bins (C, ...) of each location, which may be off the turn."""
        return np.take_along_axis(self.y_px, bins % self.y_px.shape[1], axis=1)


def agreeing_shifts(
    shift: IntArray, known: NDArray[np.bool_], bins: int
) -> tuple[IntArray, NDArray[np.bool_]]:
    """Unwrap the shifts of correspondences and say which could share a plausible map.

    Azimuth is circular, an affine map is not. And a location is seen all the way round, the
    paper's reference in one direction: so the direction is agreed on first, as the shift that
    most others come within `_VOTE_TURNS` of. Those further off than `_REACH_TURNS`, more than a
    plausible map stretches a 60 degree view, could only be outliers and are left out.

    Parameters
    ----------
    shift : (C, Q) int
        Stored minus query bin of each correspondence.
    known : (C, Q) bool
        Which correspondences there are.
    bins : int
        In a full turn.

    Returns
    -------
    shift : (C, Q) int
        Within half a turn of the agreed one.
    agreeing : (C, Q) bool
    """
    half = bins // 2
    apart = np.abs((shift[:, :, np.newaxis] - shift[:, np.newaxis, :] + half) % bins - half)
    votes = ((apart <= bins * _VOTE_TURNS) & known[:, np.newaxis, :]).sum(axis=2) * known
    agreed = np.take_along_axis(shift, np.argmax(votes, axis=1)[:, np.newaxis], axis=1)
    away = (shift - agreed + half) % bins - half
    return agreed + away, known & (np.abs(away) <= bins * _REACH_TURNS)


def _corresponding_points(
    query: "_Query", stored: "_Stored", shift: IntArray
) -> tuple[Float64Array, Float64Array]:
    """Return the points in px that each correspondence puts on top of each other.

    Besides the keypoint these are a point of the local skyline to either side of it.

    Parameters
    ----------
    shift : (C, Q) int
        Stored minus query bin.

    Returns
    -------
    source : (Q, 3, 2) float64
    target : (C, Q, 3, 2) float64
        Of the query and of the stored locations; y is NaN where unknown.
    """
    source = query.local_px
    x_px = source[:, :, 0] + shift[:, :, np.newaxis] * stored.bin_px
    bins = query.bins[:, np.newaxis] + query.local_bins + shift[:, :, np.newaxis]
    y_px = stored.at(bins.reshape(len(shift), -1)).reshape(bins.shape)
    target = np.stack([x_px, y_px], axis=-1)
    return source, target


def _distance_after_warp_px(
    affine: Float64Array, query: _Query, stored: _Stored, min_overlap: float
) -> Float64Array:
    """Return (C,) rms distances of warped query and stored skylines, infinite for no fit.

    Each point of the query skyline is warped; the distance is vertical, to the stored skyline
    at the azimuth it lands on, rms by the points' weights. There is no fit where the map is NaN
    or less than ``min_overlap`` of the weight lands on known profile.
    """
    bins = stored.y_px.shape[1]
    warped = np.where(np.isfinite(affine), affine, 0.0)
    moved = query.points_px @ warped[:, :, :2].transpose(0, 2, 1) + warped[:, np.newaxis, :, 2]
    position = moved[:, :, 0] / stored.bin_px + bins // 2
    left = np.floor(position).astype(np.intp)
    share = position - left
    there = stored.at(left) * (1.0 - share) + stored.at(left + 1) * share
    difference = moved[:, :, 1] - there
    weight = np.where(np.isfinite(difference), query.weight, 0.0)
    total = weight.sum(axis=1)
    fits = np.isfinite(affine).all(axis=(1, 2)) & (total >= min_overlap * query.weight.sum())
    squared = (weight * np.nan_to_num(difference) ** 2).sum(axis=1)
    return np.where(fits, np.sqrt(squared / np.where(fits, total, 1.0)), np.inf)


def _pose(affine: Float64Array, score: Float64Array, query: _Query, stored: _Stored) -> Fits:
    """Read the pose off the maps: where they put the optical axis, and how they turn it.

    The axis' vertical is followed at the skyline's mean height, not at the axis itself: the
    points the map was made from lie there, and its shear is too poorly known to leave them.
    """
    affine = np.where(np.isfinite(score)[:, np.newaxis, np.newaxis], affine, 0.0)
    mean_y_px = np.average(query.points_px[:, 1], weights=query.weight)
    x_px, y_px = (affine[:, :, 1] * mean_y_px + affine[:, :, 2]).T
    raised = np.arctan(y_px * TANGENT_PER_PX) - np.arctan(mean_y_px * TANGENT_PER_PX)
    bins = stored.y_px.shape[1]
    turn_deg = np.degrees(np.arctan2(affine[:, 1, 0], affine[:, 0, 0]))
    return Fits(
        score,
        (x_px / stored.bin_px + bins // 2) * (360.0 / bins) % 360.0,
        query.pitch_deg + np.degrees(raised),
        query.roll_deg - turn_deg,
    )

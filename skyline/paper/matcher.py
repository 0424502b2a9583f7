"""The paper's matcher (section 3): keypoints, Chamfer, RANSAC affine, distance after warping.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, so
that a stored view ends nowhere. Each query keypoint corresponds to the stored keypoint of a
location with the nearest local skyline; RANSAC finds the affine map that most correspondences
agree on; the score is the rms distance in px between the warped query skyline and the stored
one, taken vertically. The affine map also says where the optical axis went: heading, pitch, roll.

Not every location is worth that at every assumed attitude: `skyline.paper.shortlist` says at
which of them it is. Without a shortlist every one is tried, which takes seconds a query.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array, IntArray
from skyline.errors import InputError
from skyline.matching.narrowing import Narrowed
from skyline.matching.profiles import TANGENT_PER_PX, Profiles
from skyline.matching.query import Attitudes, QueryCurves, QueryRays
from skyline.matching.ranker import Ranker, Source
from skyline.matching.ranking import Fits, Ranking, select
from skyline.matching.screening import Alike
from skyline.paper.alignment import align_curves
from skyline.paper.chamfer import mean_squared_px2, nearest_patches
from skyline.paper.patches import QueryCurve, StoredCurves
from skyline.paper.ransac import Ransac
from skyline.paper.shortlist import Shortlist

_CHUNK = 64
"""Locations at a time."""

_VOTE_TURNS = 1.0 / 64.0
_REACH_TURNS = 1.0 / 32.0


@dataclass(frozen=True, slots=True)
class PaperMatcher:
    """The paper's matcher over whole 360 degree profiles."""

    attitudes: Attitudes = field(default_factory=Attitudes)
    """Assumed pitches and rolls; the affine map takes up what lies between."""
    tolerance_px: float = 1.0
    """Of the query's polyline; best that of the store's."""
    max_keypoints: int = 64
    """Of the query."""
    patch_half_px: float = 40.0
    patch_step_px: float = 4.0
    """``patch_half_px``, ``patch_step_px``: reach of a local skyline to either side of its keypoint
    and distance of its samples."""
    shortlist_poses: int | None = 100
    """Pairs of a location and an assumed attitude that are looked at closely, by Chamfer distance,
    RANSAC and warping: those `skyline.paper.shortlist` finds most alike. None looks at all."""
    shortlist: int = 4
    """Stored patches a query patch is compared with by Chamfer distance."""
    directions: int = 3
    """Directions tried at a location: those that most correspondences agree on."""
    inlier_px: float = 4.0
    """RANSAC's threshold."""
    iterations: int = 100
    """Samples RANSAC draws."""
    min_inliers: int = 3
    """Fewer are no fit; at least 3."""
    max_scale: float = 1.25
    """Singular values of the map must lie between 1 / max_scale and max_scale."""
    max_turn_deg: float = 15.0
    """Greatest turn of the map in the image."""
    min_overlap: float = 0.8
    """Least share of the query's weight that must land on known profile, in (0, 1]."""
    separation_m: float = 0.0
    """Candidates are at least this far apart."""

    def __post_init__(self) -> None:
        if self.min_inliers < 3:
            raise InputError(
                f"least number of inliers is {self.min_inliers}; an affine map needs at least 3"
            )
        if not 0.0 < self.min_overlap <= 1.0:
            raise InputError(f"least overlap is {self.min_overlap}; expected above 0, at most 1")
        if self.shortlist_poses is not None and self.shortlist_poses < 1:
            raise InputError(
                f"poses on the shortlist are {self.shortlist_poses}; expected at least 1, or None"
            )
        if not 0.0 <= self.max_turn_deg < 90.0:
            raise InputError(
                f"greatest turn is {self.max_turn_deg}; expected 0 to below 90 degrees"
            )
        if not self.max_scale >= 1.0:
            raise InputError(f"greatest scale is {self.max_scale}; expected at least 1")

    def prepare(self, profiles: Profiles) -> "PreparedPaper":
        """Do once what is the same for every query."""
        offsets = self._offsets(profiles.bin_px)
        if self.shortlist_poses is None:
            return PreparedPaper(self, profiles, offsets, None)
        return PreparedPaper(self, profiles, offsets, Shortlist.of(profiles, offsets))

    def _offsets(self, bin_px: float) -> IntArray:
        """Return the offsets of a patch's samples in bins, symmetric about 0."""
        step = max(1, round(self.patch_step_px / bin_px))
        half = max(1, round(self.patch_half_px / bin_px / step))
        return np.arange(-half, half + 1, dtype=np.intp) * step

    @property
    def ransac(self) -> Ransac:
        """How maps are drawn."""
        return Ransac(
            self.iterations, self.inlier_px, self.min_inliers, self.max_scale, self.max_turn_deg
        )


@dataclass(frozen=True, slots=True, eq=False)
class PreparedPaper(Ranker):
    """The paper's matcher with a store it is ready to match to; see `PaperMatcher.prepare`."""

    matcher: PaperMatcher
    profiles: Profiles
    _offsets: IntArray
    _shortlist: Shortlist | None

    @classmethod
    def open(cls, source: Source) -> "PreparedPaper":
        """See `Ranker.open`."""
        return PaperMatcher().prepare(source.profiles())

    def rank(
        self,
        query: QueryRays,
        top: int,
        narrowed: Narrowed | None = None,
        screened: Alike | None = None,
    ) -> Ranking:
        """Return the best poses, best first; see `Ranker.rank`."""
        separation_m = self.matcher.separation_m
        return select(self.profiles, self.fit(query), query.fov_deg, top, separation_m)

    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at every location; score in px, infinite where nothing fits.

        Nothing fits at a location that is on no shortlist.
        """
        matcher = self.matcher
        curves = QueryCurves.of(query, matcher.attitudes, self.profiles.bins)
        assumed = [
            QueryCurve.of(curves, row, matcher.tolerance_px, matcher.max_keypoints, self._offsets)
            for row in range(len(curves.y))
        ]
        fits = Fits.none(len(self.profiles))
        for query_curve, listed in zip(assumed, self._listed(assumed), strict=True):
            for start in range(0, len(listed), _CHUNK):
                rows = listed[start : start + _CHUNK]
                stored = StoredCurves.of(self.profiles, rows, self._offsets)
                found = self._fit_chunk(stored, query_curve)
                fits = fits.best_with(found.placed_among(rows, len(fits.score)))
        return fits

    def _listed(self, assumed: list[QueryCurve]) -> list[IntArray]:
        """Return the locations, ascending, at which each attitude is worth a closer look."""
        most = self.matcher.shortlist_poses
        if self._shortlist is None or most is None:
            return [np.arange(len(self.profiles))] * len(assumed)
        distance = self._shortlist.distances_px(assumed, self._min_known, self.matcher.min_overlap)
        flat = distance.ravel()
        best = np.argsort(flat, kind="stable")[:most]
        listed = np.zeros(distance.shape, dtype=np.bool_)
        listed.ravel()[best[np.isfinite(flat[best])]] = True
        return [np.flatnonzero(column) for column in listed.T]

    @property
    def _min_known(self) -> int:
        """Samples that two patches must have in common."""
        return 3 * len(self._offsets) // 4

    def _fit_chunk(self, stored: StoredCurves, query: QueryCurve) -> Fits:
        """Return the fits of one assumed attitude at a chunk of locations."""
        if not stored.bins.shape[1] or not len(query.bins):
            return Fits.none(len(stored))
        squared = mean_squared_px2(query.patches, stored.patches, self._min_known)
        step_px = stored.bin_px * float(self._offsets[1] - self._offsets[0])
        nearest, distance = nearest_patches(
            query.patches, stored.patches, squared, step_px, self.matcher.shortlist
        )
        raw_shift = np.take_along_axis(stored.bins, nearest, axis=1) - query.bins
        left = np.isfinite(distance)
        directions = []
        for _ in range(self.matcher.directions):
            directions.append(agreeing_shifts(raw_shift, left, stored.y_px.shape[1]))
            left = left & ~directions[-1][1]
        shift, agreeing = (np.concatenate(parts) for parts in zip(*directions, strict=True))
        fits = self._fit_directions(stored.repeated(len(directions)), query, shift, agreeing)
        best, *others = fits.split(len(directions))
        for other in others:
            best = best.best_with(other)
        return best

    def _fit_directions(
        self,
        stored: StoredCurves,
        query: QueryCurve,
        shift: IntArray,
        agreeing: NDArray[np.bool_],
    ) -> Fits:
        """Return the fits of the correspondences that agree on a direction at each location."""
        source, target = _corresponding_points(query, stored, shift)
        used = np.repeat(agreeing, len(query.local_bins), axis=1)
        used &= np.isfinite(target[..., 1] + source[..., 1])
        ransac = self.matcher.ransac
        affine = align_curves(
            ransac.maps(source, target, used),
            query.points_px,
            query.weight,
            stored.y_px,
            stored.bin_px,
            self.matcher.inlier_px,
        )
        affine[~ransac.plausible(affine)] = np.nan
        score = _distance_after_warp_px(affine, query, stored, self.matcher.min_overlap)
        return _pose(affine, score, query, stored)


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
    query: QueryCurve, stored: StoredCurves, shift: IntArray
) -> tuple[Float64Array, Float64Array]:
    """Return the points in px that each correspondence puts on top of each other.

    Besides the keypoint these are a point of the local skyline to either side of it; shifts (C, Q)
    are stored minus query bin.

    Returns
    -------
    source : (3 Q, 2) float64
    target : (C, 3 Q, 2) float64
        Of the query and of the stored locations; y is NaN where unknown.
    """
    x_px = query.local_px[:, :, 0] + shift[:, :, np.newaxis] * stored.bin_px
    bins = query.bins[:, np.newaxis] + query.local_bins + shift[:, :, np.newaxis]
    y_px = stored.at(bins.reshape(len(shift), -1)).reshape(bins.shape)
    target = np.stack([x_px, y_px], axis=-1)
    return query.local_px.reshape(-1, 2), target.reshape(len(shift), -1, 2)


def _distance_after_warp_px(
    affine: Float64Array, query: QueryCurve, stored: StoredCurves, min_overlap: float
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


def _pose(
    affine: Float64Array, score: Float64Array, query: QueryCurve, stored: StoredCurves
) -> Fits:
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

"""Section 3: the paper's matcher - keypoints, Chamfer distance, RANSAC, distance after warping.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, so
that a stored view ends nowhere. Each query keypoint corresponds to the stored keypoint of a
location with the nearest local skyline; RANSAC finds the affine map that most correspondences
agree on; the score is the rms vertical distance in px between the warped query skyline and the
stored skyline. The affine map also gives the camera's heading, pitch and roll.

These steps take seconds for all locations at all assumed pitches, so `skyline.paper.shortlist`
chooses the pairs of a location and a pitch that go through them.
"""

from dataclasses import replace
from functools import reduce

import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray
from skyline.match.profiles import TANGENT_PER_PX, Fits, ProfileMatcher, Profiles
from skyline.match.query_rays import QueryCurves, QueryRays
from skyline.paper.curves import (
    MIN_OVERLAP,
    QueryCurve,
    StoredCurves,
    align_curves,
    nearest_patches,
    patch_offsets,
    plausible,
    ransac_maps,
)
from skyline.paper.shortlist import Shortlist

_CHUNK = 64
"""Locations compared at a time."""

_POSES = 100
"""Pairs of a location and an assumed pitch on the shortlist."""

_DIRECTIONS = 3
"""Directions tried at a location: those on which most correspondences agree."""

_VOTE_TURNS = 1.0 / 64.0
_REACH_TURNS = 1.0 / 32.0


class PaperMatcher(ProfileMatcher):
    """The paper's matcher over whole 360 degree profiles.

    The affine map takes up what lies between the assumed pitches, and the roll.
    """

    def __init__(self, profiles: Profiles) -> None:
        super().__init__(profiles)
        self._shortlist = Shortlist(profiles)

    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at every location; score in px, infinite where nothing fits.

        A location that is not on the shortlist has no fit.
        """
        curves = QueryCurves.of(query, self.profiles.bins)
        assumed = [QueryCurve.of(curves, row) for row in range(len(curves.y))]
        fits = Fits.none(len(self.profiles))
        for one, listed in zip(assumed, self._listed(assumed), strict=True):
            for start in range(0, len(listed), _CHUNK):
                rows = listed[start : start + _CHUNK]
                found = _fits(StoredCurves.of(self.profiles, rows), one)
                fits = fits.best_with(found.placed_among(rows, len(fits.score)))
        return fits

    def _listed(self, assumed: list[QueryCurve]) -> list[IntArray]:
        """Return the locations on the shortlist, ascending, for each pitch."""
        distance = self._shortlist.distances_px(assumed)
        flat = distance.ravel()
        best = np.argsort(flat, kind="stable")[:_POSES]
        listed = np.zeros(distance.shape, dtype=np.bool_)
        listed.ravel()[best[np.isfinite(flat[best])]] = True
        return [np.flatnonzero(column) for column in listed.T]


def _fits(stored: StoredCurves, query: QueryCurve) -> Fits:
    """Return the fits of one assumed pitch at some locations."""
    if not stored.bins.shape[1] or not len(query.bins):
        return Fits.none(len(stored))
    step_px = stored.bin_px * float(np.diff(patch_offsets(stored.bin_px))[0])
    nearest, distance = nearest_patches(query.patches, stored.patches, query.min_known, step_px)
    raw_shift = np.take_along_axis(stored.bins, nearest, axis=1) - query.bins
    left = np.isfinite(distance)
    directions = []
    for _ in range(_DIRECTIONS):
        directions.append(_agreeing_shifts(raw_shift, left, stored.y_px.shape[1]))
        left = left & ~directions[-1][1]
    shift, agreeing = (np.concatenate(parts) for parts in zip(*directions, strict=True))
    # All directions are fitted together; this step needs only the skylines.
    repeated = replace(stored, y_px=np.tile(stored.y_px, (_DIRECTIONS, 1)))
    fits = _fits_in_direction(repeated, query, shift, agreeing).split(_DIRECTIONS)
    return reduce(Fits.best_with, fits)


def _fits_in_direction(
    stored: StoredCurves, query: QueryCurve, shift: IntArray, agreeing: BoolArray
) -> Fits:
    """Return the fits of the correspondences that agree on a direction at each location."""
    source, target = _corresponding_points(query, stored, shift)
    used = np.repeat(agreeing, len(query.local_bins), axis=1)
    used &= np.isfinite(target[..., 1] + source[..., 1])
    affine = align_curves(
        ransac_maps(source, target, used),
        query.points_px,
        query.weight,
        stored.y_px,
        stored.bin_px,
    )
    affine[~plausible(affine)] = np.nan
    return _pose(affine, _distance_after_warp_px(affine, query, stored), query, stored)


def _agreeing_shifts(shift: IntArray, known: BoolArray, bins: int) -> tuple[IntArray, BoolArray]:
    """Unwrap the shifts of correspondences and mark those that could share a plausible map.

    Azimuth is circular and an affine map is not; and a location is seen all the way round, but the
    paper's reference in one direction. So the direction is found first: the shift with most others
    within `_VOTE_TURNS`. Shifts farther from it than `_REACH_TURNS`, more than a plausible map
    stretches a 60 degree view, can only be outliers and are left out.

    Shifts (C, Q) are stored minus query bin of each correspondence; ``known`` (C, Q) marks the
    correspondences that exist. Shifts are returned within half a turn of the agreed one.
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

    These are points of the query (3 Q, 2) and of the stored locations (C, 3 Q, 2), where y is NaN
    if unknown: the keypoint, and a point of the local skyline to either side of it. Shifts (C, Q)
    are stored minus query bin.
    """
    x_px = query.local_px[:, :, 0] + shift[:, :, np.newaxis] * stored.bin_px
    bins = query.bins[:, np.newaxis] + query.local_bins + shift[:, :, np.newaxis]
    y_px = stored.at(bins.reshape(len(shift), -1)).reshape(bins.shape)
    target = np.stack([x_px, y_px], axis=-1)
    return query.local_px.reshape(-1, 2), target.reshape(len(shift), -1, 2)


def _distance_after_warp_px(
    affine: Float64Array, query: QueryCurve, stored: StoredCurves
) -> Float64Array:
    """Return (C,) rms distances of warped query and stored skylines, infinite for no fit.

    Each point of the query skyline is warped; the distance is vertical, to the stored skyline
    at the azimuth it lands on, rms by the points' weights. There is no fit where the map is NaN
    or less than `MIN_OVERLAP` of the weight lands on known profile.
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
    fits = np.isfinite(affine).all(axis=(1, 2)) & (total >= MIN_OVERLAP * query.weight.sum())
    squared = (weight * np.nan_to_num(difference) ** 2).sum(axis=1)
    return np.where(fits, np.sqrt(squared / np.where(fits, total, 1.0)), np.inf)


def _pose(
    affine: Float64Array, score: Float64Array, query: QueryCurve, stored: StoredCurves
) -> Fits:
    """Return the poses that follow from the maps: where these put the optical axis and turn it.

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
        -turn_deg,
    )

r"""Section 3: the paper's matcher - keypoints, Chamfer distance, RANSAC, distance after warping.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, and the
stored views of a location are joined all the way round. Each query keypoint corresponds to the
stored keypoint of a location with the nearest local skyline; RANSAC finds the affine map that most
correspondences agree on; the score is the rms vertical distance in px between the warped query
skyline and the stored skyline. The affine map also gives the camera's heading, pitch and roll.

These steps take seconds for all locations at all assumed pitches. A shortlist, which is not the
paper's, chooses the pairs of a location and a pitch that go through them. The skylines, thinned,
are laid over each other in every direction. A tilt and an affine map near the identity change the
query's skyline q(x) to first order by a combination of a few known curves (1, cos x, sin x, q',
x q'), so the least rms distance after such a warp is that of the difference with those curves
projected out:

.. math:: \sum w (s - q)^2 - |B^T (s - q)|^2

where B is a basis of them, orthonormal under the weights w, and s the stored skyline. Each sum over
s or its square is a circular correlation with a curve that is the query's alone, so all directions
come from one product of Fourier transforms.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import fft

from skyline.arrays import BoolArray, Complex64Array, Float32Array, Float64Array, IntArray
from skyline.match.rays import Rays
from skyline.paper.correlation import TANGENT_PER_PX, ProfileMatcher, Profiles, at_pitches
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
from skyline.pose import Poses

_CHUNK = 64
"""Locations compared at a time."""

_POSES = 300
"""Pairs of a location and an assumed pitch on the shortlist."""

_DIRECTIONS = 3
"""Directions tried at a location: those on which most correspondences agree."""

_VOTE_TURNS = 1.0 / 64.0
"""Correspondences vote together for a direction within this share of a turn."""

_REACH_TURNS = 1.0 / 32.0

_THIN = 4
"""Bins that are averaged to one for the shortlist; profiles have a multiple of it."""


class PaperMatcher(ProfileMatcher):
    """The paper's matcher over whole 360 degree profiles.

    The affine map takes up what lies between the assumed pitches, and the roll.
    """

    def __init__(self, profiles: Profiles) -> None:
        super().__init__(profiles)
        shape = len(profiles), -1, _THIN
        thinned = _bridged(profiles.y).reshape(shape).mean(axis=2)
        # Deviations from the mean keep the differences of sums well conditioned.
        self._thinned_px = (thinned - thinned.mean(axis=1, keepdims=True)) / TANGENT_PER_PX
        self._is_known = np.asarray(np.isfinite(profiles.y).reshape(shape).all(axis=2))

    def fit(self, query: Rays) -> Poses:
        """Return the best pose at every location; score in px, infinite where nothing fits.

        A location that is not on the shortlist has no fit.
        """
        assumed = [QueryCurve.of(*one) for one in at_pitches(query, self.profiles.bins)]
        fits = _no_fit(len(self.profiles))
        for one, listed in zip(assumed, self._listed(query), strict=True):
            for start in range(0, len(listed), _CHUNK):
                rows = listed[start : start + _CHUNK]
                found = _fits(StoredCurves.of(self.profiles, rows), one)
                better = found[0] < fits[0, rows]
                fits[:, rows[better]] = found[:, better]
        score, heading_deg, pitch_deg, roll_deg = fits
        return self.profiles.poses(score, heading_deg, pitch_deg, roll_deg, query.fov_deg)

    def _listed(self, query: Rays) -> list[IntArray]:
        """Return the locations on the shortlist, ascending, for each assumed pitch."""
        pitches = at_pitches(query, self._thinned_px.shape[1])
        curves = [_projected(y, weight) for _, y, weight in pitches]
        distance = _least_distances_px(self._thinned_px, self._is_known, curves)
        best = np.argsort(distance, axis=None, kind="stable")[:_POSES]
        listed = np.zeros(distance.shape, dtype=np.bool_)
        listed.flat[best] = np.isfinite(distance.flat[best])
        return [np.flatnonzero(column) for column in listed.T]


def _projected(y: Float64Array, weight: Float64Array) -> tuple[Complex64Array, Float64Array]:
    """Return a query's curve q (B,) of tangents, prepared for distances after a small warp.

    These are the conjugate Fourier transforms (2 + F, B / 2 + 1) of w, w q and w b, for F curves b
    of the basis, and the sums (1 + F,) of w q^2 and w b q. The weights w have a sum of 1.
    """
    weight, bins = weight / weight.sum(), np.arange(len(y))
    seen = weight > 0.0
    q = np.interp(bins, bins[seen], y[seen]) / TANGENT_PER_PX
    q -= q @ weight
    azimuth = 2.0 * np.pi / len(y) * (bins - len(y) // 2)
    slope, root = np.gradient(q), np.sqrt(weight)
    curves = np.stack([np.ones(len(y)), np.cos(azimuth), np.sin(azimuth), slope, azimuth * slope])
    left, size, _ = np.linalg.svd((curves * root).T, full_matrices=False)
    basis = left[:, size > 1e-6 * size[0]].T * root
    transforms = fft.rfft(np.stack([weight, weight * q, *basis]).astype(np.float32))
    return transforms.conj().astype(np.complex64), np.stack([weight @ q**2, *(basis @ q)])


def _no_fit(locations: int) -> Float64Array:
    """Return the score, heading, pitch and roll (4, C) of locations where nothing fits."""
    return np.concatenate([np.full((1, locations), np.inf), np.zeros((3, locations))])


def _fits(stored: StoredCurves, query: QueryCurve) -> Float64Array:
    """Return the score, heading, pitch and roll (4, C) of one assumed pitch at some locations."""
    if not stored.bins.shape[1] or not len(query.bins):
        return _no_fit(len(stored))
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
    fits = _fits_in_direction(repeated, query, shift, agreeing).reshape(4, _DIRECTIONS, -1)
    return fits[:, fits[0].argmin(axis=0), np.arange(len(stored))]


def _fits_in_direction(
    stored: StoredCurves, query: QueryCurve, shift: IntArray, agreeing: BoolArray
) -> Float64Array:
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
) -> Float64Array:
    """Return the poses (4, C) that follow from the maps: where these put and turn the optical axis.

    The axis' vertical is followed at the skyline's mean height, not at the axis itself: the
    points the map was made from lie there, and its shear is too poorly known to leave them.
    """
    affine = np.where(np.isfinite(score)[:, np.newaxis, np.newaxis], affine, 0.0)
    mean_y_px = np.average(query.points_px[:, 1], weights=query.weight)
    x_px, y_px = (affine[:, :, 1] * mean_y_px + affine[:, :, 2]).T
    raised = np.arctan(y_px * TANGENT_PER_PX) - np.arctan(mean_y_px * TANGENT_PER_PX)
    bins = stored.y_px.shape[1]
    turn_deg = np.degrees(np.arctan2(affine[:, 1, 0], affine[:, 0, 0]))
    heading_deg = (x_px / stored.bin_px + bins // 2) * (360.0 / bins) % 360.0
    return np.stack([score, heading_deg, query.pitch_deg + np.degrees(raised), -turn_deg])


def _least_distances_px(
    y_px: Float32Array,
    is_known: BoolArray,
    curves: Sequence[tuple[Complex64Array, Float64Array]],
) -> Float32Array:
    """Return the least distance (L, A) of profiles (L, B) to each of A curves of `_projected`.

    Infinite where less than `MIN_OVERLAP` of a curve's weight lands on known profile.
    """
    bins, least = y_px.shape[1], np.empty((len(y_px), len(curves)), dtype=np.float32)
    for start in range(0, len(y_px), _CHUNK):
        rows = slice(start, start + _CHUNK)
        squares, values = fft.rfft(np.square(y_px[rows])), fft.rfft(y_px[rows])
        known = None if is_known[rows].all() else fft.rfft(is_known[rows].astype(np.float32))
        for column, (transforms, products) in enumerate(curves):
            weight, query, basis = transforms[0], transforms[1], transforms[2:]
            rest = fft.irfft(squares * weight - 2.0 * values * query, bins) + products[0]
            along = fft.irfft(values[:, np.newaxis] * basis, bins) - products[1:, np.newaxis]
            rest -= np.square(along).sum(axis=1)
            if known is not None:
                rest[fft.irfft(known * weight, bins) < MIN_OVERLAP - 1e-4] = np.inf
            least[rows, column] = np.sqrt(np.maximum(rest.min(axis=1), 0.0))
    return least


def _bridged(y: Float32Array) -> Float32Array:
    """Return curves (L, B) with straight lines over unknown bins; 0 where all are unknown."""
    bins, filled = np.arange(y.shape[1]), np.nan_to_num(y)
    for row in np.flatnonzero(np.isnan(y).any(axis=1)):
        known = np.isfinite(y[row])
        if known.any():
            filled[row] = np.interp(bins, bins[known], y[row, known], period=len(bins))
    return filled

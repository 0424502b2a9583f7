r"""Section 3: the paper's matcher - keypoints, Chamfer distance, RANSAC, distance after warping.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, and the
stored views of a location are joined all the way round. Each query keypoint corresponds to the
stored keypoint of a location with the nearest local skyline; RANSAC finds the affine map that most
correspondences agree on; the score is the rms vertical distance in px between the warped query
skyline and the stored skyline. The affine map also gives the camera's heading, pitch and roll.

These steps take seconds for all locations at all assumed pitches, so a shortlist, which is not the
paper's, chooses the pairs of a location and a pitch that go through them. Two cheap steps look at
every pair:

1. Each query keypoint corresponds to the stored keypoint of a location with the nearest local
   skyline, by squared vertical difference, which is a matrix product. Correspondences vote
   for the direction in which they put the query.
2. In the direction with most votes the skylines, thinned, are laid over each other. A tilt and
   an affine map near the identity change the query's skyline q(x) to first order by a
   combination of a few known curves (1, cos x, sin x, q, q', x q'), so the least rms distance
   after such a warp is that of the difference with those curves projected out:

   .. math:: \sum w (s - q)^2 - |B^T (s - q)|^2

   where B is an orthonormal basis of them and s the stored skyline. Expanded, each sum is the
   product of a window of s, or of its square, with a matrix that is the query's alone.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray
from skyline.match.candidate import Hypotheses
from skyline.match.profiles import TANGENT_PER_PX, ProfileMatcher, Profiles, at_pitches
from skyline.match.query_rays import QueryRays
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

_CHUNK = 64
"""Locations compared at a time."""

_POSES = 100
"""Pairs of a location and an assumed pitch on the shortlist."""

_DIRECTIONS = 3
"""Directions tried at a location: those on which most correspondences agree."""

_VOTE_TURNS = 1.0 / 64.0
"""Correspondences vote together for a direction within this share of a turn."""

_REACH_TURNS = 1.0 / 32.0

_AT_ONCE = 32
"""Locations whose patches are compared together; keeps a product in the cache."""

_SAMPLES = 2
"""Step between the samples of a patch that the shortlist compares."""

_FAR = np.float32(1e12)
"""px squared; padding of a location's patches gets this distance, so that any patch is nearer."""

_RUN = 4
"""Bins that are averaged to one for the distance; profiles have a multiple of 8."""

_REACH = 4
"""Greatest error of a direction, in thinned bins to either side."""

_STEPS = 2 * _REACH + 1


class PaperMatcher(ProfileMatcher):
    """The paper's matcher over whole 360 degree profiles.

    The affine map takes up what lies between the assumed pitches, and the roll.
    """

    def __init__(self, profiles: Profiles) -> None:
        super().__init__(profiles)
        self._shortlist = Shortlist(profiles)

    def fit(self, query: QueryRays) -> Hypotheses:
        """Return the best pose at every location; score in px, infinite where nothing fits.

        A location that is not on the shortlist has no fit.
        """
        assumed = [QueryCurve.of(*one) for one in at_pitches(query, self.profiles.bins)]
        fits = _no_fit(len(self.profiles))
        for one, listed in zip(assumed, self._listed(assumed), strict=True):
            for start in range(0, len(listed), _CHUNK):
                rows = listed[start : start + _CHUNK]
                found = _fits(StoredCurves.of(self.profiles, rows), one)
                better = found[0] < fits[0, rows]
                fits[:, rows[better]] = found[:, better]
        score, heading_deg, pitch_deg, roll_deg = fits
        return self.profiles.poses(score, heading_deg, pitch_deg, roll_deg, query.fov_deg)

    def _listed(self, assumed: list[QueryCurve]) -> list[IntArray]:
        """Return the locations on the shortlist, ascending, for each pitch."""
        distance = self._shortlist.distances_px(assumed)
        flat = distance.ravel()
        best = np.argsort(flat, kind="stable")[:_POSES]
        listed = np.zeros(distance.shape, dtype=np.bool_)
        listed.ravel()[best[np.isfinite(flat[best])]] = True
        return [np.flatnonzero(column) for column in listed.T]


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


@dataclass(frozen=True, slots=True, eq=False)
class _Patches:
    """The patches of C locations, K each with S samples, as the right-hand side of a product."""

    rows: IntArray  # (C,)
    bins: IntArray  # (C, K)
    terms: Float32Array  # (2 S + 1, C * K): squares, values, and how far padding is off
    comparable: BoolArray  # (C,): which locations have patches that are wholly known

    @classmethod
    def of(cls, profiles: Profiles, rows: IntArray) -> Self:
        stored = StoredCurves.of(profiles, rows)
        patches = stored.patches[:, :, ::_SAMPLES].transpose(2, 0, 1)
        patches = patches.reshape(len(patches), -1)
        whole = np.asarray(np.isfinite(patches).all(axis=0))
        values = np.where(whole, patches, np.float32(0.0))
        far = np.where(whole, np.float32(0.0), _FAR)[np.newaxis]
        comparable = np.asarray(whole.reshape(stored.bins.shape).any(axis=1))
        return cls(rows, stored.bins, np.concatenate([values**2, values, far]), comparable)


class Shortlist:
    """The parts of a store's L locations that every query is compared with.

    Stored patches with unknown samples, at the borders of what is known, have no vote.
    """

    def __init__(self, profiles: Profiles) -> None:
        by_count = np.argsort(np.diff(profiles.keypoint_start), kind="stable")
        known = np.isfinite(profiles.y)
        y = profiles.y if known.all() else _bridged(profiles.y, known)
        self._bins = profiles.bins
        self._patches = [
            _Patches.of(profiles, by_count[k : k + _AT_ONCE])
            for k in range(0, len(by_count), _AT_ONCE)
        ]
        # (L, 2 B / _RUN + 2 _REACH), thinned skylines in px, gaps bridged; and the known share of
        # each thinned bin, None where all is known.
        self._around = _around(y / np.float32(TANGENT_PER_PX))
        self._known = None if known.all() else _around(known.astype(np.float32))

    def distances_px(self, queries: list[QueryCurve]) -> Float32Array:
        """Return the least distance (L, A) of every location to the query at A attitudes.

        It is infinite where less than `MIN_OVERLAP` of the query's weight lands on known profile,
        and where there is no correspondence.
        """
        least = np.full((len(self._around), len(queries)), np.inf, dtype=np.float32)
        used = [np.isfinite(query.patches).sum(axis=1) >= query.min_known for query in queries]
        shifts = self._shifts(queries, used)
        for column, (query, shift) in enumerate(zip(queries, shifts, strict=True)):
            if shift.shape[1]:
                least[:, column] = self._distances_px(query, most_voted(shift, self._bins))
        for block in self._patches:
            least[block.rows[~block.comparable]] = np.inf
        return least

    def _shifts(self, queries: list[QueryCurve], used: list[BoolArray]) -> list[IntArray]:
        """Return stored minus query bin (L, Q) of the used keypoints' correspondences.

        The keypoints of all attitudes are compared in one product. Stored patches that take part
        are known everywhere, so sums over a query patch's known samples can be compared as they
        are, less its own squares, which are the same for all.
        """
        patches = np.concatenate(
            [query.patches[rows, ::_SAMPLES] for query, rows in zip(queries, used, strict=True)]
        )
        bins = np.concatenate([q.bins[rows] for q, rows in zip(queries, used, strict=True)])
        known = np.isfinite(patches)
        values = np.where(known, patches, np.float32(0.0))
        terms = np.concatenate([known, -2.0 * values, np.ones((len(values), 1))], axis=1)
        terms = terms.astype(np.float32)
        shift = np.zeros((len(self._around), len(patches)), dtype=np.intp)
        for block in self._patches:
            if not block.bins.shape[1]:
                continue
            squared = (terms @ block.terms).reshape(len(terms), *block.bins.shape)
            nearest = squared.argmin(axis=2).T
            shift[block.rows] = np.take_along_axis(block.bins, nearest, axis=1) - bins
        return np.split(shift, np.cumsum([rows.sum() for rows in used])[:-1], axis=1)

    def _distances_px(self, query: QueryCurve, turn: IntArray) -> Float32Array:
        """Return the least distance (L,) within `_REACH` of each location's turn in bins."""
        first = query.point_bins[0] // _RUN
        weight, thin, constant = _thinned(query)
        start = (first + (turn + _RUN // 2) // _RUN - _REACH) % (self._bins // _RUN)
        rows, size = np.arange(len(start)), len(weight) + 2 * _REACH
        weights = _slid(weight[:, np.newaxis])
        window = sliding_window_view(self._around, size, axis=1)[rows, start]
        window = window - window.mean(axis=1, keepdims=True)
        rest = window**2 @ weights
        values = (window @ _slid(thin)).reshape(len(window), _STEPS, -1)
        values -= constant.astype(np.float32)
        rest = rest - 2.0 * values[:, :, 0] - np.square(values[:, :, 1:]).sum(axis=2)
        rest -= np.float32(constant[0])
        if self._known is not None:
            known = sliding_window_view(self._known, size, axis=1)[rows, start]
            rest[known @ weights < MIN_OVERLAP * weight.sum()] = np.inf
        least = np.maximum(rest.min(axis=1), 0.0) / np.float32(weight.sum())
        return np.asarray(np.sqrt(least), dtype=np.float32)


def _thinned(query: QueryCurve) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return a query's skyline on N thinned bins, prepared for products with stored windows.

    These are the weights w (N,), w q and w times each of F basis curves (N, 1 + F), and the
    latter's products with q itself (1 + F,).
    """
    slot = query.point_bins // _RUN
    slot = slot - slot[0]
    weight: Float64Array = np.bincount(slot, query.weight).astype(np.float64)
    seen = weight > 0.0
    x, q = (
        np.bincount(slot, query.weight * values) / np.where(seen, weight, 1.0)
        for values in query.points_px.T
    )
    azimuth = x * TANGENT_PER_PX
    whole = np.pad(np.interp(np.arange(len(q)), np.flatnonzero(seen), q[seen]), 1, "edge")
    slope = whole[2:] - whole[:-2]
    curves = np.stack([np.ones_like(x), np.cos(azimuth), np.sin(azimuth), slope, x * slope])
    root = np.sqrt(weight)
    left, size, _ = np.linalg.svd((curves * root).T, full_matrices=False)
    basis = left[:, size > 1e-6 * size[0]]
    q = np.where(seen, q - np.average(q, weights=weight), 0.0)
    values = np.concatenate([(weight * q)[:, np.newaxis], root[:, np.newaxis] * basis], axis=1)
    return weight, values, q @ values


def _slid(values: Float64Array) -> Float32Array:
    """Return values (N, F) slid down by 0 to T - 1 rows, T `_STEPS`, as (N + T - 1, T * F)."""
    count, curves = values.shape
    slid = np.zeros((count + _STEPS - 1, _STEPS, curves), dtype=np.float32)
    for step in range(_STEPS):
        slid[step : step + count, step] = values
    return slid.reshape(len(slid), -1)


def _around(y: Float32Array) -> Float32Array:
    """Return curves (L, B) thinned and repeated, so that no window comes to their end."""
    thin = y.reshape(len(y), -1, _RUN).mean(axis=2)
    return np.concatenate([thin, thin, thin[:, : 2 * _REACH]], axis=1)


def _bridged(y: Float32Array, known: BoolArray) -> Float32Array:
    """Return curves (L, B) with straight lines over unknown bins; 0 where all are unknown."""
    bins = np.arange(y.shape[1])
    filled = np.zeros_like(y)
    for row in np.flatnonzero(known.any(axis=1)):
        there = bins[known[row]]
        filled[row] = np.interp(bins, there, y[row, there], period=len(bins))
    return filled


def most_voted(shift: IntArray, bins: int) -> IntArray:
    """Return the turns (L,) in bins that most of the shifts (L, Q) agree on.

    The turn is the mean of the shifts in the fullest window; of equal windows the first counts.
    """
    halves = round(2.0 / _VOTE_TURNS)
    width = bins / halves
    shift = shift % bins
    half = (shift / width).astype(np.intp)
    row = np.arange(len(shift))
    place = (row[:, np.newaxis] * halves + half).ravel()
    beyond = (shift - half * width).ravel()
    votes, summed = (
        np.bincount(place, weights, minlength=len(shift) * halves).reshape(-1, halves)
        for weights in (None, beyond)
    )
    left = (votes + np.roll(votes, -1, axis=1)).argmax(axis=1)
    right = (left + 1) % halves
    total = summed[row, left] + summed[row, right] + votes[row, right] * width
    turn = left * width + total / (votes[row, left] + votes[row, right])
    return np.asarray(np.rint(turn), dtype=np.intp)

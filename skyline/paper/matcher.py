r"""Section 3: the paper's matcher.

Skylines are curves over azimuth and tangent of elevation, both in px of a 640 column view, and the
stored views of a location are joined all the way round. Each keypoint of the photo corresponds to
the location's keypoint with the nearest local skyline by Chamfer distance. RANSAC finds the affine
map with which most correspondences agree. The cost is the rms vertical distance in px between the
warped skyline of the photo and the stored one. The affine map also gives the camera's heading,
pitch and roll.

These steps take seconds for all locations at all assumed pitches. A shortlist, which the paper does
not have, chooses the pairs of a location and a pitch that go through them. The thinned skylines are
laid over each other in every direction. A tilt and an affine map near the identity change the
photo's skyline q(x) to first order by a combination of a few known curves (1, cos x, sin x, q', x
q'). So the least rms distance after such a warp is the rms of the difference, with those curves
projected out:

.. math:: \sum w (s - q)^2 - |B^T (s - q)|^2

where B is a basis of them, orthonormal under the weights w, and s the stored skyline. Each sum over
s or its square is a circular correlation with a curve that depends on the photo alone, so all
directions come from one product of Fourier transforms.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from skyline.arrays import BoolArray, Complex64Array, Float32Array, Float64Array, IntArray
from skyline.match.rays import Rays
from skyline.paper.correlation import (
    MIN_OVERLAP,
    PITCHES_DEG,
    TANGENT_PER_PX,
    ProfileMatcher,
    Profiles,
    at_pitches,
)
from skyline.paper.curves import (
    PhotoCurve,
    StoredCurves,
    align_curves,
    nearest_patches,
    patch_offsets,
    plausible,
    ransac_maps,
)
from skyline.pose.poses import Poses


@dataclass(frozen=True, slots=True)
class _Search:
    """How widely locations, pitches and directions are searched."""

    at_once: int = 64
    """Locations compared at a time, whose arrays stay in the processor's cache."""
    listed: int = 300
    """Pairs of a location and an assumed pitch on the shortlist."""
    directions: int = 3
    """Directions tried at a location: those on which most correspondences agree."""
    vote_turns: float = 1.0 / 64.0
    """Correspondences vote together for a direction within this share of a turn."""
    reach_turns: float = 1.0 / 32.0
    """Correspondences farther from the direction than this share of a turn are left out: no
    plausible map stretches a view 60 degrees wide by that much."""
    thinning: int = 4
    """Bins that are averaged to one for the shortlist; profiles have a multiple of it."""


_SEARCH = _Search()


class PaperMatcher(ProfileMatcher):
    """The paper's matcher over whole 360 degree profiles.

    The affine map accounts for the roll, and for pitches between the assumed ones.
    """

    def __init__(
        self,
        profiles: Profiles,
        *,
        pitches_deg: Sequence[float] = PITCHES_DEG,
        listed: int = _SEARCH.listed,
    ) -> None:
        super().__init__(profiles)
        self._pitches_deg = pitches_deg
        self._most_listed = listed
        shape = len(profiles), -1, _SEARCH.thinning
        thinned = _bridged(profiles.y).reshape(shape).mean(axis=2)
        # Deviations from the mean keep the differences of sums well conditioned.
        self._thinned_px = (thinned - thinned.mean(axis=1, keepdims=True)) / TANGENT_PER_PX
        self._is_known = np.asarray(np.isfinite(profiles.y).reshape(shape).all(axis=2))

    def fit(self, rays: Rays) -> Poses:
        """Return the best pose at every location; its cost is in px.

        The cost is infinite where nothing fits, and at locations that are not on the shortlist.
        """
        assumed = [
            PhotoCurve.of(*one) for one in at_pitches(rays, self.profiles.bins, self._pitches_deg)
        ]
        fits = _no_fit(len(self.profiles))
        for one, listed in zip(assumed, self._listed(rays), strict=True):
            for start in range(0, len(listed), _SEARCH.at_once):
                rows = listed[start : start + _SEARCH.at_once]
                found = _fits(StoredCurves.of(self.profiles, rows), one)
                better = found[0] < fits[0, rows]
                fits[:, rows[better]] = found[:, better]
        cost, heading_deg, pitch_deg, roll_deg = fits
        return self.profiles.poses(cost, heading_deg, pitch_deg, roll_deg, rays.fov_deg)

    def _listed(self, rays: Rays) -> list[IntArray]:
        """Return the locations on the shortlist, ascending, for each assumed pitch."""
        pitches = at_pitches(rays, self._thinned_px.shape[1], self._pitches_deg)
        curves = [_projected(y, weight) for _, y, weight in pitches]
        distance = _least_distances_px(self._thinned_px, self._is_known, curves)
        best = np.argsort(distance, axis=None, kind="stable")[: self._most_listed]
        listed = np.zeros(distance.shape, dtype=np.bool_)
        listed.flat[best] = np.isfinite(distance.flat[best])
        return [np.flatnonzero(column) for column in listed.T]


def _projected(y: Float64Array, weight: Float64Array) -> tuple[Complex64Array, Float64Array]:
    """Return a photo's curve, prepared for distances after a small warp.

    The curve q (B,) is given as tangents. The results are the conjugate Fourier transforms (2 + F,
    B / 2 + 1) of w, w q and w b, for F curves b of the basis, and the sums (1 + F,) of w q^2 and w
    b q. The weights w have a sum of 1.
    """
    weight = weight / weight.sum()
    bins = np.arange(len(y))
    seen = weight > 0.0
    q = np.interp(bins, bins[seen], y[seen]) / TANGENT_PER_PX
    q -= q @ weight
    azimuth = 2.0 * np.pi / len(y) * (bins - len(y) // 2)
    slope = np.gradient(q)
    root = np.sqrt(weight)
    curves = np.stack([np.ones(len(y)), np.cos(azimuth), np.sin(azimuth), slope, azimuth * slope])
    left, size, _ = np.linalg.svd((curves * root).T, full_matrices=False)
    basis = left[:, size > 1e-6 * size[0]].T * root
    transforms = fft.rfft(np.stack([weight, weight * q, *basis]).astype(np.float32))
    return transforms.conj().astype(np.complex64), np.stack([weight @ q**2, *(basis @ q)])


def _no_fit(locations: int) -> Float64Array:
    """Return fits (4, C) for locations where nothing fits.

    Their cost is infinite.
    """
    return np.concatenate([np.full((1, locations), np.inf), np.zeros((3, locations))])


def _fits(stored: StoredCurves, curve: PhotoCurve) -> Float64Array:
    """Return the fits (4, C) of a photo at one assumed pitch.

    There is one fit at each of C locations. The rows of fits are costs, headings, pitches and
    rolls.
    """
    if not stored.bins.shape[1] or not len(curve.bins):
        return _no_fit(len(stored))
    step_px = stored.bin_px * float(np.diff(patch_offsets(stored.bin_px))[0])
    nearest, distance = nearest_patches(curve.patches, stored.patches, curve.min_known, step_px)
    raw_shift = np.take_along_axis(stored.bins, nearest, axis=1) - curve.bins
    left = np.isfinite(distance)
    directions = []
    for _ in range(_SEARCH.directions):
        directions.append(_agreeing_shifts(raw_shift, left, stored.y_px.shape[1]))
        left = left & ~directions[-1][1]
    shift, agreeing = (np.concatenate(parts) for parts in zip(*directions, strict=True))
    # All directions are fitted together; this step needs only the skylines.
    repeated = replace(stored, y_px=np.tile(stored.y_px, (_SEARCH.directions, 1)))
    fits = _fits_in_direction(repeated, curve, shift, agreeing).reshape(4, _SEARCH.directions, -1)
    return fits[:, fits[0].argmin(axis=0), np.arange(len(stored))]


def _fits_in_direction(
    stored: StoredCurves, curve: PhotoCurve, shift: IntArray, agreeing: BoolArray
) -> Float64Array:
    """Return the fits (4, C) of correspondences that agree in direction."""
    source, target = _corresponding_points(curve, stored, shift)
    used = np.repeat(agreeing, len(curve.local_bins), axis=1)
    used &= np.isfinite(target[..., 1] + source[..., 1])
    affine = align_curves(
        ransac_maps(source, target, used),
        curve.points_px,
        curve.weight,
        stored.y_px,
        stored.bin_px,
    )
    affine[~plausible(affine)] = np.nan
    return _pose(affine, _distance_after_warp_px(affine, curve, stored), curve, stored)


def _agreeing_shifts(shift: IntArray, known: BoolArray, bins: int) -> tuple[IntArray, BoolArray]:
    """Unwrap the shifts of correspondences; mark those near a common direction.

    Azimuth is circular and an affine map is not. A location is seen all the way round, but a
    reference of the paper in one direction. So the direction is found first: the shift with most
    others within `_Search.vote_turns`. Shifts farther from it than `_Search.reach_turns` can only
    be outliers and are left out.

    Shifts (C, Q) are the bin of the location minus the photo's bin in each correspondence;
    ``known`` (C, Q) marks the correspondences that exist. Shifts are returned within half a turn of
    the agreed one.
    """
    half = bins // 2
    apart = np.abs((shift[:, :, np.newaxis] - shift[:, np.newaxis, :] + half) % bins - half)
    votes = ((apart <= bins * _SEARCH.vote_turns) & known[:, np.newaxis, :]).sum(axis=2) * known
    agreed = np.take_along_axis(shift, np.argmax(votes, axis=1)[:, np.newaxis], axis=1)
    away = (shift - agreed + half) % bins - half
    return agreed + away, known & (np.abs(away) <= bins * _SEARCH.reach_turns)


def _corresponding_points(
    curve: PhotoCurve, stored: StoredCurves, shift: IntArray
) -> tuple[Float64Array, Float64Array]:
    """Return the corresponding points, px, of a photo and each location.

    A correspondence of keypoints gives three points: the keypoint, and a point of the local skyline
    to either side of it. The photo has (3 Q, 2), and the locations (C, 3 Q, 2), where y is NaN if
    unknown. Shifts (C, Q) are as in `_agreeing_shifts`.
    """
    x_px = curve.local_px[:, :, 0] + shift[:, :, np.newaxis] * stored.bin_px
    bins = curve.bins[:, np.newaxis] + curve.local_bins + shift[:, :, np.newaxis]
    y_px = stored.at(bins.reshape(len(shift), -1)).reshape(bins.shape)
    target = np.stack([x_px, y_px], axis=-1)
    return curve.local_px.reshape(-1, 2), target.reshape(len(shift), -1, 2)


def _distance_after_warp_px(
    affine: Float64Array, curve: PhotoCurve, stored: StoredCurves
) -> Float64Array:
    """Return the rms distances (C,) of a warped skyline from stored ones.

    Each point of the photo's skyline is warped. Its distance is vertical, to the stored skyline at
    the azimuth where it lands; the mean square is by the points' weights. The distance is infinite
    where the map is NaN, or less than `MIN_OVERLAP` of the weight lands on known profile.
    """
    bins = stored.y_px.shape[1]
    warped = np.where(np.isfinite(affine), affine, 0.0)
    moved = curve.points_px @ warped[:, :, :2].transpose(0, 2, 1) + warped[:, np.newaxis, :, 2]
    position = moved[:, :, 0] / stored.bin_px + bins // 2
    left = np.floor(position).astype(np.intp)
    share = position - left
    there = stored.at(left) * (1.0 - share) + stored.at(left + 1) * share
    difference = moved[:, :, 1] - there
    weight = np.where(np.isfinite(difference), curve.weight, 0.0)
    total = weight.sum(axis=1)
    fits = np.isfinite(affine).all(axis=(1, 2)) & (total >= MIN_OVERLAP * curve.weight.sum())
    squared = (weight * np.nan_to_num(difference) ** 2).sum(axis=1)
    return np.where(fits, np.sqrt(squared / np.where(fits, total, 1.0)), np.inf)


def _pose(
    affine: Float64Array, cost: Float64Array, curve: PhotoCurve, stored: StoredCurves
) -> Float64Array:
    """Return the fits (4, C) that follow from maps.

    A map shows where the axis goes and how it turns. It is evaluated above or below the axis, at
    the skyline's mean height: the points from which the map was made lie there, and its shear is
    too poorly known elsewhere.
    """
    affine = np.where(np.isfinite(cost)[:, np.newaxis, np.newaxis], affine, 0.0)
    mean_y_px = np.average(curve.points_px[:, 1], weights=curve.weight)
    x_px, y_px = (affine[:, :, 1] * mean_y_px + affine[:, :, 2]).T
    raised = np.arctan(y_px * TANGENT_PER_PX) - np.arctan(mean_y_px * TANGENT_PER_PX)
    bins = stored.y_px.shape[1]
    turn_deg = np.degrees(np.arctan2(affine[:, 1, 0], affine[:, 0, 0]))
    heading_deg = (x_px / stored.bin_px + bins // 2) * (360.0 / bins) % 360.0
    return np.stack([cost, heading_deg, curve.pitch_deg + np.degrees(raised), -turn_deg])


def _least_distances_px(
    y_px: Float32Array,
    is_known: BoolArray,
    curves: Sequence[tuple[Complex64Array, Float64Array]],
) -> Float32Array:
    """Return the least distances (L, A) of profiles to curves.

    Profiles are (L, B), and the A curves come from `_projected`. A distance is infinite where less
    than `MIN_OVERLAP` of a curve's weight lands on known profile.
    """
    bins = y_px.shape[1]
    least = np.empty((len(y_px), len(curves)), dtype=np.float32)
    for start in range(0, len(y_px), _SEARCH.at_once):
        rows = slice(start, start + _SEARCH.at_once)
        squares = fft.rfft(np.square(y_px[rows]))
        values = fft.rfft(y_px[rows])
        known = None if is_known[rows].all() else fft.rfft(is_known[rows].astype(np.float32))
        for column, (transforms, products) in enumerate(curves):
            weight, weighted, *_ = transforms
            basis = transforms[2:]
            rest = fft.irfft(squares * weight - 2.0 * values * weighted, bins) + products[0]
            along = fft.irfft(values[:, np.newaxis] * basis, bins) - products[1:, np.newaxis]
            rest -= np.square(along).sum(axis=1)
            if known is not None:
                rest[fft.irfft(known * weight, bins) < MIN_OVERLAP - 1e-4] = np.inf
            least[rows, column] = np.sqrt(np.maximum(rest.min(axis=1), 0.0))
    return least


def _bridged(y: Float32Array) -> Float32Array:
    """Return curves (L, B) with straight lines over unknown bins.

    A curve without any known bin is 0.
    """
    bins = np.arange(y.shape[1])
    filled = np.nan_to_num(y)
    for row in np.flatnonzero(np.isnan(y).any(axis=1)):
        known = np.isfinite(y[row])
        if known.any():
            filled[row] = np.interp(bins, bins[known], y[row, known], period=len(bins))
    return filled

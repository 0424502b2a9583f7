"""Section 3, matching: the affine map between two skylines.

RANSAC finds the map that most correspondences agree on. That map rests on keypoints, whose place
along a smooth skyline is uncertain by several px, so it is then refined on the whole curve. Without
this step the distance after warping depends more on RANSAC's random choices than on the likeness of
the skylines.
"""

import cv2
import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array

INLIER_PX = 4.0
"""A correspondence agrees with a map that puts its point this near."""

_RANSAC_ROUNDS = 100

_MIN_INLIERS = 3
"""Fewer correspondences define no affine map."""

_MAX_SCALE = 1.25
"""Singular values of a map lie between 1 / 1.25 and 1.25."""

_MAX_TURN_DEG = 15.0

_ALIGN_ROUNDS = 6
_DAMPING = 1e-3


def ransac_maps(source: Float64Array, target: Float64Array, used: BoolArray) -> Float64Array:
    """Return the affine maps that most correspondences agree on, by OpenCV's RANSAC.

    Points of a low skyline lie nearly on a line, which leaves an affine map undetermined across
    that line. Where the affine map is not plausible, the similarity on which most correspondences
    agree is taken instead.

    Parameters
    ----------
    source : (P, 2) float64
    target : (F, P, 2) float64
        The points in each of F sets of correspondences.
    used : (F, P) bool
        True where a correspondence exists; target may be NaN where it does not.

    Returns
    -------
    (F, 2, 3) float64
        NaN where no plausible map is found.
    """
    maps = np.full((len(target), 2, 3), np.nan)
    for estimate in (cv2.estimateAffine2D, cv2.estimateAffinePartial2D):
        for row in np.flatnonzero(~plausible(maps) & (used.sum(axis=1) >= _MIN_INLIERS)):
            found, _ = estimate(
                source[used[row]],
                target[row, used[row]],
                method=cv2.RANSAC,
                ransacReprojThreshold=INLIER_PX,
                maxIters=_RANSAC_ROUNDS,
            )
            if found is not None:
                maps[row] = found
    maps[~plausible(maps)] = np.nan
    return maps


def plausible(maps: Float64Array) -> BoolArray:
    """Return which maps (F, 2, 3) neither mirror nor turn nor scale too much; False for NaN."""
    linear = np.nan_to_num(maps[..., :2])
    scale = np.linalg.svd(linear, compute_uv=False)
    turn_deg = np.degrees(np.arctan2(linear[..., 1, 0], linear[..., 0, 0]))
    return np.asarray(
        (np.linalg.det(linear) > 0.0)
        & (scale[..., 0] <= _MAX_SCALE)
        & (scale[..., 1] >= 1.0 / _MAX_SCALE)
        & (np.abs(turn_deg) <= _MAX_TURN_DEG)
    )


def align_curves(
    affine: Float64Array,
    points_px: Float64Array,
    weight: Float64Array,
    y_px: Float32Array,
    bin_px: float,
) -> Float64Array:
    """Return better affine maps (C, 2, 3) from one curve to each of C closed curves.

    Damped Gauss-Newton on the vertical distance between the warped points and the curve at the
    azimuth they land on. A point farther off than about `INLIER_PX` counts less and less.

    Parameters
    ----------
    affine : (C, 2, 3) float64
        Maps to start from; NaN stays NaN.
    points_px, weight : (R, 2), (R,) float64
        Points of the curve, x from straight ahead, and the trust in each.
    y_px : (C, B) float32
        The other curves, over a whole turn.
    bin_px : float
        Width of a bin.
    """
    count, bins = y_px.shape
    slope = (np.roll(y_px, -1, axis=1) - np.roll(y_px, 1, axis=1)) / np.float32(2.0 * bin_px)
    # The first bin is repeated at the end, so that the bins on both sides of a position are
    # neighbours.
    flat_y, flat_slope = (np.hstack([c, c[:, :1]]).ravel() for c in (y_px, slope))
    begin = np.arange(count)[:, np.newaxis] * (bins + 1)
    homogeneous = np.concatenate([points_px, np.ones((len(points_px), 1))], axis=1)
    affine = affine.copy()
    for _ in range(_ALIGN_ROUNDS):
        x, y = np.moveaxis(np.nan_to_num(affine) @ homogeneous.T, 1, 0)
        position = x / bin_px + bins // 2
        position -= bins * np.floor(position / bins)
        left = np.minimum(position.astype(np.intp), bins - 1)
        share = position - left
        at = begin + left
        there = flat_y.take(at)
        there = there + (flat_y.take(at + 1) - there) * share
        steepness = flat_slope.take(at + (share > 0.5))
        miss = y - there
        usable = np.isfinite(miss) & np.isfinite(steepness)
        miss, steepness = np.where(usable, miss, 0.0), np.where(usable, steepness, 0.0)
        pull = np.where(usable, weight, 0.0) / (1.0 + (miss / INLIER_PX) ** 2)
        normal, gradient = _normal_equations(pull, steepness, miss, homogeneous)
        diagonal = np.einsum("ckk->ck", normal)
        damping = _DAMPING * diagonal + 1e-9 * (1.0 + diagonal.max(axis=1, keepdims=True))
        normal += damping[:, :, np.newaxis] * np.eye(6)
        affine -= np.linalg.solve(normal, gradient[:, :, np.newaxis]).reshape(count, 2, 3)
    return affine


def _normal_equations(
    pull: Float64Array, steepness: Float64Array, miss: Float64Array, points: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the matrices (C, 6, 6) and right-hand sides (C, 6) of the least squares.

    A miss changes with the map's entries by (-steepness * p, p), where p are the homogeneous
    points (R, 3) that all maps share; so all sums over the points are products of two matrices.
    """
    outer = (points[:, :, np.newaxis] * points[:, np.newaxis]).reshape(-1, 9)
    slanted = pull * steepness
    of_y, of_both, of_x = (
        (weight @ outer).reshape(-1, 3, 3) for weight in (pull, slanted, slanted * steepness)
    )
    upper = np.concatenate([of_x, -of_both], axis=2)
    lower = np.concatenate([-of_both, of_y], axis=2)
    gradient = np.concatenate([-(slanted * miss) @ points, (pull * miss) @ points], axis=1)
    return np.concatenate([upper, lower], axis=1), gradient

"""Least-squares alignment of a curve to many others by an affine map.

RANSAC's map rests on keypoints, whose place along a smooth skyline is uncertain by several px;
the whole curve then says where it fits best. Without this the distance after warping measures
RANSAC's luck more than the likeness of the skylines.
"""

import numpy as np

from skyline.arrays import Float32Array, Float64Array

_ROUNDS = 6
_DAMPING = 1e-3


def align_curves(
    affine: Float64Array,
    points_px: Float64Array,
    weight: Float64Array,
    y_px: Float32Array,
    bin_px: float,
    outlier_px: float,
) -> Float64Array:
    """Return better affine maps (C, 2, 3) from one curve to each of C closed curves.

    Damped Gauss-Newton on the vertical distance between the warped points and the curve at the
    azimuth they land on. A point farther off than about ``outlier_px`` counts less and less.

    Parameters
    ----------
    affine : (C, 2, 3) float64
        Maps to start from; NaN stays NaN.
    points_px, weight : (R, 2), (R,) float64
        Points of the curve, x from straight ahead, and how far each is trusted.
    y_px : (C, B) float32
        The other curves, over a whole turn.
    bin_px : float
        Width of a bin.
    outlier_px : float
        Scale of the Cauchy weights.
    """
    count, bins = y_px.shape
    slope = (np.roll(y_px, -1, axis=1) - np.roll(y_px, 1, axis=1)) / np.float32(2.0 * bin_px)
    # The first bin again at the end: the bins to either side of a position are then neighbours.
    flat_y, flat_slope = (np.hstack([c, c[:, :1]]).ravel() for c in (y_px, slope))
    begin = np.arange(count)[:, np.newaxis] * (bins + 1)
    homogeneous = np.concatenate([points_px, np.ones((len(points_px), 1))], axis=1)
    affine = affine.copy()
    for _ in range(_ROUNDS):
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
        pull = np.where(usable, weight, 0.0) / (1.0 + (miss / outlier_px) ** 2)
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

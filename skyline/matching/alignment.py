"""Least-squares alignment of a curve to many others by an affine map.

RANSAC's map rests on keypoints, whose place along a smooth skyline is uncertain by several px;
the whole curve then says where it fits best. Without this the distance after warping measures
RANSAC's luck more than the likeness of the skylines.
"""

import numpy as np
from numpy.typing import NDArray

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]

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
    """Improve affine maps from one curve to each of C closed curves.

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

    Returns
    -------
    (C, 2, 3) float64
    """
    count, bins = y_px.shape
    slope = (np.roll(y_px, -1, axis=1) - np.roll(y_px, 1, axis=1)) / np.float32(2.0 * bin_px)
    homogeneous = np.concatenate([points_px, np.ones((len(points_px), 1))], axis=1)
    row = np.arange(count)[:, np.newaxis]
    affine = affine.copy()
    for _ in range(_ROUNDS):
        x, y = np.moveaxis(np.nan_to_num(affine) @ homogeneous.T, 1, 0)
        position = x / bin_px + bins // 2
        left = np.floor(position).astype(np.intp)
        share = position - left
        there = y_px[row, left % bins] * (1.0 - share) + y_px[row, (left + 1) % bins] * share
        steepness = slope[row, np.rint(position).astype(np.intp) % bins]
        miss = y - there
        usable = np.isfinite(miss) & np.isfinite(steepness)
        miss, steepness = np.where(usable, miss, 0.0), np.where(usable, steepness, 0.0)
        pull = np.where(usable, weight, 0.0) / (1.0 + (miss / outlier_px) ** 2)
        change = np.concatenate(
            [
                -steepness[:, :, np.newaxis] * homogeneous,
                np.broadcast_to(homogeneous, (count, *homogeneous.shape)),
            ],
            axis=2,
        )
        weighted = change * pull[:, :, np.newaxis]
        normal = np.einsum("crk,crl->ckl", weighted, change)
        gradient = np.einsum("crk,cr->ck", weighted, miss)
        diagonal = np.einsum("ckk->ck", normal)
        damping = _DAMPING * diagonal + 1e-9 * (1.0 + diagonal.max(axis=1, keepdims=True))
        normal += damping[:, :, np.newaxis] * np.eye(6)
        affine -= np.linalg.solve(normal, gradient[:, :, np.newaxis]).reshape(count, 2, 3)
    return affine

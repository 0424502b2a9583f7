"""Chamfer distance between local skylines, and the stored keypoint nearest to a query's by it."""

import numpy as np

from skyline.arrays import Float32Array, IntArray

_PAIRS = 4096
"""Pairs at a time; keeps the arrays of one step in the cache."""

_FAR_PX = np.float32(1e6)

_CLOSELY = 4
"""Stored patches that a query patch is compared with by Chamfer distance."""


def chamfer_px(a: Float32Array, b: Float32Array, step_px: float) -> Float32Array:
    """Return the symmetric Chamfer distances (M,) of pairs of patches.

    The samples of a patch are points (step_px * i, value). The distance is the mean over the
    points of either patch of the distance to the nearest point of the other, the two means
    averaged. Only offsets at which both patches are known take part; it is infinite for a pair
    without any.

    Parameters
    ----------
    a, b : (M, S) float32
        Patches in px, NaN where unknown.
    step_px : float
        Distance between neighbouring samples.
    """
    return np.concatenate(
        [np.zeros(0, dtype=np.float32)]
        + [
            _chamfer_block(a[k : k + _PAIRS].T, b[k : k + _PAIRS].T, np.float32(step_px))
            for k in range(0, len(a), _PAIRS)
        ]
    )


def _chamfer_block(a: Float32Array, b: Float32Array, step_px: np.float32) -> Float32Array:
    """As `chamfer_px` on (S, M) arrays, samples first so that each step runs along pairs."""
    known = np.isfinite(a) & np.isfinite(b)
    # Unknown points are put so far off, on opposite sides, that none is anyone's nearest.
    a, b = np.where(known, a, _FAR_PX), np.where(known, b, -_FAR_PX)
    x = step_px * np.arange(len(a), dtype=np.float32)
    from_a = np.empty_like(a)
    from_b = np.full_like(b, np.inf)
    for i in range(len(a)):
        squared = b - a[i]
        squared *= squared
        squared += np.square(x - x[i])[:, np.newaxis]
        np.min(squared, axis=0, out=from_a[i])
        np.minimum(from_b, squared, out=from_b)
    total = np.where(known, np.sqrt(from_a) + np.sqrt(from_b), 0.0).sum(axis=0)
    count = known.sum(axis=0)
    return np.where(count > 0, total / (2 * np.maximum(count, 1)), np.inf).astype(np.float32)


def nearest_patches(
    query: Float32Array,
    stored: Float32Array,
    mean_squared: Float32Array,
    step_px: float,
) -> tuple[IntArray, Float32Array]:
    """Return the stored patch of each location nearest to each query patch, and how near.

    The Chamfer distance is computed for the few stored patches that come nearest by mean squared
    vertical difference. A curve that is near by Chamfer is near vertically unless it is steep, so
    few short lists miss the nearest.

    Parameters
    ----------
    query : (Q, S) float32
        Patches in px, NaN where unknown.
    stored : (C, K, S) float32
        The patches of C locations.
    mean_squared : (C, Q, K) float32
        Of `mean_squared_px2`; infinite for pairs not to be compared.
    step_px : float
        Distance between neighbouring samples.

    Returns
    -------
    index : (C, Q) intp
        Into the K patches of the location.
    distance_px : (C, Q) float32
        Infinite where nothing could be compared.
    """
    shortlist = min(_CLOSELY, stored.shape[1])
    near = np.argpartition(mean_squared, shortlist - 1, axis=2)[:, :, :shortlist]
    comparable = np.isfinite(np.take_along_axis(mean_squared, near, axis=2))
    which, q, slot = np.nonzero(comparable)
    distance = np.full(near.shape, np.inf, dtype=np.float32)
    distance[which, q, slot] = chamfer_px(query[q], stored[which, near[which, q, slot]], step_px)
    best = np.argmin(distance, axis=2)[:, :, np.newaxis]
    return (
        np.take_along_axis(near, best, axis=2)[:, :, 0],
        np.take_along_axis(distance, best, axis=2)[:, :, 0],
    )


def mean_squared_px2(query: Float32Array, stored: Float32Array, min_known: int) -> Float32Array:
    """Return mean squared vertical differences (C, Q, K) of query patches with stored ones, px2.

    They are taken over common offsets, and infinite where there are too few.

    Parameters
    ----------
    query : (Q, S) float32
        Patches in px, NaN where unknown.
    stored : (C, K, S) float32
        The patches of C locations, NaN where unknown, all NaN where a location has fewer.
    min_known : int
        Pairs with fewer common offsets are not compared.
    """
    query_known, stored_known = np.isfinite(query), np.isfinite(stored)
    m, n = query_known.astype(np.float32), stored_known.astype(np.float32)
    a, b = np.where(query_known, query, 0.0), np.where(stored_known, stored, 0.0)
    left = np.concatenate([a * a, m, -2.0 * a], axis=1).astype(np.float32)
    right = np.concatenate([n, b * b, b], axis=2).astype(np.float32)
    common = m @ n.transpose(0, 2, 1)
    total = left @ right.transpose(0, 2, 1)
    return np.where(common >= min_known, total / np.maximum(common, 1.0), np.inf).astype(np.float32)

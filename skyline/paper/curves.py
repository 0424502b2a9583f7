"""Section 3, matching: local skylines, Chamfer distances, affine maps.

Curves are over azimuth and tangent of elevation, both in px of a 640 column view. A patch is the
local skyline of a keypoint, S samples of it relative to the keypoint.

RANSAC finds the map with which most correspondences agree. That map rests on keypoints, whose place
along a smooth skyline is uncertain by several px, so it is then refined on the whole curve. Without
this step, the distance after warping depends more on RANSAC's random choices than on the likeness
of the skylines.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray, IntArray
from skyline.paper.correlation import TANGENT_PER_PX, Profiles, bin_width_px
from skyline.skylines import NO_KEYPOINT, polyline_vertices

INLIER_PX = 4.0
"""A correspondence agrees with a map that puts its point within this distance."""


def patch_offsets(bin_px: float) -> IntArray:
    """Return the offsets of a patch's samples from its keypoint, in bins.

    Samples are about 4 px apart, and reach about 40 px to either side.
    """
    step = max(1, round(4.0 / bin_px))
    half = max(1, round(40.0 / bin_px / step))
    return np.arange(-half, half + 1, dtype=np.intp) * step


@dataclass(frozen=True, slots=True, eq=False)
class PhotoCurve:
    """A photo's skyline at one assumed pitch: R points and Q keypoints."""

    points_px: Float64Array
    """(R, 2) float64. Points of the skyline: x from the optical axis, and y."""
    weight: Float64Array
    """(R,) float64. Weights of the points."""
    bins: IntArray
    """(Q,) intp. Bins of the keypoints; bin B / 2 is straight ahead."""
    local_bins: IntArray
    """(3,) intp. Bins of three points of a local skyline, relative to its keypoint."""
    local_px: Float64Array
    """(Q, 3, 2) float64. These points of each local skyline."""
    patches: Float32Array
    """(Q, S) float32. Local skylines relative to their keypoints; NaN where unknown."""
    pitch_deg: float

    @classmethod
    def of(cls, pitch_deg: float, y: Float64Array, weight: Float64Array) -> Self:
        """Return the curve at one of the pitches of `at_pitches`.

        At most 64 keypoints are found, with the tolerance of a store's keypoints, 1 px.
        """
        table = polyline_vertices(y[np.newaxis], 1.0 * TANGENT_PER_PX, 64)
        keypoints = table[table != NO_KEYPOINT].astype(np.intp)
        y_px = y / TANGENT_PER_PX
        bin_px = bin_width_px(len(y_px))
        offsets = patch_offsets(bin_px)
        x_px = (np.arange(len(y_px)) - len(y_px) // 2) * bin_px
        seen = np.flatnonzero(weight > 0.0)
        local_bins = np.array([-1, 0, 1], dtype=np.intp) * (offsets[-1] // 2)
        near = np.clip(keypoints[:, np.newaxis] + local_bins, 0, len(y_px) - 1)
        rows = np.zeros(len(keypoints), dtype=np.intp)
        patches = local_patches(y_px[np.newaxis], rows, keypoints, offsets)
        return cls(
            np.stack([x_px[seen], y_px[seen]], axis=1),
            weight[seen],
            keypoints,
            local_bins,
            np.stack([x_px[near], y_px[near]], axis=-1),
            patches.astype(np.float32),
            pitch_deg,
        )

    @property
    def min_known(self) -> int:
        """Number of samples that two patches must have in common."""
        return 3 * int(self.patches.shape[1]) // 4


@dataclass(frozen=True, slots=True, eq=False)
class StoredCurves:
    """Skylines of C locations of a store, with K keypoints each.

    Locations with fewer keypoints are padded.
    """

    y_px: Float32Array
    """(C, B) float32. Ordinates of the skylines; NaN where unknown."""
    bins: IntArray
    """(C, K) intp. Bins of the keypoints; 0 where padded."""
    patches: Float32Array
    """(C, K, S) float32. Local skylines relative to their keypoints; NaN where unknown and where
    padded."""
    bin_px: float
    """Width of a bin."""

    @classmethod
    def of(cls, profiles: Profiles, rows: IntArray) -> Self:
        """Return the skylines of the locations ``rows``."""
        offsets = patch_offsets(profiles.bin_px)
        y_px = profiles.y[rows] / np.float32(TANGENT_PER_PX)
        begin = profiles.keypoint_start[rows]
        count = profiles.keypoint_start[rows + 1] - begin
        row = np.repeat(np.arange(len(rows)), count)
        slot = np.arange(len(row)) - (np.cumsum(count) - count)[row]
        bin_ = profiles.keypoint_bin[begin[row] + slot]
        bins = np.zeros((len(rows), int(count.max(initial=0))), dtype=np.intp)
        bins[row, slot] = bin_
        patches = np.full((*bins.shape, len(offsets)), np.nan, dtype=np.float32)
        patches[row, slot] = local_patches(y_px, row, bin_, offsets)
        return cls(y_px, bins, patches, profiles.bin_px)

    def __len__(self) -> int:
        return len(self.y_px)

    def at(self, bins: IntArray) -> Float32Array:
        """Return ordinates (C, ...) at bins (C, ...), counted round the turn."""
        return np.take_along_axis(self.y_px, bins % self.y_px.shape[1], axis=1)


def local_patches(
    curves: FloatArray, row: IntArray, column: IntArray, offsets: IntArray
) -> FloatArray:
    """Return patches (M, S) of closed curves (N, B) around M keypoints.

    Keypoints are at a curve's ``row`` (M,) and ``column`` (M,); ``offsets`` (S,) are columns from
    there. Values count from the keypoint's, and are NaN in a gap.
    """
    at = (column[:, np.newaxis] + offsets) % curves.shape[1]
    patch: FloatArray = curves[row[:, np.newaxis], at] - curves[row, column][:, np.newaxis]
    return patch


def chamfer_px(a: Float32Array, b: Float32Array, step_px: float) -> Float32Array:
    """Return the Chamfer distances (M,), px, of pairs of patches (M, S).

    The samples of a patch are points (step_px * i, value). Each point of a patch has a distance to
    the nearest point of the other; the distance of the pair is the mean of these over both patches.
    Only offsets at which both patches are known (not NaN) take part; the distance of a pair without
    any is infinite.
    """
    pairs = 4096  # Compared at a time: the arrays of one step stay in the processor's cache.
    return np.concatenate(
        [np.zeros(0, dtype=np.float32)]
        + [
            _chamfer_block(a[k : k + pairs].T, b[k : k + pairs].T, np.float32(step_px))
            for k in range(0, len(a), pairs)
        ]
    )


def _chamfer_block(a: Float32Array, b: Float32Array, step_px: np.float32) -> Float32Array:
    """Return `chamfer_px` of (S, M) arrays.

    Samples come first, so that each step runs along pairs.
    """
    known = np.isfinite(a) & np.isfinite(b)
    # Unknown points are put so far off, on opposite sides, that none is the nearest of any point.
    far_px = np.float32(1e6)
    a = np.where(known, a, far_px)
    b = np.where(known, b, -far_px)
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
    patches: Float32Array, stored: Float32Array, min_known: int, step_px: float
) -> tuple[IntArray, Float32Array]:
    """Return the nearest stored patches to a photo's, and their distances.

    The Chamfer distance is computed for the four stored patches that come nearest by mean squared
    vertical difference, which products of matrices give. Curves that are near by Chamfer distance
    are near vertically unless they are steep, so the four rarely miss the nearest.

    ``patches`` (Q, S) are the photo's, ``stored`` (C, K, S) the locations', in px. Unknown samples
    are NaN; where a location has fewer than K patches, the rest are all NaN. Pairs with fewer than
    ``min_known`` common offsets are not compared. The result has, for each location, indices (C, Q)
    into its K patches, and distances (C, Q), which are infinite where nothing could be compared.
    """
    is_known = np.isfinite(patches)
    is_stored = np.isfinite(stored)
    m = is_known.astype(np.float32)
    n = is_stored.astype(np.float32)
    a = np.where(is_known, patches, 0.0)
    b = np.where(is_stored, stored, 0.0)
    left = np.concatenate([a * a, m, -2.0 * a], axis=1).astype(np.float32)
    right = np.concatenate([n, b * b, b], axis=2).astype(np.float32)
    common = m @ n.transpose(0, 2, 1)
    total = left @ right.transpose(0, 2, 1)
    squared = np.where(common >= min_known, total / np.maximum(common, 1.0), np.float32(np.inf))
    closely = min(4, stored.shape[1])
    near = np.argpartition(squared, closely - 1, axis=2)[:, :, :closely]
    comparable = np.isfinite(np.take_along_axis(squared, near, axis=2))
    which, q, slot = np.nonzero(comparable)
    distance = np.full(near.shape, np.inf, dtype=np.float32)
    distance[which, q, slot] = chamfer_px(patches[q], stored[which, near[which, q, slot]], step_px)
    best = np.argmin(distance, axis=2)[:, :, np.newaxis]
    return (
        np.take_along_axis(near, best, axis=2)[:, :, 0],
        np.take_along_axis(distance, best, axis=2)[:, :, 0],
    )


def ransac_maps(source: Float64Array, target: Float64Array, used: BoolArray) -> Float64Array:
    """Return the affine maps with which most correspondences agree (RANSAC).

    Points of a low skyline lie nearly on a line, which leaves an affine map undetermined across
    that line. If the affine map is not plausible, the similarity with which most correspondences
    agree is taken instead.

    Points ``source`` (P, 2) are mapped to ``target`` (F, P, 2), in each of F sets of
    correspondences; ``used`` (F, P) is true where one exists. Maps are (F, 2, 3), NaN where no
    plausible one is found.
    """
    maps = np.full((len(target), 2, 3), np.nan)
    # Fewer than three correspondences define no affine map.
    is_defined = used.sum(axis=1) >= 3
    for estimate in (cv2.estimateAffine2D, cv2.estimateAffinePartial2D):
        for row in np.flatnonzero(~plausible(maps) & is_defined):
            found, _ = estimate(
                source[used[row]],
                target[row, used[row]],
                method=cv2.RANSAC,
                ransacReprojThreshold=INLIER_PX,
                maxIters=100,
            )
            if found is not None:
                maps[row] = found
    maps[~plausible(maps)] = np.nan
    return maps


def plausible(maps: Float64Array) -> BoolArray:
    """Return which maps (F, 2, 3) are plausible.

    They do not mirror, and do not turn or scale too much. A turn is at most 15 degrees, and
    singular values lie between 1 / 1.25 and 1.25. A map of NaN is not plausible.
    """
    max_scale = 1.25
    linear = np.nan_to_num(maps[..., :2])
    scale = np.linalg.svd(linear, compute_uv=False)
    turn_deg = np.degrees(np.arctan2(linear[..., 1, 0], linear[..., 0, 0]))
    return np.asarray(
        (np.linalg.det(linear) > 0.0)
        & (scale[..., 0] <= max_scale)
        & (scale[..., 1] >= 1.0 / max_scale)
        & (np.abs(turn_deg) <= 15.0)
    )


def align_curves(
    affine: Float64Array,
    points_px: Float64Array,
    weight: Float64Array,
    y_px: Float32Array,
    bin_px: float,
) -> Float64Array:
    """Improve affine maps (C, 2, 3) from a curve to closed curves.

    There is one map to each of C closed curves. Six damped Gauss-Newton steps reduce the vertical
    distance between the warped points and the closed curve at the azimuth where they land. A point
    farther off than about `INLIER_PX` counts less and less. A map of NaN stays NaN.

    The abscissas of the curve's points (R, 2) count from straight ahead, and each point has a
    weight (R,). Ordinates of the closed curves are (C, B), over a whole turn, in bins ``bin_px``
    wide.
    """
    count, bins = y_px.shape
    slope = (np.roll(y_px, -1, axis=1) - np.roll(y_px, 1, axis=1)) / np.float32(2.0 * bin_px)
    # The first bin is repeated at the end, so that the bins on both sides of a position are
    # neighbours.
    flat_y, flat_slope = (np.hstack([c, c[:, :1]]).ravel() for c in (y_px, slope))
    begin = np.arange(count)[:, np.newaxis] * (bins + 1)
    homogeneous = np.concatenate([points_px, np.ones((len(points_px), 1))], axis=1)
    affine = affine.copy()
    for _ in range(6):
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
        miss = np.where(usable, miss, 0.0)
        steepness = np.where(usable, steepness, 0.0)
        pull = np.where(usable, weight, 0.0) / (1.0 + (miss / INLIER_PX) ** 2)
        normal, gradient = _normal_equations(pull, steepness, miss, homogeneous)
        diagonal = np.einsum("ckk->ck", normal)
        damping = 1e-3 * diagonal + 1e-9 * (1.0 + diagonal.max(axis=1, keepdims=True))
        normal += damping[:, :, np.newaxis] * np.eye(6)
        affine -= np.linalg.solve(normal, gradient[:, :, np.newaxis]).reshape(count, 2, 3)
    return affine


def _normal_equations(
    pull: Float64Array, steepness: Float64Array, miss: Float64Array, points: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Return the normal equations of least squares.

    They are matrices (C, 6, 6) and right-hand sides (C, 6). A miss changes with the map's entries
    by (-steepness * p, p), where p are the homogeneous points (R, 3) that all maps share; so all
    sums over the points are products of two matrices.
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

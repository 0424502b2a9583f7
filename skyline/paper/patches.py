"""Query and stored skylines in px with the local skylines around their keypoints."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import Float32Array, Float64Array, IntArray
from skyline.match.profiles import TANGENT_PER_PX, Profiles
from skyline.match.query_rays import QueryCurves
from skyline.store.keypoints import NO_KEYPOINT, local_patches, polyline_vertices

_TOLERANCE_PX = 1.0
"""Of the query's polyline; best that of the store's."""

_MAX_KEYPOINTS = 64
"""Of the query."""

_HALF_PX, _STEP_PX = 40.0, 4.0
"""Reach of a local skyline to either side of its keypoint, and distance of its samples."""

MIN_OVERLAP = 0.8
"""Least share of the query's weight that must land on known profile."""


def patch_offsets(bin_px: float) -> IntArray:
    """Return the offsets of a patch's samples in bins of a width, symmetric about 0."""
    step = max(1, round(_STEP_PX / bin_px))
    half = max(1, round(_HALF_PX / bin_px / step))
    return np.arange(-half, half + 1, dtype=np.intp) * step


@dataclass(frozen=True, slots=True, eq=False)
class QueryCurve:
    """The query at one assumed attitude: R points of its skyline and Q keypoints, in px."""

    points_px: Float64Array
    """(R, 2) float64. x from the optical axis, and y."""
    weight: Float64Array
    """(R,) float64."""
    point_bins: IntArray
    """(R,) intp. Bin B / 2 is straight ahead."""
    bins: IntArray
    """(Q,) intp. Of the keypoints."""
    local_bins: IntArray
    """(3,) intp. Points of a local skyline, relative to its keypoint."""
    local_px: Float64Array
    """(Q, 3, 2) float64. Those points."""
    patches: Float32Array
    """(Q, S) float32. Local skylines relative to their keypoints; NaN where unknown."""
    pitch_deg: float
    roll_deg: float

    @classmethod
    def of(cls, curves: QueryCurves, row: int) -> Self:
        """Take the query at attitude ``row``."""
        y = curves.y[row : row + 1]
        table = polyline_vertices(y, _TOLERANCE_PX * TANGENT_PER_PX, _MAX_KEYPOINTS)
        keypoints = table[table != NO_KEYPOINT].astype(np.intp)
        y_px = y[0] / TANGENT_PER_PX
        bin_px = 2.0 * np.pi / len(y_px) / TANGENT_PER_PX
        offsets = patch_offsets(bin_px)
        x_px = (np.arange(len(y_px)) - len(y_px) // 2) * bin_px
        seen = np.flatnonzero(curves.weight[row] > 0.0)
        local_bins = np.array([-1, 0, 1], dtype=np.intp) * (offsets[-1] // 2)
        near = np.clip(keypoints[:, np.newaxis] + local_bins, 0, len(y_px) - 1)
        rows = np.zeros(len(keypoints), dtype=np.intp)
        patches = local_patches(y_px[np.newaxis], rows, keypoints, offsets)
        return cls(
            np.stack([x_px[seen], y_px[seen]], axis=1),
            curves.weight[row, seen],
            seen,
            keypoints,
            local_bins,
            np.stack([x_px[near], y_px[near]], axis=-1),
            patches.astype(np.float32),
            float(curves.pitch_deg[row]),
            float(curves.roll_deg[row]),
        )

    @property
    def min_known(self) -> int:
        """Samples that two patches must have in common."""
        return 3 * int(self.patches.shape[1]) // 4


@dataclass(frozen=True, slots=True, eq=False)
class StoredCurves:
    """C locations of a store: skylines and, padded to the most, K keypoints each, in px."""

    y_px: Float32Array
    """(C, B) float32. NaN where unknown."""
    bins: IntArray
    """(C, K) intp. Of the keypoints; 0 where padded."""
    patches: Float32Array
    """(C, K, S) float32. Local skylines relative to their keypoints; NaN where unknown and where
    padded."""
    bin_px: float
    """Width of a bin."""

    @classmethod
    def of(cls, profiles: Profiles, rows: IntArray) -> Self:
        """Take the locations ``rows``."""
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
        """Return y in px (C, ...) at bins (C, ...) of each location, which may be off the turn."""
        return np.take_along_axis(self.y_px, bins % self.y_px.shape[1], axis=1)

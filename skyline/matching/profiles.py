"""The stored views of each location joined to one 360 degree profile."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, IntArray
from skyline.camera import DEFAULT_WIDTH, pixel_size
from skyline.errors import InputError
from skyline.features import NO_KEYPOINT
from skyline.horizons import check_bins
from skyline.matching.panoramas import quadrant_bins, quadrant_columns
from skyline.views import FLAG_NO_DATA, FLAG_OUT_OF_IMAGE, Views

DEFAULT_BINS = 2048
"""At 2048 a bin is 0.176 degrees, as good as a pixel at the centre of a 640 column view."""

TANGENT_PER_PX = pixel_size(DEFAULT_WIDTH)
"""Scores are in px of a view of the paper's width, whatever the width of the store."""

KeypointTable = NDArray[np.uint16]


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Skylines of L locations all the way round, in B equal steps of grid azimuth."""

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    """``easting_m``, ``northing_m``, ``eye_elevation_m``: (L,) float64."""
    y: Float32Array
    """(L, B) float32. Tangent of the skyline's elevation angle at azimuth 360 b / B degrees; NaN
    where no view looks or the view has no data."""
    keypoint_bin: IntArray
    """(M,) intp. Bins of the keypoints, ascending within each location, the locations one after
    another."""
    keypoint_start: IntArray
    """(L + 1,) intp. Location l has keypoints ``keypoint_bin[keypoint_start[l]:keypoint_start[l +
    1]]``."""

    def __len__(self) -> int:
        return len(self.easting_m)

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.y.shape[1])

    @property
    def bin_px(self) -> float:
        """Width of a bin in px, so that azimuth and elevation have one unit at the horizon."""
        return 2.0 * np.pi / self.bins / TANGENT_PER_PX

    @classmethod
    def from_views(
        cls, chunks: Iterable[tuple[Views, KeypointTable]], bins: int = DEFAULT_BINS
    ) -> "Profiles":
        """Join views of one eye position; a location may have any of the four headings.

        Of two views with the same eye and heading the later one counts. Beside the views of a chunk
        are their keypoint columns (N, K) uint16, padded with 65535 (`features.polyline_keypoints`);
        the views of one location may lie in different chunks. Raises `InputError` for bins that are
        no positive multiple of 8, and where there is no view.
        """
        check_bins(bins)
        eyes, quadrants, headings, keypoints = [], [], [], []
        count = 0
        for views, table in chunks:
            eyes.append(
                np.stack([views.easting_m, views.northing_m, views.eye_elevation_m], axis=1)
            )
            headings.append(views.heading.astype(np.intp))
            quadrants.append(_quadrant(views, bins))
            view, bin_ = _keypoint_bins(views, table, bins)
            keypoints.append(np.stack([view + count, bin_]))
            count += len(views)
        if not count:
            raise InputError(
                "the store holds no views, so there is nothing to match; build it first"
            )
        eye, location = np.unique(np.concatenate(eyes), axis=0, return_inverse=True)
        y = _joined(len(eye), location, np.concatenate(headings), quadrants)
        keypoint_bin, start = _by_location(len(eye), location, np.hstack(keypoints), bins)
        easting_m, northing_m, eye_elevation_m = np.ascontiguousarray(eye.T)
        return cls(easting_m, northing_m, eye_elevation_m, y, keypoint_bin, start)


def _quadrant(views: Views, bins: int) -> Float32Array:
    """Return y (N, B / 4) at the bins of each view; v is linear between columns."""
    azimuth, left, beyond_left = quadrant_columns(views.width, bins)
    share = beyond_left.astype(np.float32)
    unusable = (views.flags & (FLAG_NO_DATA | FLAG_OUT_OF_IMAGE)) != 0
    v = np.where(unusable, np.float32(np.nan), views.elevation_tan)
    between = v[:, left] * (1.0 - share) + v[:, left + 1] * share
    return np.asarray(between * np.cos(azimuth).astype(np.float32), dtype=np.float32)


def _keypoint_bins(views: Views, table: KeypointTable, bins: int) -> tuple[IntArray, IntArray]:
    """Return the view (row) and the nearest bin of every keypoint."""
    view, slot = np.nonzero(table != NO_KEYPOINT)
    u = (2.0 * table[view, slot] + 1.0) / views.width - 1.0
    turn = np.arctan(u) * bins / (2.0 * np.pi) + views.heading[view] * (bins / 4.0)
    return view, np.rint(turn).astype(np.intp) % bins


def _joined(
    locations: int, location: IntArray, heading: IntArray, quadrants: list[Float32Array]
) -> Float32Array:
    """Return y (L, B) with every view's quadrant in its place."""
    size = quadrants[0].shape[1]
    y = np.full((locations, 4 * size), np.nan, dtype=np.float32)
    view = 0
    for quadrant in quadrants:
        rows = slice(view, view + len(quadrant))
        y[location[rows, np.newaxis], quadrant_bins(heading[rows], 4 * size)] = quadrant
        view += len(quadrant)
    return y


def _by_location(
    locations: int, location: IntArray, keypoints: IntArray, bins: int
) -> tuple[IntArray, IntArray]:
    """Return the distinct keypoint bins of each location and where each location's begin."""
    view, bin_ = keypoints
    key = np.unique(location[view] * bins + bin_)
    start = np.searchsorted(key, np.arange(locations + 1) * bins)
    return key % bins, start

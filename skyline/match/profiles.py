"""Views of eyes joined all the way round: stored ones to profiles, rendered ones to panoramas."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, IntArray, Rows
from skyline.camera import DEFAULT_WIDTH, pixel_size
from skyline.errors import InputError
from skyline.skylines import FLAG_NO_DATA, FLAG_OUT_OF_IMAGE, Views, check_bins
from skyline.store.keypoints import NO_KEYPOINT

DEFAULT_BINS = 2048
"""At 2048 a bin is 0.176 degrees, as good as a pixel at the centre of a 640 column view."""

TANGENT_PER_PX = pixel_size(DEFAULT_WIDTH)
"""Scores are in px of a view of the paper's width, whatever the width of the store."""

KeypointTable = NDArray[np.uint16]
_Float = TypeVar("_Float", np.float32, np.float64)


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
        eyes, quadrants, keypoints = [], [], []
        count = 0
        for views, table in chunks:
            place = views.easting_m, views.northing_m, views.eye_elevation_m
            eyes.append(np.stack(place, axis=1))
            y = _quadrants(views, bins, FLAG_NO_DATA | FLAG_OUT_OF_IMAGE, np.float32)[0]
            quadrants.append((views.heading, y))
            view, slot = np.nonzero(table != NO_KEYPOINT)
            u = (2.0 * table[view, slot] + 1.0) / views.width - 1.0
            turn = np.arctan(u) * bins / (2.0 * np.pi) + views.heading[view] * (bins / 4.0)
            keypoints.append(np.stack([view + count, np.rint(turn).astype(np.intp) % bins]))
            count += len(views)
        if not count:
            raise InputError(
                "the store holds no views, so there is nothing to match; build it first"
            )
        eye, location = np.unique(np.concatenate(eyes), axis=0, return_inverse=True)
        joined, first = np.full((len(eye), bins), np.nan, dtype=np.float32), 0
        for heading, y in quadrants:
            row = location[first : first + len(y), np.newaxis]
            joined[row, _quadrant_bins(heading, bins)] = y
            first += len(y)
        view, bin_ = np.hstack(keypoints)
        # Each of a location once, the locations in order.
        key = np.unique(location[view] * bins + bin_)
        start = np.searchsorted(key, np.arange(len(eye) + 1) * bins)
        easting_m, northing_m, eye_m = np.ascontiguousarray(eye.T)
        return cls(easting_m, northing_m, eye_m, joined, key % bins, start)


@dataclass(frozen=True, slots=True, eq=False)
class Panoramas(Rows):
    """Skylines of M eyes in B equal steps of grid azimuth; a part of the turn may be unknown.

    Raises `InputError` where the shapes differ or are not (M, B) with at least 8 bins.
    """

    y: Float64Array
    """(M, B) float64. Tangent of the skyline's elevation angle at azimuth 360 b / B degrees; NaN
    where unknown."""
    distance_m: Float64Array
    """(M, B) float64. Horizontal distance of the skyline; NaN where unknown."""

    def __post_init__(self) -> None:
        if self.y.shape != self.distance_m.shape or self.y.ndim != 2 or self.y.shape[1] < 8:
            raise InputError(
                f"panoramas have shapes {self.y.shape} and {self.distance_m.shape}; expected two "
                "of (M, B), B at least 8"
            )

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.y.shape[1])

    @classmethod
    def from_views(cls, views: Views, row: IntArray, count: int, bins: int) -> "Panoramas":
        """Join views, each of the one of ``count`` eyes that ``row`` (N,) says, to panoramas.

        Columns that meet no data are unknown. On the border of the data and behind a hole the
        skyline is a lower bound, and taken as it is: what the query shows above it may be
        something else, as where a tree stands. Raises as `check_bins` of `skyline.skylines`.
        """
        y, nearest, cosine = _quadrants(views, check_bins(bins), FLAG_NO_DATA, np.float64)
        distance = views.depth_m[:, nearest].astype(np.float64) / cosine
        bin_ = _quadrant_bins(views.heading, bins)
        joined = np.full((2, count, bins), np.nan)
        joined[0, row[:, np.newaxis], bin_] = y
        joined[1, row[:, np.newaxis], bin_] = np.where(np.isfinite(y), distance, np.nan)
        return cls(joined[0], joined[1])


def _quadrants(
    views: Views, bins: int, unusable: int, dtype: type[_Float]
) -> tuple[NDArray[_Float], IntArray, NDArray[_Float]]:
    """Return y (N, B / 4) at the bins of each view, but for columns of ``unusable`` flags.

    Beside it are the nearest columns (B / 4,) and the cosines (B / 4,) of the bins' azimuths from
    the heading, from 45 degrees left of it on. The left seam lies half a column outside the
    columns' centres and is extrapolated by that; the right one belongs to the next heading.
    """
    steps = np.arange(bins // 4) - bins // 8
    azimuth = 2.0 * np.pi / bins * steps
    position = (np.tan(azimuth) + 1.0) * views.width / 2.0 - 0.5
    left = np.clip(np.floor(position).astype(np.intp), 0, views.width - 2)
    share, cosine = (position - left).astype(dtype), np.cos(azimuth).astype(dtype)
    v = np.where(views.flags & unusable, np.nan, views.elevation_tan).astype(dtype)
    # v is linear between columns (exactly so along a straight edge); depth may jump.
    y = (v[:, left] * (1 - share) + v[:, left + 1] * share) * cosine
    return y, left + (share > 0.5), cosine


def _quadrant_bins(heading: NDArray[np.integer], bins: int) -> IntArray:
    """Return which bins (N, B / 4) of the turn those of views of headings (N,) are."""
    quarter = bins // 4
    first = heading[:, np.newaxis].astype(np.intp) * quarter - quarter // 2
    return (first + np.arange(quarter)) % bins

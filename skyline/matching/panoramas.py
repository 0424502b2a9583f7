"""What M eyes see all the way round: skylines with their distances on equal steps of azimuth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array, IntArray
from skyline.errors import InputError
from skyline.horizons import check_bins
from skyline.rows import Rows
from skyline.views import FLAG_NO_DATA, Views


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

    def __len__(self) -> int:
        return len(self.y)

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.y.shape[1])

    @classmethod
    def from_views(cls, views: Views, row: IntArray, count: int, bins: int) -> "Panoramas":
        """Join views, each of the one of ``count`` eyes that ``row`` (N,) says, to panoramas.

        Columns that meet no data are unknown. On the border of the data and behind a hole the
        skyline is a lower bound, and taken as it is: what the query shows above it may be
        something else, as where a tree stands. Raises as `check_bins` of `skyline.horizons`.
        """
        azimuth, left, share = quadrant_columns(views.width, check_bins(bins))
        # v is linear between columns (exactly so along a straight edge); depth may jump.
        v = np.where(views.flags & FLAG_NO_DATA, np.nan, views.elevation_tan).astype(np.float64)
        nearest = left + (share > 0.5)
        y = (v[:, left] * (1.0 - share) + v[:, left + 1] * share) * np.cos(azimuth)
        distance = views.depth_m[:, nearest].astype(np.float64) / np.cos(azimuth)
        bin_ = quadrant_bins(views.heading, bins)
        joined = np.full((2, count, bins), np.nan)
        joined[0, row[:, np.newaxis], bin_] = y
        joined[1, row[:, np.newaxis], bin_] = np.where(np.isfinite(y), distance, np.nan)
        return cls(joined[0], joined[1])


def quadrant_columns(width: int, bins: int) -> tuple[Float64Array, IntArray, Float64Array]:
    """Return where a view's bins (B / 4,) lie in it, from 45 degrees left of its heading on.

    That is each one's azimuth from the heading, radians, the column left of it and its share of the
    way to the next. The left seam lies half a column outside the columns' centres and is
    extrapolated by that; the right one belongs to the next heading.
    """
    quarter = bins // 4
    steps = np.arange(quarter) - quarter // 2
    azimuth = np.asarray(2.0 * np.pi / bins * steps, dtype=np.float64)
    position = (np.tan(azimuth) + 1.0) * width / 2.0 - 0.5
    left = np.clip(np.floor(position).astype(np.intp), 0, width - 2)
    return azimuth, left, position - left


def quadrant_bins(heading: NDArray[np.integer], bins: int) -> IntArray:
    """Return which bins (N, B / 4) of the turn those of views of headings (N,) are."""
    quarter = bins // 4
    first = heading[:, np.newaxis].astype(np.intp) * quarter - quarter // 2
    return (first + np.arange(quarter)) % bins

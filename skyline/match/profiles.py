"""Rendered views joined to skylines all the way round, and matchers that fit poses to them."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, IntArray, Rows
from skyline.camera import DEFAULT_WIDTH, pixel_size
from skyline.match.candidate import Hypotheses, Ranking
from skyline.match.matchers import Ranker
from skyline.match.prior import NOTHING_KNOWN, Prior
from skyline.match.query_rays import QueryRays
from skyline.match.scene import RenderedScene
from skyline.match.screening import Alike
from skyline.skylines import FLAG_NO_DATA, FLAG_OUT_OF_IMAGE, Views
from skyline.store import Store
from skyline.store.keypoints import NO_KEYPOINT
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

DEFAULT_BINS = 2048
"""A bin of 0.176 degrees is as fine as a pixel at the centre of a 640 column view."""

TANGENT_PER_PX = pixel_size(DEFAULT_WIDTH)
"""Scores are in px of a view of the paper's width, whatever the width of the store."""

KeypointTable = NDArray[np.uint16]
_Float = TypeVar("_Float", np.float32, np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Fits(Rows):
    """The best pose of a query at each of L locations."""

    score: Float64Array
    """(L,) float64. Lower is better; infinite where nothing fits."""
    heading_deg: Float64Array
    pitch_deg: Float64Array
    roll_deg: Float64Array
    """``heading_deg``, ``pitch_deg``, ``roll_deg``: (L,) float64. The heading is a grid azimuth."""

    @classmethod
    def none(cls, locations: int) -> "Fits":
        """Return no fit at any location."""
        return cls(np.full(locations, np.inf), *np.zeros((3, locations)))

    def placed_among(self, rows: IntArray, locations: int) -> "Fits":
        """Return these as the fits of ``rows`` among ``locations``, without a fit at the others."""
        wide = Fits.none(locations)
        for name in self._names():
            getattr(wide, name)[rows] = getattr(self, name)
        return wide

    def split(self, parts: int) -> list["Fits"]:
        """Return ``parts`` pieces of equal length, in order."""
        return [self[rows] for rows in np.split(np.arange(len(self.score)), parts)]

    def best_with(self, other: "Fits") -> "Fits":
        """Return the better fit at each location; this one where the scores are equal."""
        return self.replaced(other.score < self.score, other)


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Skylines of L locations all the way round, in B equal steps of grid azimuth.

    `QueryCurves.of` samples a query on the same steps, with bin B / 2 straight ahead. A query whose
    bin i lies over bin i + s of a profile therefore looks along azimuth 180 + 360 s / B degrees.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    """``easting_m``, ``northing_m``, ``eye_elevation_m``: (L,) float64."""
    y: Float32Array
    """(L, B) float32. Tangent of the skyline's elevation angle at azimuth 360 b / B degrees; NaN
    where no view looks or the view has no data."""
    keypoint_bin: IntArray
    """(M,) intp. Bins of the keypoints, ascending within each location, one location after
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
        """Join views by location; a location may have views in any of the four headings.

        Each chunk has the keypoint columns (N, K) uint16 of its views, padded with 65535 (see
        `skyline.store.keypoints.polyline_keypoints`). The views of one location may lie in
        different chunks. Of two views with the same eye and heading the later one counts.
        """
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
        eye, location = np.unique(np.concatenate(eyes), axis=0, return_inverse=True)
        joined, first = np.full((len(eye), bins), np.nan, dtype=np.float32), 0
        for heading, y in quadrants:
            row = location[first : first + len(y), np.newaxis]
            joined[row, _quadrant_bins(heading, bins)] = y
            first += len(y)
        view, bin_ = np.hstack(keypoints)
        # Each keypoint of a location once, the locations in order.
        key = np.unique(location[view] * bins + bin_)
        start = np.searchsorted(key, np.arange(len(eye) + 1) * bins)
        easting_m, northing_m, eye_m = np.ascontiguousarray(eye.T)
        return cls(easting_m, northing_m, eye_m, joined, key % bins, start)


class ProfileRanker(Ranker):
    """Base class of matchers of renderings, which fit one pose at every location."""

    def __init__(self, profiles: Profiles) -> None:
        self.profiles = profiles

    @classmethod
    def open(cls, store: Store, terrain: HeightField | None, scene: RenderedScene | None) -> Self:
        """See `Ranker.open`."""
        return cls(Profiles.from_views(_chunks(store)))

    def eyes(self) -> Viewpoints:
        """See `Ranker.eyes`."""
        some = self.profiles
        return Viewpoints(
            easting_m=some.easting_m,
            northing_m=some.northing_m,
            eye_elevation_m=some.eye_elevation_m,
        )

    def rank(
        self,
        query: QueryRays,
        top: int,
        prior: Prior = NOTHING_KNOWN,
        screened: Alike | None = None,
    ) -> Ranking:
        """See `Ranker.rank`; of equal scores the location that comes first in the store wins."""
        fits, profiles = self.fit(query), self.profiles
        poses = Hypotheses(
            profiles.easting_m,
            profiles.northing_m,
            profiles.eye_elevation_m,
            fits.heading_deg % 360.0,
            fits.pitch_deg,
            fits.roll_deg,
            np.full(len(profiles), query.fov_deg),
            np.zeros(len(profiles)),
            fits.score,
        )
        return Ranking(poses[poses.suppress_non_maxima(top, 0.0)])

    @abstractmethod
    def fit(self, query: QueryRays) -> Fits:
        """Return the best pose at each location of `profiles`; lower scores are better.

        `skyline.match.query_rays.QueryCurves` levels the query at the assumed pitches and puts it
        on the profiles' bins. The score is infinite at a location where nothing fits.
        """


def _chunks(store: Store) -> Iterator[tuple[Views, KeypointTable]]:
    """Yield the views of a store with their keypoints, many at a time."""
    start = 0
    for views in store.iter_views():
        yield views, store.keypoint_columns(slice(start, start + len(views)))
        start += len(views)


def joined_views(
    views: Views, row: IntArray, count: int, bins: int
) -> tuple[Float64Array, Float64Array]:
    """Return elevation tangents and horizontal distances (M, B) of views joined by eye.

    ``row`` (N,) is the eye, of ``count`` M, that each view belongs to. Directions without a view,
    or without data, are NaN. On the border of the data and behind a hole the skyline is a lower
    bound. It is used as it is: farther terrain may rise above it in the query, as a tree may
    anywhere.
    """
    y, nearest, cosine = _quadrants(views, bins, FLAG_NO_DATA, np.float64)
    distance = views.depth_m[:, nearest].astype(np.float64) / cosine
    bin_ = _quadrant_bins(views.heading, bins)
    joined = np.full((2, count, bins), np.nan)
    joined[0, row[:, np.newaxis], bin_] = y
    joined[1, row[:, np.newaxis], bin_] = np.where(np.isfinite(y), distance, np.nan)
    return joined[0], joined[1]


def _quadrants(
    views: Views, bins: int, unusable: int, dtype: type[_Float]
) -> tuple[NDArray[_Float], IntArray, NDArray[_Float]]:
    """Return y (N, B / 4) at the bins of each view; NaN in columns with ``unusable`` flags.

    Also return the nearest columns (B / 4,), and the cosines (B / 4,) of the bins' azimuths from
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
    """Return the bins (N, B / 4) of the full turn that views along headings (N,) cover."""
    quarter = bins // 4
    first = heading[:, np.newaxis].astype(np.intp) * quarter - quarter // 2
    return (first + np.arange(quarter)) % bins

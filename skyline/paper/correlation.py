r"""Matchers that fit a pose at each location of renderings.

The views of a location are joined to its profile, a skyline all the way round.

`CorrelationMatcher` is the baseline: sliding normalized correlation, exact over every heading,
location and assumed pitch.

With the photo's skyline q, its weights w, the profile y, n = 1 where y is known (else y = n = 0)
and a turn of s bins, over the bins i of the photo:

.. math::

    W = \sum w_i n_{i+s}, \quad
    a = \tfrac1W \sum w_i n_{i+s} q_i, \quad
    b = \tfrac1W \sum w_i y_{i+s}

.. math::

    \mathrm{ncc}(s) = \frac{\sum w_i q_i y_{i+s} - W a b}
    {\sqrt{(\sum w_i n_{i+s} q_i^2 - W a^2)\,(\sum w_i y_{i+s}^2 - W b^2)}}

Each sum is a circular correlation of an array of the photo with one of the profile, so all turns
come from one product of Fourier transforms. A turn has no correlation where too little of the photo
overlaps the profile (W below a share of the photo's weight), or where either curve is flat over the
overlap. The cost is 1 - ncc, in [0, 2].
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy import fft

from skyline.arrays import Complex128Array, Float32Array, Float64Array, IntArray
from skyline.match.method import SearchMethod
from skyline.match.prior import Prior
from skyline.match.rays import Rays, on_bins
from skyline.pose.poses import Poses
from skyline.progress import StepProgress, silent
from skyline.render.horizon import RenderedScene
from skyline.skylines import (
    DEFAULT_WIDTH,
    FLAG_NO_DATA,
    FLAG_OUT_OF_IMAGE,
    NO_KEYPOINT,
    Views,
    pixel_size,
    quadrant_bins,
    quadrants,
)
from skyline.store.layout import RENDERINGS, KeypointColumns
from skyline.store.read import Store
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

TANGENT_PER_PX = pixel_size(DEFAULT_WIDTH)
"""Costs are in px of a view of the paper's width, whatever the width of the store."""

PITCHES_DEG = (-10.0, -5.0, 0.0, 5.0, 10.0)
"""Pitches that matchers of renderings assume, since cameras are held about level."""

MIN_OVERLAP = 0.8
"""Least share of a photo's weight that must land on known profile."""

_Transforms = tuple[Complex128Array | None, Complex128Array, Complex128Array]


@dataclass(frozen=True, slots=True, eq=False)
class Profiles:
    """Skylines of L locations all the way round.

    Each has B bins of grid azimuth.

    `at_pitches` puts a photo's skyline into such bins, with bin B / 2 straight ahead. A photo whose
    bin i lies over bin i + s of a profile therefore looks along azimuth 180 + 360 s / B degrees.
    """

    eyes: Viewpoints
    """The eyes at the L locations."""
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
        return len(self.y)

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.y.shape[1])

    @property
    def bin_px(self) -> float:
        """Width of a bin in px.

        Elevations at the horizon have the same unit.
        """
        return bin_width_px(self.bins)

    def poses(
        self,
        cost: Float64Array,
        grid_heading_deg: Float64Array,
        pitch_deg: Float64Array,
        roll_deg: Float64Array,
        fov_deg: float,
    ) -> Poses:
        """Return the poses at the locations with a cost and angles (L,)."""
        return Poses(
            easting_m=self.eyes.easting_m,
            northing_m=self.eyes.northing_m,
            eye_elevation_m=self.eyes.eye_elevation_m,
            grid_heading_deg=grid_heading_deg % 360.0,
            pitch_deg=pitch_deg,
            roll_deg=roll_deg,
            fov_deg=np.full(len(self), fov_deg),
            cost=cost,
        )

    @classmethod
    def from_views(cls, chunks: Iterable[tuple[Views, KeypointColumns]]) -> "Profiles":
        """Return the profiles of locations that have views in any heading.

        Each chunk has the keypoint columns (N, K) uint16 of its views, padded with 65535 (see
        `skyline.skylines.polyline_vertices`). The views of one location may lie in different
        chunks. If two views have the same eye and heading, the later one counts.
        """
        bins = 2048  # One has 0.176 degrees, like a pixel in the middle of a view of 640 columns.
        eyes = []
        curves = []
        keypoints = []
        count = 0
        for views, table in chunks:
            position_m = views.easting_m, views.northing_m, views.eye_elevation_m
            eyes.append(np.stack(position_m, axis=1))
            y = quadrants(views, bins, FLAG_NO_DATA | FLAG_OUT_OF_IMAGE, np.float32)[0]
            curves.append((views.heading, y))
            view, slot = np.nonzero(table != NO_KEYPOINT)
            u = (2.0 * table[view, slot] + 1.0) / views.width - 1.0
            turn = np.arctan(u) * bins / (2.0 * np.pi) + views.heading[view] * (bins / 4.0)
            keypoints.append(np.stack([view + count, np.rint(turn).astype(np.intp) % bins]))
            count += len(views)
        eye, location = np.unique(np.concatenate(eyes), axis=0, return_inverse=True)
        joined = np.full((len(eye), bins), np.nan, dtype=np.float32)
        first = 0
        for heading, y in curves:
            row = location[first : first + len(y), np.newaxis]
            joined[row, quadrant_bins(heading, bins)] = y
            first += len(y)
        view, bin_ = np.hstack(keypoints)
        # Each keypoint of a location once, the locations in order.
        key = np.unique(location[view] * bins + bin_)
        start = np.searchsorted(key, np.arange(len(eye) + 1) * bins)
        easting_m, northing_m, eye_m = np.ascontiguousarray(eye.T)
        standing = Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=eye_m)
        return cls(standing, joined, key % bins, start)


def bin_width_px(bins: int) -> float:
    """Return the width in px of a bin of a turn."""
    return 2.0 * np.pi / bins / TANGENT_PER_PX


def at_pitches(
    rays: Rays, bins: int, pitches_deg: Sequence[float] = PITCHES_DEG
) -> list[tuple[float, Float64Array, Float64Array]]:
    """Return a photo's skyline at each assumed pitch.

    Each pitch in degrees comes with the tangents and the weights, (B,) each, that `on_bins` returns
    at it. The camera is taken not to roll.
    """
    return [(pitch_deg, *on_bins(rays, pitch_deg, bins)) for pitch_deg in pitches_deg]


class ProfileMatcher(SearchMethod):
    """Base class of matchers of renderings, which fit a pose everywhere."""

    holds = RENDERINGS

    def __init__(self, profiles: Profiles) -> None:
        self.profiles = profiles

    @classmethod
    def open(
        cls, store: Store, terrain: HeightField | None = None, scene: RenderedScene | None = None
    ) -> Self:
        """Return a matcher of an open store with one rendering or more."""
        parts = [slice(k, k + 1024) for k in range(0, len(store), 1024)]
        return cls(Profiles.from_views((store.views(p), store.keypoint_columns(p)) for p in parts))

    def eyes(self) -> Viewpoints:
        """Return the eyes of the profiles."""
        return self.profiles.eyes

    def search(self, rays: Rays, prior: Prior, top: int, report: StepProgress = silent) -> Poses:
        """Return up to ``top`` poses, best first, at most one per location.

        Locations where nothing fits are left out. Between equal costs, the location that comes
        first in the store wins.
        """
        poses = self.fit(rays)
        return poses[poses.suppress_non_maxima(top, 0.0)]

    @abstractmethod
    def fit(self, rays: Rays) -> Poses:
        """Return the best pose at each location of `profiles`; see `Profiles.poses`.

        `at_pitches` levels the photo at the assumed pitches and puts it into the profiles' bins.
        The cost is infinite at a location where nothing fits.
        """


class CorrelationMatcher(ProfileMatcher):
    """The plain baseline: the greatest normalized correlation wins.

    The transforms of profiles are computed anew for each photo: keeping them would save little
    time, and take several times the memory of the profiles.
    """

    def fit(self, rays: Rays) -> Poses:
        """Return every location's best pose; its cost is 1 - ncc."""
        profiles = self.profiles
        pitches = at_pitches(rays, profiles.bins)
        # The arrays of the transforms of eight locations stay in the processor's cache.
        chunks = [profiles.y[k : k + 8] for k in range(0, len(profiles), 8)]
        ncc = [self._greatest(pitches, chunk) for chunk in chunks]
        peak, pitch_deg, turn = (np.concatenate(parts) for parts in zip(*ncc, strict=True))
        axis = turn + profiles.bins // 2
        heading_deg = axis % profiles.bins * (360.0 / profiles.bins)
        none = np.zeros(len(profiles))
        return profiles.poses(1.0 - peak, heading_deg, pitch_deg, none, rays.fov_deg)

    def _greatest(
        self, pitches: list[tuple[float, Float64Array, Float64Array]], y: Float32Array
    ) -> tuple[Float64Array, Float64Array, IntArray]:
        """Return the greatest ncc at each location, with its pitch and turn.

        The ncc is -inf where there is none.
        """
        transforms = _transformed(y)
        row = np.arange(len(y))
        best = np.full(len(y), -np.inf)
        pitch_deg = np.zeros(len(y))
        turn = np.zeros(len(y), dtype=np.intp)
        for assumed_deg, q, weight in pitches:
            ncc = self._ncc(transforms, q, weight)
            peak = ncc.argmax(axis=1)
            greater = ncc[row, peak] > best
            best = np.where(greater, ncc[row, peak], best)
            pitch_deg = np.where(greater, assumed_deg, pitch_deg)
            turn = np.where(greater, peak, turn)
        return best, pitch_deg, turn

    def _ncc(self, transforms: _Transforms, q: Float64Array, weight: Float64Array) -> Float64Array:
        """Return the ncc (L, B) of a photo's curve at every turn.

        -inf stands for no correlation.
        """
        # Deviations from the mean keep the differences of sums below well conditioned.
        q = np.where(weight > 0.0, q, 0.0)
        q = np.where(weight > 0.0, q - np.average(q, weights=weight), 0.0)
        of_n, of_y, of_y2 = transforms
        of_w, of_wq, of_wq2 = fft.rfft(weight * np.stack([q**0, q, q**2])).conj()
        bins = len(q)
        sum_y = fft.irfft(of_y * of_w, bins)
        sum_y2 = fft.irfft(of_y2 * of_w, bins)
        covariance = fft.irfft(of_y * of_wq, bins)
        if of_n is None:
            # All of the photo then lands on known profile, and its mean over that is 0.
            total = np.full(1, weight.sum())
            enough = np.full(1, True)
            variance_q = np.full(1, np.sum(weight * q**2))
        else:
            total = fft.irfft(of_n * of_w, bins)
            enough = total >= MIN_OVERLAP * weight.sum() - 1e-9
            total = np.where(enough, total, 1.0)
            sum_q = fft.irfft(of_n * of_wq, bins)
            variance_q = fft.irfft(of_n * of_wq2, bins) - sum_q**2 / total
            covariance -= sum_q * sum_y / total
        variance_y = sum_y2 - sum_y**2 / total
        # A curve whose standard deviation is below 0.1 px is flat.
        flat = (0.1 * TANGENT_PER_PX) ** 2 * total
        usable = enough & (variance_q > flat) & (variance_y > flat)
        scale = np.sqrt(np.where(usable, variance_q * variance_y, 1.0))
        return np.where(usable, covariance / scale, -np.inf)


def _transformed(y: Float32Array) -> _Transforms:
    """Return the Fourier transforms of n, y and y**2.

    They are (L, B / 2 + 1) each. The transform of n is None if n is 1 throughout.
    """
    n = np.isfinite(y).astype(np.float64)
    y0 = np.where(n > 0.0, y, 0.0).astype(np.float64)
    mean = y0.sum(axis=1, keepdims=True) / np.maximum(n.sum(axis=1, keepdims=True), 1.0)
    y0 = (y0 - mean) * n
    return None if n.all() else fft.rfft(n), fft.rfft(y0), fft.rfft(y0**2)

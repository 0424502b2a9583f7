"""Profiles of many places predicted from few stored views: the store, made dense.

Every point of a lattice is predicted, heading by heading, from the nearest stored views of that
heading, and the stored eyes stay entries of their own. What a view predicts is terrain it has seen,
so a prediction misses what its view could not see, and hardly ever shows too much: the upper
envelope of several is nearer to the truth than any.
"""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skyline.camera import HEADINGS
from skyline.errors import InputError
from skyline.matching.lattice import Area, Ground, ground_between, ground_slope, lattice_m
from skyline.prediction.curves import Scenery
from skyline.prediction.displacement import Reach
from skyline.prediction.panorama import Ring, depth_code, depth_of_code_m
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M
from skyline.views import Views

Float32Array = NDArray[np.float32]
Float64Array = NDArray[np.float64]
IntArray = NDArray[np.intp]
Progress = Callable[[int, int], None]

Y_STEP = 2.0**-13
"""Tangents are kept in steps of 0.007 degrees, up to 4."""
UNKNOWN_Y = np.int16(np.iinfo(np.int16).min)
_Y_LIMIT = np.iinfo(np.int16).max


@dataclass(frozen=True, slots=True)
class DensifyConfig:
    """How a store is made dense.

    Attributes
    ----------
    pitch_m : float
        Of the lattice; infinite keeps the stored eyes alone.
    bins : int
        Azimuth bins B of a profile, a multiple of 8; an entry takes 3 B + 32 bytes.
    columns : int
        Columns Q of a quadrant that predictions are made in.
    sources : int
        Views whose predictions are joined, for each heading of an entry.
    reach_m : float
        No view predicts for eyes farther off than this.
    eye_height_m : float
        Of the predicted eyes above the ground.
    """

    pitch_m: float = 40.0
    bins: int = 720
    columns: int = 180
    sources: int = 2
    reach_m: float = 750.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M

    def __post_init__(self) -> None:
        if not self.pitch_m > 0.0 or not self.reach_m > 0.0:
            raise InputError(
                f"the lattice's pitch is {self.pitch_m:g} m and the reach {self.reach_m:g} m; "
                "expected both above 0"
            )
        if self.bins < 8 or self.bins % 8:
            raise InputError(f"{self.bins} azimuth bins; expected a positive multiple of 8")
        if self.sources < 1:
            raise InputError(f"{self.sources} views to predict from; expected at least 1")
        if self.columns < 8:
            raise InputError(f"{self.columns} columns a quadrant; expected at least 8")


@dataclass(frozen=True, slots=True, eq=False)
class DenseProfiles:
    """Skylines of L places all the way round and how far off they are, in few bytes.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (L,) float64
    ground_slope : (L, 2) float32
        Rise of the ground to the east and to the north.
    y_steps : (L, B) int16
        Tangent of the skyline's elevation angle at grid azimuth 360 b / B degrees, in `Y_STEP`;
        `UNKNOWN_Y` where nothing is known.
    distance : (L, B) uint8
        `depth_code` of the skyline's horizontal distance.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    ground_slope: Float32Array
    y_steps: NDArray[np.int16]
    distance: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.easting_m)

    def __getitem__(
        self, index: slice | NDArray[np.integer] | NDArray[np.bool_]
    ) -> "DenseProfiles":
        return DenseProfiles(
            self.easting_m[index],
            self.northing_m[index],
            self.eye_elevation_m[index],
            self.ground_slope[index],
            self.y_steps[index],
            self.distance[index],
        )

    @property
    def bins(self) -> int:
        """Number of azimuth bins B."""
        return int(self.y_steps.shape[1])

    def y(self, index: slice | NDArray[np.integer] = slice(None)) -> Float32Array:
        """Return tangents (L, B) float32, NaN where unknown."""
        steps = self.y_steps[index]
        return np.where(steps == UNKNOWN_Y, np.float32(np.nan), steps * np.float32(Y_STEP))

    def distance_m(self, index: slice | NDArray[np.integer] = slice(None)) -> Float32Array:
        """Return horizontal distances (L, B) float32."""
        return depth_of_code_m(self.distance[index])


def densify(
    chunks: Iterable[Views],
    ground: Ground | None = None,
    config: DensifyConfig | None = None,
    area_m: Area | None = None,
    progress: Progress | None = None,
) -> DenseProfiles:
    """Predict the profiles of a lattice of eyes from stored views.

    Beside the profiles this holds the stored views in Q columns, 32 Q K bytes a location of K
    shells (69 kB for 12), and while it works some 20 MB a processor.

    Parameters
    ----------
    chunks : iterable of Views
        The views of one eye may lie in different chunks, and an eye may lack headings. With
        shells where they have them.
    ground : callable, optional
        ``ground(easting_m, northing_m)`` returns heights of the terrain, NaN where there is
        none. Without it, interpolated from the stored eyes, which are taken to stand
        ``eye_height_m`` above ground.
    config : DensifyConfig, optional
    area_m : tuple of float, optional
        West, south, east, north of what the store stands for. Without it, a little more than
        the stored eyes span.
    progress : callable, optional
        Called with how many stored eyes have been predicted from, and of how many; an eye counts
        once for each of the ``sources``.

    Returns
    -------
    DenseProfiles
        The stored eyes first, then the lattice.

    Raises
    ------
    InputError
        No views.
    """
    config = config or DensifyConfig()
    stored = _Stored.of(chunks, config.columns)
    ground = ground or ground_between(stored.eye_m - [0.0, 0.0, config.eye_height_m])
    place = lattice_m(stored.eye_m[:, :2], config.pitch_m, config.reach_m, area_m)
    elevation_m = ground(place[:, 0], place[:, 1]) + config.eye_height_m
    predicted_m = np.column_stack([place, elevation_m])[np.isfinite(elevation_m)]
    eye_m = np.concatenate([stored.eye_m, predicted_m])
    profiles = DenseProfiles(
        eye_m[:, 0].copy(),
        eye_m[:, 1].copy(),
        eye_m[:, 2].copy(),
        ground_slope(eye_m[:, :2], ground),
        np.full((len(eye_m), config.bins), UNKNOWN_Y, dtype=np.int16),
        np.zeros((len(eye_m), config.bins), dtype=np.uint8),
    )
    resample = _Resample.of(stored.elevation_tan.shape[2], config.bins)
    eyes = len(stored.eye_m)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # A quadrant has one source at a time, so threads never write to the same place.
        for rank, source in enumerate(stored.sources(eye_m, config.sources, config.reach_m)):
            order = np.argsort(source, axis=None, kind="stable")
            ends = np.searchsorted(source.ravel()[order], np.arange(eyes + 1))

            def fill(eye: int, order: IntArray = order, ends: IntArray = ends) -> None:
                target, heading = np.divmod(order[ends[eye] : ends[eye + 1]], len(HEADINGS))
                _fill(profiles, stored, resample, eye, target, heading)

            used = np.flatnonzero(np.diff(ends))
            for eye, _ in zip(used, pool.map(fill, used), strict=True):
                if progress:
                    progress(rank * eyes + int(eye) + 1, config.sources * eyes)
    return profiles


@dataclass(frozen=True, slots=True, eq=False)
class _Stored:
    """Reduced views by eye.

    Attributes
    ----------
    eye_m : (E, 3) float64
        Easting, northing, elevation.
    view : (E, 4) intp
        The view of each heading, -1 for none.
    elevation_tan, depth_m : (N, K, Q) float32
    """

    eye_m: Float64Array
    view: IntArray
    elevation_tan: Float32Array
    depth_m: Float32Array

    @classmethod
    def of(cls, chunks: Iterable[Views], columns: int) -> "_Stored":
        eyes, headings, sceneries = [], [], []
        for views in chunks:
            eyes.append(
                np.stack([views.easting_m, views.northing_m, views.eye_elevation_m], axis=1)
            )
            headings.append(views.heading.astype(np.intp))
            sceneries.append(Scenery.of(views, columns, use_shells=True))
        if not sum(map(len, eyes)):
            raise InputError(
                "the store holds no views, so there is nothing to match; build it first"
            )
        eye_m, eye = np.unique(np.concatenate(eyes), axis=0, return_inverse=True)
        view = np.full((len(eye_m), len(HEADINGS)), -1, dtype=np.intp)
        view[eye.reshape(-1), np.concatenate(headings)] = np.arange(len(eye))
        return cls(
            eye_m,
            view,
            np.concatenate([scenery.elevation_tan for scenery in sceneries]),
            np.concatenate([scenery.depth_m for scenery in sceneries]),
        )

    def ring(self, eye: int, reach: Reach) -> Ring:
        view = self.view[eye]
        missing = (view < 0)[:, np.newaxis, np.newaxis]
        unknown = np.float32(np.nan)
        return Ring.of(
            np.where(missing, unknown, self.elevation_tan[view]),
            np.where(missing, unknown, self.depth_m[view]),
            reach,
        )

    def sources(self, eye_m: Float64Array, count: int, reach_m: float) -> IntArray:
        """Return the nearest stored eyes with a view of each heading, (S, L, 4), nearest first.

        The number of stored eyes where there are no more within reach.
        """
        none = len(self.eye_m)
        source = np.full((count, len(eye_m), len(HEADINGS)), none, dtype=np.intp)
        for heading in HEADINGS:
            eyes = np.flatnonzero(self.view[:, heading] >= 0)
            if eyes.size:
                tree = cKDTree(self.eye_m[eyes, :2])
                ranks = np.arange(1, count + 1)
                _, nearest = tree.query(eye_m[:, :2], ranks, distance_upper_bound=reach_m)
                source[:, :, heading] = np.append(eyes, none)[nearest.T]
        # What was rendered is not predicted, not even from another height at its place.
        own = np.arange(none)[:, np.newaxis]
        rendered = self.view >= 0
        source[0, :none] = np.where(rendered, own, source[0, :none])
        source[1:, :none][:, rendered] = none
        return source


@dataclass(frozen=True, slots=True, eq=False)
class _Resample:
    """From the columns round a ring to equal steps of azimuth; arrays are (B,).

    Attributes
    ----------
    left, right, nearest : intp
        Columns round the ring.
    share : float32
        Of the right one.
    cosine : float32
        Of the azimuth from straight ahead.
    farther : int32
        What makes the code of a forward depth that of a horizontal distance.
    heading : intp
        Whose quadrant a bin lies in.
    """

    left: IntArray
    right: IntArray
    nearest: IntArray
    share: Float32Array
    cosine: Float32Array
    farther: NDArray[np.int32]
    heading: IntArray

    @classmethod
    def of(cls, columns: int, bins: int) -> "_Resample":
        bin_ = np.arange(bins)
        heading = (bin_ + bins // 8) * 4 // bins % 4
        azimuth = (bin_ * (2.0 * np.pi / bins) - heading * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi
        position = (np.tan(azimuth) + 1.0) * columns / 2.0 - 0.5 + heading * columns
        left = np.floor(position).astype(np.intp)
        size = len(HEADINGS) * columns
        cosine = np.cos(azimuth)
        return cls(
            left % size,
            (left + 1) % size,
            np.rint(position).astype(np.intp) % size,
            (position - left).astype(np.float32),
            cosine.astype(np.float32),
            depth_code((1.0 / cosine).astype(np.float32)),
            heading,
        )

    def __call__(
        self, tan: Float32Array, depth: NDArray[np.uint8]
    ) -> tuple[NDArray[np.int16], NDArray[np.uint8]]:
        """Return y steps and distances (C, B) of `Ring.seen_from`'s answer."""
        tan, depth = tan.reshape(len(tan), -1), depth.reshape(len(tan), -1)
        left, right = tan[:, self.left], tan[:, self.right]
        left = np.where(np.isnan(left), right, left)
        right = np.where(np.isnan(right), left, right)
        y = (left + self.share * (right - left)) * (self.cosine / np.float32(Y_STEP))
        known = np.isfinite(y)
        steps = np.clip(np.rint(np.where(known, y, 0.0)), -_Y_LIMIT, _Y_LIMIT)
        distance = np.minimum(depth[:, self.nearest] + self.farther, 255)
        return np.where(known, steps, UNKNOWN_Y).astype(np.int16), distance.astype(np.uint8)


def _fill(
    profiles: DenseProfiles,
    stored: _Stored,
    resample: _Resample,
    eye: int,
    target: IntArray,
    heading: IntArray,
) -> None:
    """Predict quadrants (target, heading) from a stored eye; they raise what is there."""
    targets, row = np.unique(target, return_inverse=True)
    moved = np.column_stack(
        [
            profiles.easting_m[targets] - stored.eye_m[eye, 0],
            profiles.eye_elevation_m[targets] - stored.eye_m[eye, 2],
            profiles.northing_m[targets] - stored.eye_m[eye, 1],
        ]
    )
    steps, distance = resample(*stored.ring(eye, Reach.of(moved)).seen_from(moved))
    wanted = np.zeros((len(targets), len(HEADINGS)), dtype=bool)
    wanted[row, heading] = True
    row, bin_ = np.nonzero(wanted[:, resample.heading])
    # Unknown is the least step there is.
    higher = steps[row, bin_] > profiles.y_steps[targets[row], bin_]
    row, bin_ = row[higher], bin_[higher]
    profiles.y_steps[targets[row], bin_] = steps[row, bin_]
    profiles.distance[targets[row], bin_] = distance[row, bin_]

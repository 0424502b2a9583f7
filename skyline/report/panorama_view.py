"""The terrain and the summits that one eye sees in a panorama.

Columns of azimuth are followed outwards in steps no wider than a pixel of the picture; a point is
seen if its elevation angle is greater than the angles of all nearer points.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array, refuse_text
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizons_of
from skyline.terrain.heightfield import HeightField
from skyline.terrain.ray_casting import ground_elevation_deg, highest_between_deg
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints
from skyline.view.peaks import Peaks, check_on_map
from skyline.view.sightings import UNDERFOOT_SAMPLES, Sighting, most_prominent_first, visible_peaks

ROW_DEG = 120.0
"""The widest row of a panorama; a wider panorama has several rows of equal width."""
COLUMNS = 2265
"""Pixels across a row."""
_NOTHING_DEG = -90.0
"""Elevation of the skyline in a column that sees no terrain."""


@dataclass(frozen=True, slots=True)
class PanoramaConfig:
    """The view of a panorama; by default a full turn from north.

    Attributes
    ----------
    heading_deg, fov_deg : float
        Azimuth of the picture's middle from true north, and its width, 5 to 360 degrees.
    eye_height_m : float
        Height of the eye above ground.
    summit_within_m : float, optional
        As in `skyline.horizon`.
    """

    heading_deg: float = 180.0
    fov_deg: float = 360.0
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    summit_within_m: float | None = None

    def __post_init__(self) -> None:
        refuse_text(heading_deg=self.heading_deg, fov_deg=self.fov_deg)
        if not (5.0 <= self.fov_deg <= 360.0 and math.isfinite(self.heading_deg)):
            raise InputError(
                f"heading is {self.heading_deg:g} and field of view {self.fov_deg:g} degrees; "
                "expected a field of view of 5 to 360"
            )

    @property
    def start_deg(self) -> float:
        """Azimuth of the picture's left border."""
        return (self.heading_deg - 0.5 * self.fov_deg) % 360.0


@dataclass(frozen=True, slots=True, eq=False)
class PanoramaView:
    """The terrain and the summits that a panorama shows."""

    landscape: "Landscape"
    """The terrain in the picture's columns, one row of the picture after another."""
    sightings: Sequence[Sighting]
    """Visible summits, the most prominent first."""
    config: PanoramaConfig
    surface_deg: Float64Array | None = None
    """(C,) float64. Elevation angle up to which trees and houses may rise in each column."""


def panorama_view(
    terrain: HeightField,
    eye: Viewpoints,
    peaks: Peaks | None,
    config: PanoramaConfig,
    surface: HeightField | None = None,
) -> PanoramaView:
    """Return the view of one eye with its visible peaks.

    Raises as `Landscape.of`.
    """
    start_deg = config.start_deg
    fov_deg = config.fov_deg
    columns = row_count(fov_deg) * COLUMNS
    azimuth_deg = start_deg + np.arange(0.5, columns) * (fov_deg / columns)
    landscape = Landscape.of(terrain, eye, azimuth_deg)
    seen = []
    if peaks is not None:
        check_on_map(peaks, terrain)
        seen = visible_peaks(terrain, eye, peaks, terrain.frame.curvature)
    inside = [
        one
        for one in seen
        if (one.grid_azimuth_deg + landscape.convergence_deg - start_deg) % 360.0 < fov_deg
    ]
    surface_deg = None
    if surface is not None:
        both = horizons_of(terrain, eye, 0.1, surface=surface)
        surface_deg = np.interp(
            landscape.azimuth_deg, both.azimuth_deg[0], both.surface_deg[0], period=360.0
        )
    return PanoramaView(landscape, most_prominent_first(terrain, inside), config, surface_deg)


def row_count(fov_deg: float) -> int:
    """Return the number of rows of a panorama."""
    return int(np.ceil(fov_deg / ROW_DEG - 1e-9))


@dataclass(frozen=True, slots=True, eq=False)
class Landscape:
    """The terrain that one eye sees: P points in C columns.

    The points of a column go outwards.
    """

    terrain: HeightField
    eye: Viewpoints
    """A single eye."""
    azimuth_deg: Float64Array
    """(C,) float64. Azimuth from true north, increasing."""
    begins: Int64Array
    """(C + 1,) int64. The points of column c are ``begins[c]`` to ``begins[c + 1]``."""
    distance_m: Float64Array
    """(P,) float64. Horizontal, increasing in each column."""
    elevation_deg: Float32Array
    """(P,) float32. Elevation angle, increasing in each column."""
    is_ridge: BoolArray
    """(P,) bool. Whether the terrain behind a point drops out of sight."""

    @classmethod
    def of(cls, terrain: HeightField, eye: Viewpoints, azimuth_deg: Float64Array) -> Self:
        """Return the terrain that one eye sees.

        The azimuths (C,) of its columns have equal steps. The ground has the curvature of the
        terrain's frame; ridges have the exact height of the surface. Raises `InputError` if no
        terrain is visible.
        """
        curvature = terrain.frame.curvature
        turn_deg = terrain.frame.convergence_deg(easting_m=eye.easting_m, northing_m=eye.northing_m)
        grid_rad = np.radians(azimuth_deg - turn_deg)
        steps_m = _steps_m(terrain, eye, math.radians(azimuth_deg[1] - azimuth_deg[0]))
        column, step, up_deg = _rising(terrain, eye, curvature, grid_rad, steps_m)
        distance_m = steps_m[step]
        behind_m = np.append(distance_m[1:], np.inf)
        behind_m[np.append(np.diff(column) > 0, True)] = np.inf
        # The next terrain in sight behind a ridge is clearly farther than its neighbours on a
        # slope.
        is_ridge = behind_m > 1.04 * distance_m + 4.0 * terrain.spacing_m
        ridge = step[is_ridge]
        crest_deg = highest_between_deg(
            terrain,
            eye,
            curvature,
            grid_rad[column[is_ridge]],
            steps_m[np.maximum(ridge - 1, 0)],
            steps_m[np.minimum(ridge + 1, len(steps_m) - 1)],
        )
        up_deg[is_ridge] = np.maximum(up_deg[is_ridge], crest_deg.astype(np.float32))
        # A raised ridge may hide points found behind it.
        highest_deg = np.maximum.accumulate(up_deg + 360.0 * column)
        seen = np.diff(highest_deg, prepend=-np.inf) > 0.0
        begins = np.searchsorted(column[seen], np.arange(len(azimuth_deg) + 1))
        return cls(
            terrain, eye, azimuth_deg, begins, distance_m[seen], up_deg[seen], is_ridge[seen]
        )

    @property
    def skyline_deg(self) -> Float32Array:
        """Highest elevation angle in each column, (C,); -90 without terrain."""
        highest = self.elevation_deg[np.maximum(self.begins[1:], 1) - 1]
        return np.where(np.diff(self.begins) > 0, highest, np.float32(_NOTHING_DEG))

    @property
    def convergence_deg(self) -> float:
        """Azimuth from true north minus grid azimuth, at the eye."""
        position = {"easting_m": self.eye.easting_m[0], "northing_m": self.eye.northing_m[0]}
        return float(self.terrain.frame.convergence_deg(**position))

    @property
    def reach_m(self) -> float:
        """Distance of the farthest visible terrain."""
        return float(self.distance_m.max())

    @property
    def column(self) -> Int64Array:
        """Column of each point, (P,)."""
        return np.repeat(np.arange(len(self.azimuth_deg)), np.diff(self.begins))

    def seen(self, columns: slice, elevation_deg: Float64Array) -> Int64Array:
        """Return the points (E, K) seen at angles (E,) in K columns.

        The index P stands for sky.
        """
        begins = self.begins[columns.start : columns.stop + 1]
        seen = np.full((len(begins) - 1, len(elevation_deg)), len(self.distance_m))
        for row, (begin, end) in zip(seen, itertools.pairwise(begins), strict=True):
            point = begin + np.searchsorted(self.elevation_deg[begin:end], elevation_deg)
            np.copyto(row, point, where=point < end)
        return seen.T

    def ridges(self) -> tuple[Float64Array, Float32Array]:
        """Return where ranges of distance begin (R,), and the ridges in them.

        A range ends where the next begins; ten of them double the distance. A ridge of a column, in
        (R, C), is the elevation angle of the highest ridge point in a range; NaN where it has none.
        """
        a_doubling = 10
        first_m = float(self.distance_m.min(initial=np.inf))
        distance_m = self.distance_m[self.is_ridge]
        ranges = (np.log2(distance_m / first_m) * a_doubling).astype(np.intp)
        shape = ranges.max(initial=0) + 1, len(self.azimuth_deg)
        ridge_deg = np.full(shape, np.nan, np.float32)
        # The last of several in a range stands highest.
        ridge_deg[ranges, self.column[self.is_ridge]] = self.elevation_deg[self.is_ridge]
        return first_m * 2.0 ** (np.arange(len(ridge_deg)) / a_doubling), ridge_deg


def _rising(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    steps_m: Float64Array,
) -> tuple[Int64Array, Int64Array, Float32Array]:
    """Return the points that rise above all nearer ones.

    Each (P,) has a column, a step and an elevation angle. Columns look along grid azimuths (C,),
    and steps are distances (S,). The points of a column follow one another, outwards. Raises
    `InputError` if there are none.
    """
    # No terrain from a step on stands above this angle; a metre covers all rounding.
    up_m = terrain.height_range_m[1] + 1.0 - eye.eye_elevation_m - curvature.drop_m(steps_m)
    most_deg = np.maximum.accumulate(np.degrees(np.arctan(up_m / steps_m))[::-1])[::-1]
    so_far_deg = np.full(len(grid_rad), _NOTHING_DEG, dtype=np.float32)
    found = []
    # So many columns and steps at once stay in the processor's cache.
    for start in range(0, len(grid_rad), 128):
        for first in range(0, len(steps_m), 256):
            is_open = so_far_deg[start : start + 128] < most_deg[first]
            columns = start + np.flatnonzero(is_open)
            rays = grid_rad[columns], steps_m[first : first + 256]
            on_deg = ground_elevation_deg(terrain, eye, curvature, *rays).astype(np.float32)
            rising_deg = np.concatenate([so_far_deg[columns, np.newaxis], on_deg], axis=1)
            np.maximum.accumulate(rising_deg, axis=1, out=rising_deg)
            so_far_deg[columns] = rising_deg[:, -1]
            ray, nth = np.nonzero(rising_deg[:, 1:] > rising_deg[:, :-1])
            found.append((columns[ray], first + nth, rising_deg[ray, nth + 1]))
    column, step, up_deg = (np.concatenate(part) for part in zip(*found, strict=True))
    if not len(column):
        raise InputError(
            "no terrain is seen: the DEM has no heights around the place; give a wider DEM"
        )
    order = np.argsort(column, kind="stable")  # Steps are in order already.
    return column[order], step[order], up_deg[order]


def _steps_m(terrain: HeightField, eye: Viewpoints, pixel_rad: float) -> Float64Array:
    """Return distances from underfoot to beyond the terrain's farthest corner.

    The terrain is covered by blocks of 64 samples a side, and the last distance is beyond their
    corners.
    """
    block = 64
    rows, cols = (
        np.arange(0.5 * block, max(count - 1, 1) + 0.5 * block, block)
        for count in (terrain.rows, terrain.cols)
    )
    easting_m, northing_m = terrain.to_map(rows, cols)
    farthest_m = np.hypot(
        np.abs(easting_m - eye.easting_m[0]).max(), np.abs(northing_m - eye.northing_m[0]).max()
    )
    step_m = terrain.spacing_m
    corner_m = 0.5 * block * np.hypot(terrain.spacing_east_m, terrain.spacing_north_m)
    reach_m = float(farthest_m + corner_m)
    turn_m = min(max(step_m / pixel_rad, step_m), reach_m)
    near = np.arange(UNDERFOOT_SAMPLES * step_m, turn_m, step_m)
    wider = math.ceil(math.log(reach_m / turn_m) / pixel_rad) + 1
    return np.concatenate([near, np.geomspace(turn_m, max(reach_m, 1.01 * turn_m), wider + 1)])

"""Rendered skylines and summits in the picture of a camera at a given pose.

A pose is a `Candidate`; a picture has the size and the projection of a query. Azimuths are grid
azimuths in degrees, elevations the tangent of the elevation angle: up over horizontal distance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError, OffMapError
from skyline.geodesy import in_turn
from skyline.match.candidate import Candidate, Hypotheses, Ranking
from skyline.match.matcher import Matcher
from skyline.match.query_rays import level, project
from skyline.match.scene import RenderedScene
from skyline.photo.projection import distorted
from skyline.photo.query import QuerySkyline
from skyline.render.horizon import RenderConfig
from skyline.report.peaks import Peaks, Sighting, most_prominent_first, visible_peaks
from skyline.report.surroundings import Surroundings
from skyline.skylines import Views
from skyline.store.stored_dem import curvature_of
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, at_elevation, stand_at

AROUND = 0.52
"""Distance to either side of the picture's middle up to which a rendered skyline is drawn, in
widths: just beyond the picture."""
_WIDTH = 1024
"""Columns of a rendered 90 degree view: more than a screen shows of it."""
_MARGIN_DEG = 8.0
"""A view is rendered if the photo comes this near to it: a camera may be tilted."""


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """The skyline of one eye by azimuth."""

    azimuth_deg: Float64Array
    """(C,) float64. Grid azimuths in [0, 360), increasing from the first column on."""
    elevation_tan: Float64Array
    """(C,) float64. Tangent of the elevation angle; NaN where there is no data."""
    is_sure: BoolArray
    """(C,) bool. False where the data's border or a hole may hide farther, higher terrain."""

    @classmethod
    def of(cls, views: Views) -> "Panorama":
        """Join the views of one eye."""
        azimuth = views.azimuth_deg().ravel()
        order = np.argsort(azimuth)
        elevation = np.tan(np.radians(views.elevation_deg())).ravel()
        return cls(azimuth[order], elevation[order], (views.flags.ravel() == 0)[order])

    def facing(self, azimuth_deg: float) -> "Panorama":
        """Return the columns in order from behind, so that a view ahead is one unbroken run."""
        first = int(np.searchsorted(self.azimuth_deg, (azimuth_deg + 180.0) % 360.0))
        turned = np.roll(np.arange(len(self.azimuth_deg)), -first)
        return Panorama(self.azimuth_deg[turned], self.elevation_tan[turned], self.is_sure[turned])

    def at(self, azimuth_deg: Float64Array) -> Float64Array:
        """Return elevation tangents at azimuths, interpolated between columns."""
        known = np.isfinite(self.elevation_tan)
        if not known.any():
            return np.full_like(azimuth_deg, np.nan)
        return np.interp(
            azimuth_deg, self.azimuth_deg[known], self.elevation_tan[known], period=360.0
        )


def pixels_of(
    pose: Candidate, query: QuerySkyline, azimuth_deg: ArrayLike, elevation_tan: ArrayLike
) -> tuple[Float64Array, Float64Array]:
    """Return the columns and rows at which directions appear; NaN for those not in front."""
    turn = np.radians(np.asarray(azimuth_deg, dtype=np.float64) - pose.grid_heading_deg)
    y = np.asarray(elevation_tan, dtype=np.float64)
    is_panorama = query.projection.is_panorama
    u, v = project(turn, y, pose.pitch_deg, pose.roll_deg, is_panorama=is_panorama)
    across, above = query.projection.places(u, v, pose.fov_deg)
    across, above = distorted(across, above, pose.distortion)
    half_px = query.width_px / 2.0
    return (
        across * half_px + (query.width_px - 1.0) / 2.0,
        (query.height_px - 1.0) / 2.0 - above * half_px,
    )


def directions_of(pose: Candidate, query: QuerySkyline) -> tuple[Float64Array, Float64Array]:
    """Return azimuths and elevation tangents of the query's skyline in its trusted columns."""
    u, v = query.image_plane(pose.fov_deg, pose.distortion)
    is_panorama = query.projection.is_panorama
    turn, y = level(u, v, pose.pitch_deg, pose.roll_deg, is_panorama=is_panorama)
    return (np.degrees(turn) + pose.grid_heading_deg) % 360.0, y


def gap_deg(pose: Candidate, query: QuerySkyline, panorama: Panorama) -> Float64Array:
    """Return the angle from the rendered skyline up to the query's in its trusted columns."""
    azimuth_deg, y = directions_of(pose, query)
    return np.asarray(np.degrees(np.arctan(y) - np.arctan(panorama.at(azimuth_deg))))


def peaks_in_picture(
    pose: Candidate, query: QuerySkyline, sightings: Sequence[Sighting]
) -> list[tuple[Sighting, float, float]]:
    """Return the peaks within the picture, each with its column and row."""
    column, row = pixels_of(
        pose,
        query,
        [sighting.azimuth_deg for sighting in sightings],
        [sighting.elevation_tan for sighting in sightings],
    )
    inside = (column >= 0.0) & (column < query.width_px) & (row >= 0.0) & (row < query.height_px)
    return [
        (sighting, float(column[index]), float(row[index]))
        for index, sighting in enumerate(sightings)
        if inside[index]
    ]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The skyline rendered at a pose, in pixels of a photo, and its difference from the photo's.

    Attributes
    ----------
    column_px, row_px : (N,) float64
        The rendered skyline from left to right; NaN where there is no data.
    is_sure : (N,) bool
        False where the data's border or a hole may hide farther, higher terrain.
    gap_deg : (W,) float64
        Angle from the rendered skyline up to the photo's in each of the photo's columns; NaN where
        either is unknown.
    """

    column_px: Float64Array
    row_px: Float64Array
    is_sure: BoolArray
    gap_deg: Float64Array

    @property
    def median_gap_deg(self) -> float | None:
        """Median of the absolute gap; None if no column is known."""
        known = self.gap_deg[np.isfinite(self.gap_deg)]
        return float(np.median(np.abs(known))) if len(known) else None


@dataclass(frozen=True, slots=True)
class SeenPeak:
    """A named summit in a photo; ``distance_m`` is horizontal."""

    label: str
    column_px: float
    row_px: float
    distance_m: float


class Viewer:
    """Renders the skylines of poses on a matcher's terrain, with priority over its own renderings.

    Parameters
    ----------
    matcher : Matcher
        If it has a render thread, that thread renders here too, and any thread may call.
    peaks : Peaks, optional
        Names of summits.

    Raises
    ------
    InputError
        The matcher has no elevation model.
    """

    def __init__(self, matcher: Matcher, peaks: Peaks | None = None) -> None:
        if matcher.terrain is None:
            raise InputError("the store's DEM is not at hand, so that nothing can be rendered")
        self.frame, self.terrain, self.peaks = matcher.frame, matcher.terrain, peaks
        self.curvature = curvature_of(matcher.header)
        config = RenderConfig(width=_WIDTH, curvature=self.curvature)
        self._scene = RenderedScene(self.terrain, config, matcher.render_thread)
        self._around = Surroundings(self.frame, matcher.viewpoints, self.terrain)

    def release(self) -> None:
        """Free the textures and buffers on the GPU."""
        self._scene.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def pose(
        self,
        *,
        lon: float,
        lat: float,
        heading_deg: float,
        pitch_deg: float = 0.0,
        roll_deg: float = 0.0,
        fov_deg: float = 60.0,
        eye_height_m: float = DEFAULT_EYE_HEIGHT_M,
    ) -> Candidate:
        """Return the pose of a camera at a place; headings are clockwise from true north.

        Within one sample's spacing of a summit of the model the ground has the summit's height, as
        in `skyline.horizon`; ``eye_height_m`` may be negative there.

        Raises
        ------
        OffMapError
            The place is off the map or on a hole, or the eye is below the ground.
        """
        ground = stand_at(self.terrain, lon=lon, lat=lat, eye_height_m=0.0)
        place = ground.easting_m, ground.northing_m
        eye = at_elevation(self.terrain, *place, ground.eye_elevation_m + eye_height_m)
        easting, northing = float(eye.easting_m[0]), float(eye.northing_m[0])
        convergence_deg = float(self.frame.convergence_deg(easting_m=easting, northing_m=northing))
        pose = Hypotheses.of_pose(
            easting,
            northing,
            float(eye.eye_elevation_m[0]),
            (heading_deg - convergence_deg) % 360.0,
            pitch_deg,
            roll_deg,
            fov_deg,
            0.0,
        )
        return replace(Ranking(pose).candidates(self.frame)[0], rank=None, score=math.nan)

    def look(self, pose: Candidate, query: QuerySkyline) -> Sight:
        """Return the skyline rendered at a pose, in pixels of the query's photo.

        Raises
        ------
        InputError
            The pose has a field of view that the photo's projection cannot have.
        OffMapError
            The pose is off the map or on a hole.
        """
        query.projection.check_fov_deg(pose.fov_deg)
        panorama = self.panorama(pose)
        ahead = panorama.facing(pose.grid_heading_deg)
        column, row = pixels_of(pose, query, ahead.azimuth_deg, ahead.elevation_tan)
        near = np.abs(column - query.width_px / 2.0) <= AROUND * query.width_px
        gaps_deg = np.full(query.width_px, np.nan)
        gaps_deg[query.trusted] = gap_deg(pose, query, panorama)
        return Sight(column[near], row[near], ahead.is_sure[near], gaps_deg)

    def panorama(self, pose: Candidate) -> Panorama:
        """Return the skyline in the directions around the photo; raises as `look`."""
        eye = self._around.eye_of(pose)
        if eye is None:
            raise OffMapError("the pose is off the map or on a hole; move it")
        off_deg = 90.0 * np.array(HEADINGS) - pose.grid_heading_deg
        away_deg = np.abs(in_turn(off_deg))
        headings = np.flatnonzero(away_deg < 45.0 + 0.5 * pose.fov_deg + _MARGIN_DEG)
        views = self._scene.render(eye[np.zeros(len(headings), np.intp)], headings, urgent=True)
        return Panorama.of(views)

    def summits(self, pose: Candidate, query: QuerySkyline) -> list[SeenPeak]:
        """Return the summits visible in the photo of a pose, the most prominent first."""
        eye = self._around.eye_of(pose)
        if eye is None or self.peaks is None:
            return []
        seen = visible_peaks(self.terrain, eye, self.peaks, self.curvature)
        inside = [sighting for sighting, *_ in peaks_in_picture(pose, query, seen)]
        ranked = most_prominent_first(self.terrain, inside)
        return [
            SeenPeak(sighting.label, column_px, row_px, sighting.distance_m)
            for sighting, column_px, row_px in peaks_in_picture(pose, query, ranked)
        ]

"""What a camera at any pose sees: the skyline in its photo, while the pose is still moving."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS
from skyline.errors import InputError, OffMapError
from skyline.geodesy import in_turn
from skyline.match.candidate import Candidate
from skyline.match.matcher import Matcher
from skyline.match.ranking import Hypotheses, Ranking
from skyline.match.scene import RenderedScene
from skyline.photo.query import QuerySkyline
from skyline.render.horizon import RenderConfig
from skyline.report.peaks import Peaks, most_prominent_first, visible_peaks
from skyline.report.posed_picture import Panorama, PosedPicture
from skyline.report.surroundings import Surroundings
from skyline.store.stored_dem import curvature_of
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, at_elevation, stand_at

_WIDTH = 1024
"""Columns of a view: more than a screen shows of it."""
_MARGIN_DEG = 8.0
"""A view is rendered where the photo comes this near to it: a camera may be tilted."""
_AROUND = 0.52
"""How far from the photo's middle, in widths, a skyline is drawn: a little beyond its border."""


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The skyline that a pose sees, in pixels of its photo, and how the photo's differs.

    Attributes
    ----------
    column_px, row_px : (N,) float64
        The rendered skyline from left to right; NaN where there is no data.
    is_sure : (N,) bool
        False where the data's border or a hole may hide what is farther.
    gap_deg : (W,) float64
        The photo's skyline above the rendered one in each of the photo's columns; NaN where
        either is not known.
    """

    column_px: Float64Array
    row_px: Float64Array
    is_sure: NDArray[np.bool_]
    gap_deg: Float64Array

    @property
    def median_gap_deg(self) -> float | None:
        """The median of the gap's size; None where no column is known."""
        known = self.gap_deg[np.isfinite(self.gap_deg)]
        return float(np.median(np.abs(known))) if len(known) else None


@dataclass(frozen=True, slots=True)
class SeenPeak:
    """A summit in a photo."""

    label: str
    column_px: float
    row_px: float
    distance_m: float


class Viewer:
    """Renders what poses see on a matcher's terrain, before whatever the matcher renders.

    Parameters
    ----------
    matcher : Matcher
        Its render thread, if it has one, renders for this too: any thread may ask.
    peaks : Peaks, optional
        Names to put to summits.

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
        """Free what this holds on the GPU."""
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
        """Return the candidate of a camera that stands at a place; headings are from true north.

        A place within a sample's spacing of a summit of the model has the summit's height as its
        ground, as in `skyline.horizon`; ``eye_height_m`` may be negative there.

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
        """Return the skyline that a pose sees in the photo that a query is of.

        Raises
        ------
        InputError
            The pose has a field of view that the photo cannot have.
        OffMapError
            The pose is off the map or on a hole.
        """
        query.projection.check_fov_deg(pose.fov_deg)
        panorama = self.panorama(pose)
        picture = PosedPicture(query.width_px, query.height_px, pose, query.projection)
        ahead = panorama.from_azimuth(pose.grid_heading_deg + 180.0)
        column, row = picture.pixels(ahead.azimuth_deg, ahead.elevation_tan)
        near = np.abs(column - query.width_px / 2.0) <= _AROUND * query.width_px
        gap_deg = np.full(query.width_px, np.nan)
        gap_deg[query.trusted] = picture.gap_deg(query, panorama)
        return Sight(column[near], row[near], ahead.is_sure[near], gap_deg)

    def panorama(self, pose: Candidate) -> Panorama:
        """Return the skyline about the photo of a pose; raises as `look`."""
        eye = self._around.eye_of(pose)
        if eye is None:
            raise OffMapError("the pose is off the map or on a hole; move it")
        off_deg = 90.0 * np.array(HEADINGS) - pose.grid_heading_deg
        away_deg = np.abs(in_turn(off_deg))
        headings = np.flatnonzero(away_deg < 45.0 + 0.5 * pose.fov_deg + _MARGIN_DEG)
        views = self._scene.render(eye[np.zeros(len(headings), np.intp)], headings, urgent=True)
        return Panorama.of(views)

    def summits(self, pose: Candidate, query: QuerySkyline) -> list[SeenPeak]:
        """Return the summits that a pose sees in its photo, the most prominent first."""
        eye = self._around.eye_of(pose)
        if eye is None or self.peaks is None:
            return []
        seen = visible_peaks(self.terrain, eye, self.peaks, self.curvature)
        picture = PosedPicture(query.width_px, query.height_px, pose, query.projection)
        inside = most_prominent_first(self.terrain, [one for one, *_ in picture.peaks(seen)])
        return [
            SeenPeak(one.label, column_px, row_px, one.distance_m)
            for one, column_px, row_px in picture.peaks(inside)
        ]

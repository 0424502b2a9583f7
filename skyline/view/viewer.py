"""The view at a pose: rendered skyline and summits in its photo.

A picture has the size and the projection of a photo.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from threading import Lock

import numpy as np

from skyline.angles import angle_between_deg, wrapped_deg
from skyline.arrays import BoolArray, Float64Array, ShortRepr
from skyline.camera.pixels import in_picture
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.ground.ground_view import GroundView
from skyline.ground.pixel_places import PixelPlaces
from skyline.photo.skyline import PhotoForm, PhotoSkyline
from skyline.pose.noted_pose import NotedPose
from skyline.pose.pose import Pose
from skyline.progress import Progress
from skyline.render.context import Closeable, RenderThread
from skyline.render.horizon import RenderConfig, RenderedScene
from skyline.sky.sun import Body, InSky, Sky, check_is_earth
from skyline.skylines import HEADINGS, Views
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.ray_casting import first_hits_m
from skyline.terrain.viewpoints import (
    DEFAULT_EYE_HEIGHT_M,
    LEAST_EYE_HEIGHT_M,
    Viewpoints,
    at_elevation,
    broadcast,
    check_eye_elevation,
    stand_at_one,
    stand_on,
)
from skyline.view.peaks import Peaks, check_on_map
from skyline.view.sightings import Sighting, aimed_at, most_prominent_first, visible_peaks

_AROUND = 0.52
"""Distance to either side of the picture's middle up to which a rendered skyline is drawn, in
widths: just beyond the picture."""
_WIDTH = 1024
"""Columns of a rendered 90 degree view: more than a screen has for it."""
_MARGIN_DEG = 20.0
"""A view is rendered if half the field of view comes this near to it: a photo of 120 degrees that
is pitched by 30 and rolled by 10 degrees shows skyline 19 degrees beyond."""
_DISC_POINTS = 49
_DISC_STEP_RAD = 1e-4
"""Step between the profiles that are followed; one ray is followed exactly."""
_ROUNDED_M = 0.01
"""An eye that is too low by less than this is rounded."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Sight(ShortRepr):
    """The skyline rendered at a pose, compared with a photo's skyline.

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


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenPeak(Sighting):
    """A visible peak in a photo.

    Attributes
    ----------
    column_px, row_px : float
        Place in the photo; pixel centres are at whole numbers.
    name, label : str
        The name in the gazetteer; with the height if the gazetteer has one.
    distance_m : float
        Horizontal.
    elevation_m : float
        Height in the gazetteer; where it has none, the height of the summit on the terrain model.
    """

    column_px: float
    row_px: float

    def doubted(self, confidence: float) -> SeenPeak:
        """Return the peak with its name's probability behind the name."""
        return replace(self, name=f"{self.name} ({100.0 * confidence:.0f} %)")


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenPeaks:
    """The peaks that a photo does not show, by reason."""

    hidden: tuple[str, ...]
    """Terrain stands before them."""
    outside: tuple[str, ...]
    """They lie outside the photo."""
    off_map: tuple[str, ...]
    """They lie off the elevation model."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeenBody:
    """The sun or the moon in a photo.

    Attributes
    ----------
    name : str
        "sun" or "moon".
    column_px, row_px : float
        Middle of the disc; pixel centres are at whole numbers.
    outline_px : (P, 2) float64
        Columns and rows of the disc's edge, closed.
    azimuth_deg, elevation_deg : float
        From true north; refracted.
    is_hidden : bool
        Whether terrain hides the middle of the disc.
    """

    name: str
    column_px: float
    row_px: float
    outline_px: Float64Array
    azimuth_deg: float
    elevation_deg: float
    is_hidden: bool


def sight_of(pose: Pose, photo: PhotoForm, views: Views) -> Sight:
    """Return the skyline of rendered views in the photo's picture.

    Parameters
    ----------
    views : Views
        Views from the eye of the pose, at least in the directions around the photo.
    """
    grid_azimuth_deg = views.grid_azimuth_deg().ravel()
    # In order from behind the camera, so that the columns ahead are one unbroken run.
    order = np.argsort(wrapped_deg(grid_azimuth_deg - pose.grid_heading_deg))
    grid_azimuth_deg = grid_azimuth_deg[order]
    elevation_tan = np.tan(np.radians(views.elevation_deg())).ravel()[order]
    is_sure = views.flags.ravel()[order] == 0
    column, row = pose.camera(photo).pixels(grid_azimuth_deg, elevation_tan)
    near = np.abs(column - photo.width_px / 2.0) <= _AROUND * photo.width_px
    gap_deg = np.full(photo.width_px, np.nan)
    known = np.isfinite(elevation_tan)
    if isinstance(photo, PhotoSkyline) and known.any():
        trusted = np.flatnonzero(photo.trusted)
        photo_deg, photo_tan = pose.camera(photo).directions(trusted, photo.row_px[trusted])
        rendered_tan = np.interp(
            photo_deg, grid_azimuth_deg[known], elevation_tan[known], period=360.0
        )
        gap_deg[photo.trusted] = np.degrees(np.arctan(photo_tan) - np.arctan(rendered_tan))
    return Sight(column[near], row[near], is_sure[near], gap_deg)


def peaks_in_picture(pose: Pose, photo: PhotoForm, sightings: Sequence[Sighting]) -> list[SeenPeak]:
    """Return the peaks within the picture, in the order given."""
    directions = np.array([(one.grid_azimuth_deg, one.elevation_tan) for one in sightings])
    column, row = pose.camera(photo).pixels(*directions.reshape(-1, 2).T)
    shown = in_picture(column, row, photo.width_px, photo.height_px)
    return [
        SeenPeak(**asdict(sightings[one]), column_px=float(column[one]), row_px=float(row[one]))
        for one in np.flatnonzero(shown).tolist()
    ]


class Viewer(Closeable):
    """The terrain as cameras see it.

    A viewer finds the skylines, the summits and the place in each pixel of a photo. Poses are in
    the terrain's frame: make them with `pose`, or with a matcher of the same elevation model. A
    photo, of which the projection and the size count, is a `Photo` or a `PhotoSkyline`. Any thread
    may call a viewer; `close`, or the end of a ``with`` block, frees its memory on the GPU.

    Parameters
    ----------
    terrain : path, paths, DataArray or HeightField
        The elevation model.
    peaks : Peaks, optional
        Names of summits.
    curvature : Curvature, optional
        Defaults to `Frame.curvature`: the Earth's with k = 0.13. A store's header has the curvature
        of its matcher.
    render_thread : RenderThread, optional
        A thread that renders, with priority over a matcher that renders there too.
    """

    def __init__(
        self,
        terrain: Dem,
        peaks: Peaks | None = None,
        *,
        curvature: Curvature | None = None,
        render_thread: RenderThread | None = None,
    ) -> None:
        self.terrain = read_dem(terrain)
        self.peaks = peaks
        self.frame = self.terrain.frame
        if peaks is not None:
            check_on_map(peaks, self.terrain)
        self.curvature = self.frame.curvature_or(curvature)
        self._thread = render_thread
        self._making = Lock()
        self._scene: RenderedScene | None = None

    def __repr__(self) -> str:
        return f"Viewer({self.terrain})"

    def close(self) -> None:
        """Free the textures and buffers on the GPU."""
        if self._scene is not None:
            self._scene.close()

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
    ) -> Pose:
        """Return the pose of a camera at a place.

        Headings are clockwise from true north. Within one sample's spacing of a summit of the model
        the ground has the summit's height, as in `skyline.horizon`; ``eye_height_m`` may be
        negative there.

        Raises
        ------
        OffMapError
            The place is off the map or on a hole, or the eye is below the ground.
        InputError
            One of the values is not a finite number.
        """
        broadcast(heading_deg=heading_deg, pitch_deg=pitch_deg, roll_deg=roll_deg)
        broadcast(fov_deg=fov_deg, eye_height_m=eye_height_m)
        ground = stand_at_one(self.terrain, lon=lon, lat=lat, eye_height_m=0.0)
        eye_m = ground.eye_elevation_m + eye_height_m
        eye = at_elevation(self.terrain, ground.easting_m, ground.northing_m, eye_m)
        easting_m, northing_m = float(eye.easting_m[0]), float(eye.northing_m[0])
        convergence_deg = self.frame.convergence_deg(easting_m=easting_m, northing_m=northing_m)
        return Pose(
            lon=float(wrapped_deg(lon)),
            lat=lat,
            heading_deg=heading_deg % 360.0,
            pitch_deg=pitch_deg,
            roll_deg=roll_deg,
            fov_deg=fov_deg,
            easting_m=easting_m,
            northing_m=northing_m,
            eye_elevation_m=float(eye_m[0]),
            convergence_deg=float(convergence_deg),
            cost=math.nan,
        )

    def pose_of(self, noted: NotedPose) -> tuple[Pose, str]:
        """Return a noted pose on the terrain, and a notice, or "".

        An eye below the least height of a camera is lifted, and the notice says so. Raises
        `OffMapError` for a pose off the map and for an eye far below the ground, and `InputError`
        for an eye higher than aeroplanes.
        """
        height_m = DEFAULT_EYE_HEIGHT_M if noted.eye_height_m is None else noted.eye_height_m
        standing = self.pose(
            lon=noted.lon,
            lat=noted.lat,
            heading_deg=noted.heading_deg,
            pitch_deg=noted.pitch_deg,
            roll_deg=noted.roll_deg,
            fov_deg=noted.fov_deg,
            eye_height_m=height_m,
        )
        pose = replace(
            standing,
            distortion=noted.distortion,
            wander=noted.wander,
            covariance=noted.covariance,
        )
        if noted.eye_elevation_m is not None:
            pose = replace(pose, eye_elevation_m=noted.eye_elevation_m)
        check_eye_elevation(pose.eye_elevation_m, standing.eye_elevation_m - height_m)
        return (pose, "") if noted.eye_elevation_m is None else self._lifted(pose)

    def _lifted(self, pose: Pose) -> tuple[Pose, str]:
        """Return the lifted pose, with a notice if it was lifted."""
        held = self.held(pose)
        height_m = LEAST_EYE_HEIGHT_M - (held.eye_elevation_m - pose.eye_elevation_m)
        if height_m >= LEAST_EYE_HEIGHT_M - _ROUNDED_M:
            return held, ""
        side = "below" if height_m < -_ROUNDED_M else "above"
        return held, (
            f"the pose's eye is {abs(height_m):.1f} m {side} the ground of the DEM, lower than a "
            f"camera is held; it is lifted to {LEAST_EYE_HEIGHT_M:g} m above it"
        )

    def held(self, pose: Pose) -> Pose:
        """Return a pose lifted to the least height of a camera.

        A view from the ground itself would show nothing but that ground. Every view of a pose is
        from this eye. Raises `OffMapError` for a pose off the map or on a hole.
        """
        return replace(pose, eye_elevation_m=float(self._standing(pose).eye_elevation_m[0]))

    def look(self, pose: Pose, photo: PhotoForm) -> Sight:
        """Return the skyline rendered at a pose, in the photo's pixels.

        The gaps to the photo's own skyline are NaN for a `Photo`.

        Raises
        ------
        InputError
            The pose has a field of view that the photo's projection cannot have.
        OffMapError
            The pose is off the map or on a hole.
        ContextError
            No OpenGL context can be created.
        """
        photo.projection.check_fov_deg(pose.fov_deg)
        return sight_of(pose, photo, self._views(self._standing(pose), pose))

    def places(
        self, pose: Pose, photo: PhotoForm, step: int = 1, progress: Progress | None = None
    ) -> PixelPlaces:
        """Return the places on the terrain in a photo's pixels.

        A place lies on the ray through its pixel's centre, where the ray first meets the surface of
        the terrain model, or a surface within a quarter of a pixel beside the ray.

        Parameters
        ----------
        step : int
            Every ``step``-th row and column is computed, beginning with the first.
        progress : callable, optional
            Called with the number of pixels that are done, and of all.

        Raises
        ------
        InputError
            The pose has a field of view that the photo's projection cannot have, or ``step`` is
            below 1.
        OffMapError
            The pose is off the map or on a hole.
        """
        if step < 1:
            raise InputError(f"the step is {step} pixels; expected 1 or more")
        view = self.ground_view(pose, photo)
        row_px, column_px = np.mgrid[: photo.height_px : step, : photo.width_px : step]
        grid_azimuth_deg, elevation_tan = view.camera.directions(column_px, row_px)
        ray = np.radians(grid_azimuth_deg), elevation_tan
        distance_m = view.hits_m(*ray, progress)
        easting_m, northing_m, elevation_m = view.at_m(*ray, distance_m)
        lon, lat = self.frame.to_lonlat(easting_m, northing_m)
        is_sky = np.isnan(distance_m)
        return PixelPlaces(
            distance_m=distance_m.astype(np.float32),
            lon=np.where(is_sky, np.nan, lon),
            lat=np.where(is_sky, np.nan, lat),
            elevation_m=elevation_m.astype(np.float32),
            step=step,
            crs=self.frame.lonlat_crs,
        )

    def ground_view(self, pose: Pose, photo: PhotoForm) -> GroundView:
        """Return the ground as the camera of a pose sees it.

        Its pixels are the photo's. Raises `InputError` for a field of view that the photo's
        projection cannot have, and `OffMapError` for a pose off the map or on a hole.
        """
        photo.projection.check_fov_deg(pose.fov_deg)
        return GroundView(
            terrain=self.terrain,
            curvature=self.curvature,
            eye=self._standing(pose),
            camera=pose.camera(photo),
            covariance=pose.covariance_or_assumed(photo),
        )

    def summits(self, pose: Pose, photo: PhotoForm) -> list[SeenPeak]:
        """Return the summits that a photo shows, most prominent first.

        Raises `OffMapError` for a pose off the map or on a hole, and `InputError` as `look`.
        """
        photo.projection.check_fov_deg(pose.fov_deg)
        # Ranking takes long, so only the peaks in the photo are ranked.
        return most_prominent_first(
            self.terrain, peaks_in_picture(pose, photo, self._visible(pose))
        )

    def unseen(self, pose: Pose, photo: PhotoForm, seen: Sequence[SeenPeak]) -> UnseenPeaks:
        """Return why a photo does not show the other peaks.

        ``seen`` are the summits that it shows. Raises as `summits`.
        """
        if self.peaks is None:
            return UnseenPeaks(hidden=(), outside=(), off_map=())
        shown = {(one.name, one.easting_m, one.northing_m) for one in seen}
        hidden: list[str] = []
        outside: list[str] = []
        off_map: list[str] = []
        aimed = aimed_at(self.terrain, self._standing(pose), self.peaks, self.curvature)
        for name, one in zip(self.peaks.names, aimed, strict=True):
            if one is None:
                off_map.append(name)
            elif (name, one.easting_m, one.northing_m) not in shown:
                is_inside = peaks_in_picture(pose, photo, [one])
                (hidden if is_inside else outside).append(name)
        return UnseenPeaks(hidden=tuple(hidden), outside=tuple(outside), off_map=tuple(off_map))

    def bodies(self, pose: Pose, photo: PhotoForm, at: datetime | str) -> list[SeenBody]:
        """Return which of sun and moon a photo shows at a time.

        A time without a zone is in UTC if it is a `datetime`, and is refused if it is text. Raises
        `OffMapError` for a pose off the map or on a hole, and `InputError` as `look`, or if PyEphem
        is not installed or the DEM is of another world than the Earth.
        """
        check_is_earth(self.terrain.frame.crs)
        photo.projection.check_fov_deg(pose.fov_deg)
        eye = self._standing(pose)
        sky = Sky(pose.lon, pose.lat, float(eye.eye_elevation_m[0]))
        bodies = (self._in_picture(body, sky.look(body, at), eye, pose, photo) for body in Body)
        return [one for one in bodies if one is not None]

    def _in_picture(
        self, body: Body, disc: InSky, eye: Viewpoints, pose: Pose, photo: PhotoForm
    ) -> SeenBody | None:
        """Return a body in the photo; None if its middle lies outside."""
        turn = np.linspace(0.0, 2.0 * np.pi, _DISC_POINTS)
        aside_deg = disc.radius_deg * np.append(0.0, np.sin(turn))
        up_deg = disc.elevation_deg + disc.radius_deg * np.append(0.0, np.cos(turn))
        grid_azimuth_deg = (
            disc.azimuth_deg
            - pose.convergence_deg
            + aside_deg / np.cos(np.radians(disc.elevation_deg))
        )
        elevation_tan = np.tan(np.radians(up_deg))
        edge_px = np.column_stack(pose.camera(photo).pixels(grid_azimuth_deg, elevation_tan))
        (column_px, row_px), outline_px = edge_px[0], edge_px[1:]
        if not in_picture(column_px, row_px, photo.width_px, photo.height_px):
            return None
        middle = np.radians(grid_azimuth_deg[:1]), elevation_tan[:1]
        hit_m = first_hits_m(self.terrain, eye, self.curvature, *middle, _DISC_STEP_RAD, None)
        return SeenBody(
            name=str(body),
            column_px=float(column_px),
            row_px=float(row_px),
            outline_px=outline_px,
            azimuth_deg=disc.azimuth_deg,
            elevation_deg=disc.elevation_deg,
            is_hidden=bool(np.isfinite(hit_m[0])) or disc.elevation_deg < 0.0,
        )

    def sightings(self, pose: Pose) -> list[Sighting]:
        """Return all peaks visible from a pose, most prominent first.

        Raises `OffMapError` for a pose off the map or on a hole.
        """
        return most_prominent_first(self.terrain, self._visible(pose))

    def _visible(self, pose: Pose) -> list[Sighting]:
        if self.peaks is None:
            return []
        return visible_peaks(self.terrain, self._standing(pose), self.peaks, self.curvature)

    def _standing(self, pose: Pose) -> Viewpoints:
        """Return a pose's eye, raised to the least height of a camera."""
        eye = stand_on(
            self.terrain,
            easting_m=pose.easting_m,
            northing_m=pose.northing_m,
            eye_height_m=LEAST_EYE_HEIGHT_M,
        )
        np.maximum(eye.eye_elevation_m, pose.eye_elevation_m, out=eye.eye_elevation_m)
        return eye

    def _views(self, eye: Viewpoints, pose: Pose) -> Views:
        """Render the views in the directions around the photo."""
        away_deg = angle_between_deg(90.0 * np.array(HEADINGS), pose.grid_heading_deg)
        headings = np.flatnonzero(away_deg < 45.0 + 0.5 * pose.fov_deg + _MARGIN_DEG)
        with self._making:
            if self._scene is None:
                config = RenderConfig(width=_WIDTH, curvature=self.curvature)
                self._scene = RenderedScene(self.terrain, config, self._thread)
        return self._scene.render(eye[np.zeros(len(headings), np.intp)], headings, urgent=True)[0]

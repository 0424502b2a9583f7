"""Poses of cameras in columns, as searches find them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Complex128Array, Float64Array, IntArray, Rows
from skyline.geodesy.map_frame import Frame
from skyline.pose.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class FitFigures(Rows):
    """Figures of M poses fitted by rendering, from which confidences are learned."""

    covariance_m2: Float64Array
    """(M, 2, 2) float64. Covariance of easting and northing, square metres, including other optima
    of the same answer."""
    residual_deg: Float64Array
    """(M,) float64. As in `Pose`."""
    terrain_share: Float64Array
    """(M,) float64. As in `Pose`."""
    skyline_m: Float64Array
    """(M,) float64. As in `Pose`."""
    beyond_share: Float64Array
    """(M,) float64. As in `Pose`."""
    effective_columns: Float64Array
    """(M,) float64. Number of independent columns that would hold as much information."""
    height_sd_m: Float64Array
    """(M,) float64. Standard deviation of the terrain model's height errors that the fit
    suggests."""
    covariance: Float64Array
    """(M, P, P) float64. As in `Pose`."""
    margin: Float64Array
    """(M,) float64. `Poses.rival_margin` for `RIGHT_WITHIN_M`; below 0 for all but the best
    pose."""
    angle_sd_deg: Float64Array
    """(M, 4) float64. Standard errors of heading, pitch, roll and field of view."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseAreas(Rows):
    """The areas, of several frames, in which M poses were found."""

    area: IntArray
    """(M,) intp. As in `Pose`."""
    geocentric_m: Float64Array
    """(M, 3) float64. See `Frame.geocentric_m`; used to compare poses of different areas."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Poses(Rows):
    """M poses of a camera in a frame, as matchers return them.

    With ``in_areas``, each pose is in the frame of its own area.
    """

    easting_m: Float64Array
    """(M,) float64. Easting of the eye in the frame."""
    northing_m: Float64Array
    """(M,) float64. Northing of the eye in the frame."""
    eye_elevation_m: Float64Array
    """(M,) float64. Elevation of the eye above the DEM's datum."""
    grid_heading_deg: Float64Array
    """(M,) float64. Grid azimuth of the optical axis, in [0, 360)."""
    pitch_deg: Float64Array
    """(M,) float64. As in `Pose`."""
    roll_deg: Float64Array
    """(M,) float64. As in `Pose`."""
    fov_deg: Float64Array
    """(M,) float64. As in `Pose`."""
    cost: Float64Array
    """(M,) float64. Lower is better; the unit depends on the step that gave it, and only
    differences within one photo are meaningful. Infinite for a pose that does not fit."""
    distortion: Float64Array | None = None
    """(M,) float64. As in `Pose`; None for 0."""
    wander: Float64Array | None = None
    """(M, 4) float64. As in `Pose`; None where it is not known."""
    confidence: Float64Array | None = None
    """(M,) float64. Probability that a pose is right within 200 m; None if not estimated."""
    confidence_1km: Float64Array | None = None
    """(M,) float64. Probability that a pose is right within 1 km; None if not estimated."""
    fits: FitFigures | None = None
    """Figures of the poses, if they were fitted by rendering; else None."""
    in_areas: PoseAreas | None = None
    """Areas of the poses, if they were found in several; None for poses of one frame."""

    @classmethod
    def of(cls, pose: Pose) -> "Poses":
        """Return one pose as columns, with a cost of 0."""
        return cls(
            easting_m=np.array([pose.easting_m]),
            northing_m=np.array([pose.northing_m]),
            eye_elevation_m=np.array([pose.eye_elevation_m]),
            grid_heading_deg=np.array([pose.grid_heading_deg]),
            pitch_deg=np.array([pose.pitch_deg]),
            roll_deg=np.array([pose.roll_deg]),
            fov_deg=np.array([pose.fov_deg]),
            cost=np.zeros(1),
            distortion=np.array([pose.distortion]),
        )

    def figures(self) -> FitFigures:
        """Return the figures of fits.

        Raises `ValueError` for poses that were not rendered.
        """
        if self.fits is None:
            raise ValueError("these poses were not fitted by rendering, so they have no figures")
        return self.fits

    @property
    def position_m(self) -> Complex128Array:
        """Eastings (M,) of the eyes, and northings as the imaginary part."""
        return self.easting_m + 1j * self.northing_m

    def areas(self) -> IntArray:
        """Return each pose's area (M,); 0 where there is only one."""
        if self.in_areas is None:
            return np.zeros(len(self), dtype=np.intp)
        return self.in_areas.area

    def found_in(self, area: IntArray, frames: Sequence[Frame]) -> "Poses":
        """Return the poses as found in areas of several frames.

        ``area`` (M,) are indices of ``frames``.
        """
        geocentric_m = np.zeros((len(self), 3))
        for number, frame in enumerate(frames):
            mine = area == number
            geocentric_m[mine] = frame.geocentric_m(self.easting_m[mine], self.northing_m[mine])
        return replace(self, in_areas=PoseAreas(area, geocentric_m))

    def on_map(self, *frames: Frame) -> tuple[Pose, ...]:
        """Return the poses on the map, ranked in their order.

        ``frames`` are the frames of the areas, in order.
        """
        lon, lat, convergence_deg = np.zeros((3, len(self)))
        area = self.areas()
        for number, frame in enumerate(frames):
            mine = area == number
            at_m = {"easting_m": self.easting_m[mine], "northing_m": self.northing_m[mine]}
            lon[mine], lat[mine] = frame.to_lonlat(**at_m)
            convergence_deg[mine] = frame.convergence_deg(**at_m)
        columns = self.columns()
        columns.pop("in_areas")
        grid_heading_deg = columns.pop("grid_heading_deg")
        fits = columns.pop("fits")
        columns |= {
            "lon": lon,
            "lat": lat,
            "heading_deg": (grid_heading_deg + convergence_deg) % 360.0,
            "convergence_deg": convergence_deg,
            "rank": np.arange(1, len(self) + 1),
            "area": area,
        }
        if fits is not None:
            for name in ("beyond_share", "residual_deg", "terrain_share", "skyline_m"):
                columns[name] = getattr(fits, name)
            columns["covariance_m2"] = fits.covariance_m2
            columns["covariance"] = fits.covariance
            columns["refined"] = np.ones(len(self), dtype=bool)
        known = {
            name: map(_tuple, column.tolist())
            for name, column in columns.items()
            if column is not None
        }
        return tuple(
            Pose(**dict(zip(known, row, strict=True))) for row in zip(*known.values(), strict=True)
        )

    def distances_m(self, others: "Poses | None" = None) -> Float64Array:
        """Return the horizontal distances (M, N) to other poses.

        By default, these are the poses themselves. Both are of the same areas.
        """
        others = self if others is None else others
        apart_m = np.asarray(np.abs(self.position_m[:, np.newaxis] - others.position_m))
        if self.in_areas is None or others.in_areas is None:
            return apart_m
        mine, theirs = self.in_areas, others.in_areas
        offset_m = mine.geocentric_m[:, np.newaxis] - theirs.geocentric_m
        is_one_area = mine.area[:, np.newaxis] == theirs.area
        return np.where(is_one_area, apart_m, np.linalg.norm(offset_m, axis=-1))

    def are_same(
        self, within_m: float, turn_deg: float, others: "Poses | None" = None
    ) -> BoolArray:
        """Return which pairs (M, N) of these and other poses agree."""
        others = self if others is None else others
        turn = angle_between_deg(self.grid_heading_deg[:, np.newaxis], others.grid_heading_deg)
        return np.asarray((self.distances_m(others) <= within_m) & (turn <= turn_deg))

    def rival_margin(self, farther_than_m: float, turn_deg: float = 360.0) -> Float64Array:
        """Return each pose's margin (M,) over its best rival.

        The margin is the cost of the rival minus the pose's own. Rivals are the poses farther away
        than ``farther_than_m``, and those that look more than ``turn_deg`` away. Infinite for a
        pose without rivals.
        """
        is_same = self.are_same(farther_than_m, turn_deg)
        rival = np.where(is_same, np.inf, self.cost).min(axis=1, initial=np.inf)
        return np.asarray(rival - self.cost)

    def suppress_non_maxima(
        self, count: int, separation_m: float, turn_deg: float = 360.0
    ) -> IntArray:
        """Return the indices of at most ``count`` distinct poses, best first.

        A pose is left out where a better one lies nearer than ``separation_m`` and looks within
        ``turn_deg`` of the same direction, or where its cost is infinite. Equal costs keep their
        order.
        """
        left = np.isfinite(self.cost)
        chosen: list[int] = []
        for index in np.argsort(self.cost, kind="stable"):
            if len(chosen) == count:
                break
            if not left[index]:
                continue
            chosen.append(int(index))
            turn = angle_between_deg(self.grid_heading_deg, self.grid_heading_deg[index])
            apart_m = self[int(index)].distances_m(self)[0]
            left &= (apart_m >= separation_m) | (turn > turn_deg)
            left[index] = False
        return np.array(chosen, dtype=np.intp)


def _tuple(value: Any) -> Any:
    """Return a list, and the lists in it, as tuples.

    Anything else is returned unchanged.
    """
    return tuple(map(_tuple, value)) if isinstance(value, list) else value

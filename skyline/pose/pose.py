"""Camera poses: on the map, and in columns."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Complex128Array, Float64Array, IntArray, Rows
from skyline.camera.camera import Camera
from skyline.geodesy.map_frame import Frame, geodesic_m
from skyline.photo.skyline import PhotoForm
from skyline.pose.pose_errors import ANGLES, ASSUMED

RIGHT_WITHIN_M = 200.0
"""Largest error of an answer that is right. Poses farther apart are different answers."""
ROUGHLY_WITHIN_M = 1000.0
"""Largest error of an answer that is roughly right."""
DISTANCES_M = (RIGHT_WITHIN_M, ROUGHLY_WITHIN_M)
SAME_VIEW_DEG = 30.0
"""Poses that look farther apart than this are different answers, wherever they are."""

COLUMNS = {
    "latitude °": ("lat", ".5f"), "longitude °": ("lon", ".5f"),
    "heading °": ("heading_deg", ".2f"), "pitch °": ("pitch_deg", ".2f"),
    "roll °": ("roll_deg", ".2f"), "FOV °": ("fov_deg", ".2f"),
    "confidence": ("confidence", ".2f"), "within 1 km": ("confidence_1km", ".2f"),
}  # fmt: skip
"""Columns of a table of candidates: the field of `Pose`, and its format."""

_CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of chi square with two degrees of freedom: -2 ln 0.05."""
_LEAST_SHARE = 0.005
"""A smaller share of a skyline is 0 % in words."""
_ARC_STEP_DEG = 2.0
_ELLIPSE_POINTS = 72

WRITTEN = (
    "easting_m", "northing_m", "lon", "lat", "eye_elevation_m", "radius_m", "heading_deg",
    "pitch_deg", "roll_deg", "fov_deg", "distortion", "wander", "cost", "confidence",
    "confidence_1km", "refined", "beyond_share", "residual_deg", "terrain_share", "skyline_m",
    "covariance",
)  # fmt: skip
"""The fields that `Pose.to_dict` writes."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Pose:
    """A pose of the camera on the map, in degrees.

    Attributes
    ----------
    lon, lat : float
        Longitude and latitude, degrees, WGS 84.
    heading_deg : float
        Direction of the optical axis, clockwise from true north, in [0, 360).
    pitch_deg, roll_deg : float
        Angle of the optical axis above the horizon; clockwise turn of the camera about that axis,
        as seen from behind the camera.
    fov_deg : float
        Horizontal field of view.
    distortion : float
        Radial distortion k of the lens: a point at r half widths of the photo from its middle would
        appear at ``(1 + k * r**2) * r`` without it, and on an equidistant fisheye's photo at
        ``(1 + k * (r**2 - 1)) * r``. 0 for a panorama, and where the pose was not refined.
    wander : tuple of float
        How the rows of a panorama wander, as tangents of the elevation, for each of the ways of
        `skyline.camera.warps.wander_ways`; empty for a lens, and where it is not known.
    easting_m, northing_m : float
        The same place in the store's frame.
    eye_elevation_m : float
        Elevation of the camera above the DEM's datum.
    convergence_deg : float
        Grid convergence at the place: true azimuth minus grid azimuth.
    cost : float
        Lower is better; the unit depends on the matcher. NaN for a pose set by hand.
    confidence, confidence_1km : float or None
        Estimated probability that the place is right within 200 m, and within 1 km, and the
        heading within 30 degrees; None for matchers that estimate none.
    refined : bool
        Whether the pose was fitted by rendering.
    covariance_m2 : ((float, float), (float, float)) or None
        Covariance of easting and northing, square metres. This and the next five are None for a
        pose that was not refined.
    covariance : tuple of tuple of float, or None
        Covariance of all that was fitted to this photo: easting, northing and elevation of the eye,
        metres; heading, pitch and roll, radians; the logarithm of the image's scale, which grows
        with the field of view; and the distortion of a lens, unless it was taken for 0, or the
        wander of a panorama.
    beyond_share : float or None
        Share of the photo's skyline above which terrain past the elevation model's edge may rise.
    residual_deg : float or None
        Root mean square difference in elevation between the photo's skyline and the rendered one,
        over the part of the photo that shows terrain.
    terrain_share : float or None
        Share of the photo's skyline that shows terrain rather than trees or houses.
    skyline_m : float or None
        Harmonic mean distance of the rendered skyline, in the photo's columns.
    rank : int or None
        Rank among the candidates of its search, 1 for the best; None for a pose that no search
        found. A fitted pose that replaces a candidate, since it fits better, has the candidate's
        rank.
    area : int
        Index in `Matcher.areas` of the elevation model in whose frame the pose is.
    """

    lon: float
    lat: float
    heading_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float
    easting_m: float
    northing_m: float
    eye_elevation_m: float
    convergence_deg: float
    cost: float
    distortion: float = 0.0
    wander: tuple[float, ...] = ()
    confidence: float | None = None
    confidence_1km: float | None = None
    refined: bool = False
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None
    beyond_share: float | None = None
    residual_deg: float | None = None
    terrain_share: float | None = None
    skyline_m: float | None = None
    rank: int | None = None
    area: int = 0

    def __repr__(self) -> str:
        shown = (f"{name} {text}" for name, text in zip(COLUMNS, self.cells(), strict=True) if text)
        return f"Pose({', '.join(shown).replace(' °', '')}; angles in degrees)"

    @property
    def origin(self) -> str:
        """Origin of the pose: "found, rank 1", "fitted" or "set by hand"."""
        if self.rank is not None:
            return f"found, rank {self.rank}"
        return "fitted" if self.refined else "set by hand"

    @property
    def name(self) -> str:
        """Name among the photo's poses, such as "candidate 2"."""
        if self.rank is not None:
            return f"candidate {self.rank}"
        return "the fitted pose" if self.refined else "the pose set by hand"

    @property
    def title(self) -> str:
        """Name in captions: "the best candidate", or as `name`."""
        return "the best candidate" if self.rank == 1 else self.name

    @property
    def radius_m(self) -> float | None:
        """Radius of the circle in which the camera stood with probability 0.68.

        None if unknown. It assumes that the candidate is right, and a round normal distribution
        with the covariance's mean variance.
        """
        if self.covariance_m2 is None:
            return None
        (east_m2, _), (_, north_m2) = self.covariance_m2
        return math.sqrt(-2.0 * math.log(1.0 - 0.68) * (east_m2 + north_m2) / 2.0)

    @property
    def grid_heading_deg(self) -> float:
        """Grid azimuth of the optical axis, in [0, 360)."""
        return (self.heading_deg - self.convergence_deg) % 360.0

    def camera(self, photo: PhotoForm) -> Camera:
        """Return the camera that took a photo of ``photo``'s size and projection."""
        return Camera(
            projection=photo.projection,
            width_px=photo.width_px,
            height_px=photo.height_px,
            fov_deg=self.fov_deg,
            grid_heading_deg=self.grid_heading_deg,
            pitch_deg=self.pitch_deg,
            roll_deg=self.roll_deg,
            distortion=self.distortion,
            wander=self.wander,
        )

    def covariance_or_assumed(self, photo: PhotoForm) -> Float64Array:
        """Return the covariance (P, P); if it is None, an assumed one.

        A pose without one was written by a person: see `skyline.pose.pose_errors.AssumedErrors`.
        """
        if self.covariance is None:
            return ASSUMED.covariance(self.camera(photo))
        return np.array(self.covariance)

    def assumed(self, photo: PhotoForm) -> str:
        """Return assumed standard errors in words; empty if the covariance is known."""
        return "" if self.covariance is not None else ASSUMED.in_words(self.camera(photo))

    def angles_in_words(self, sds_deg: Mapping[str, float]) -> str:
        """Return the angles with their standard errors, by the names of `ANGLES`."""
        heading, *others = (
            f"{name} {getattr(self, f'{name}_deg'):.2f} +- {sds_deg[name]:.2f}" for name in ANGLES
        )
        return "  ".join([f"{heading} from true north", *others]) + " degrees"

    def distance_m(self, other: "Pose") -> float:
        """Return the horizontal distance to another pose, metres."""
        if self.area != other.area:
            return geodesic_m(self.lon, self.lat, other.lon, other.lat)
        return math.hypot(self.easting_m - other.easting_m, self.northing_m - other.northing_m)

    def turn_deg(self, other: "Pose") -> float:
        """Return the angle between two poses' headings, 0 to 180 degrees."""
        return float(angle_between_deg(self.heading_deg, other.heading_deg))

    def is_same_answer(self, other: "Pose", within_m: float = RIGHT_WITHIN_M) -> bool:
        """Return whether another pose is the same answer, within a distance.

        It is if it lies within the distance and looks the same way. Confidences belong to answers.
        """
        return self.distance_m(other) <= within_m and self.turn_deg(other) <= SAME_VIEW_DEG

    def times_as_sure(self, factor: float) -> "Pose":
        """Return the pose with its confidences times a factor, at most 1."""
        near, roughly = (
            None if sure is None else min(1.0, factor * sure)
            for sure in (self.confidence, self.confidence_1km)
        )
        return replace(self, confidence=near, confidence_1km=roughly)

    @property
    def residual_in_words(self) -> str:
        """How far a fitted pose's two skylines are apart, in words.

        Empty for other poses.
        """
        if self.residual_deg is None or self.terrain_share is None:
            return ""
        if self.terrain_share < _LEAST_SHARE:
            return "the skylines agree nowhere"
        return (
            f"the skylines are {self.residual_deg:.2f} degrees apart (rms) over "
            f"{100.0 * self.terrain_share:.0f} % of the skyline"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the pose's record, as ``skyline match --json`` prints it.

        Unknown values are None, and so are numbers that are not finite, which JSON cannot hold.
        `skyline.pose.noted_pose.NotedPose.from_dict` reads the record.
        """
        return {name: _finite(getattr(self, name)) for name in WRITTEN}

    def cells(self) -> list[str]:
        """Return the values of `COLUMNS` as text; empty where unknown."""
        values = [(getattr(self, name), form) for name, form in COLUMNS.values()]
        return [
            "" if value is None or not math.isfinite(value) else format(value, form)
            for value, form in values
        ]


@dataclass(frozen=True, slots=True, eq=False)
class Ellipse:
    """The ellipse that contains the true position 95 % of the time.

    It assumes normal errors.
    """

    semi_major_m: float
    semi_minor_m: float
    outline_m: Float64Array
    """(P, 2) float64. Easting and northing, counter-clockwise and closed, from one end of the major
    axis on."""

    @classmethod
    def of(cls, candidate: Pose) -> "Ellipse | None":
        """Return a candidate's ellipse; None if its covariance is unknown."""
        if candidate.covariance_m2 is None:
            return None
        major_m, minor_m, azimuth = map(float, ellipse_axes(np.array(candidate.covariance_m2)))
        sine = np.sin(azimuth)
        cosine = np.cos(azimuth)
        turn = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS + 1)
        along = major_m * np.cos(turn)
        across = minor_m * np.sin(turn)
        east = along * sine - across * cosine
        north = along * cosine + across * sine
        outline = np.stack([candidate.easting_m + east, candidate.northing_m + north], axis=1)
        outline[-1] = outline[0]
        return cls(major_m, minor_m, outline)


def ellipse_axes(covariance_m2: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Return the axes of the 95 % ellipses of positions.

    Covariances (..., 2, 2) are of easting and northing, square metres. The results (...) are the
    long and the short semi-axis, metres, and the grid azimuth of the long one, radians, in [0, pi).
    """
    variance, axes = np.linalg.eigh(covariance_m2)
    minor_m, major_m = np.moveaxis(np.sqrt(_CHI_SQUARE_95 * np.maximum(variance, 0.0)), -1, 0)
    return major_m, minor_m, np.arctan2(axes[..., 0, 1], axes[..., 1, 1]) % np.pi


def view_wedge_m(candidate: Pose, reach_m: float) -> Float64Array:
    """Return a candidate's field of view on the map, out to ``reach_m``.

    The outline (P, 2), easting and northing, is counter-clockwise and closed. It begins at the
    camera, unless the view is a full turn.
    """
    steps = max(2, int(np.ceil(candidate.fov_deg / _ARC_STEP_DEG)) + 1)
    half = candidate.fov_deg / 2.0
    # Azimuths fall along the arc, since they count clockwise.
    azimuth = np.radians(candidate.grid_heading_deg + np.linspace(half, -half, steps))
    camera = np.array([[candidate.easting_m, candidate.northing_m]])
    arc = camera + reach_m * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)
    if candidate.fov_deg >= 360.0:
        return np.concatenate([arc[:-1], arc[:1]])
    return np.concatenate([camera, arc, camera])


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
            place = {"easting_m": self.easting_m[mine], "northing_m": self.northing_m[mine]}
            lon[mine], lat[mine] = frame.to_lonlat(**place)
            convergence_deg[mine] = frame.convergence_deg(**place)
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
        """Return whether each pair (M, N) of these and other poses is one answer."""
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


def _finite(value: Any) -> Any:
    """Return a value, or None for numbers that are not finite."""
    return value if value is None or np.isfinite(value).all() else None


def _tuple(value: Any) -> Any:
    """Return a list, and the lists in it, as tuples.

    Anything else is returned unchanged.
    """
    return tuple(map(_tuple, value)) if isinstance(value, list) else value

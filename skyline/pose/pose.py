"""A camera's pose on the map, in degrees."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array
from skyline.camera.camera import Camera
from skyline.geodesy.map_frame import geodesic_m
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

_LEAST_SHARE = 0.005
"""A smaller share of a skyline is 0 % in words."""

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


def _finite(value: Any) -> Any:
    """Return a value, or None for numbers that are not finite."""
    return value if value is None or np.isfinite(value).all() else None

"""A candidate: a place where a photo may have been taken, and how the camera stood there."""

import math
from dataclasses import dataclass
from typing import Any

RIGHT_WITHIN_M, ROUGHLY_WITHIN_M = 200.0, 1000.0
"""Largest errors of an answer that is right, and of one that is roughly right. Poses farther apart
than the first are different answers; farther apart than the second, they are not even roughly the
same answer."""
DISTANCES_M = (RIGHT_WITHIN_M, ROUGHLY_WITHIN_M)

COLUMNS = {
    "latitude °": ("lat", ".5f"), "longitude °": ("lon", ".5f"),
    "heading °": ("heading_deg", ".2f"), "pitch °": ("pitch_deg", ".2f"),
    "roll °": ("roll_deg", ".2f"), "FOV °": ("fov_deg", ".2f"), "score": ("score", ".4f"),
    "confidence": ("confidence", ".2f"), "within 1 km": ("confidence_1km", ".2f"),
}  # fmt: skip
"""Columns of a table of candidates: the field of `Candidate`, and its format."""

_JSON = (
    "easting_m", "northing_m", "lon", "lat", "eye_elevation_m", "radius_m", "heading_deg",
    "pitch_deg", "roll_deg", "fov_deg", "distortion", "score", "confidence", "confidence_1km",
    "refined", "beyond_share",
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A pose that the camera may have had, on the map and in degrees.

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
        Radial distortion k of a wide lens: a point that an ideal lens images at r half widths of
        the photo from its middle appears at ``(1 + k * r**2) * r``. 0 for other lenses.
    easting_m, northing_m : float
        The same place in the store's frame.
    eye_elevation_m : float
        Elevation of the camera above the DEM's datum.
    convergence_deg : float
        Grid convergence at the place: true azimuth minus grid azimuth.
    score : float
        Lower is better; the unit depends on the matcher. NaN for a pose set by hand.
    confidence, confidence_1km : float or None
        Estimated probability that the place is right within 200 m, and within 1 km; None for
        matchers that estimate none.
    refined : bool
        Whether the pose was fitted by rendering.
    covariance_m2 : ((float, float), (float, float)) or None
        Covariance of easting and northing, square metres; None for a pose that was not refined.
    beyond_share : float or None
        Share of the query's skyline in which terrain past the elevation model's edge may rise
        above the model's skyline; None for a pose that was not refined.
    residual_deg : float or None
        Root mean square difference in elevation between the query's skyline and the rendered one,
        over the part of the query that shows terrain; None for a pose that was not refined.
    terrain_share : float or None
        Share of the query's skyline that shows terrain, as against trees or houses; None for a
        pose that was not refined.
    rank : int or None
        Rank among the candidates of its search, 1 for the best; None for a pose that no search
        found.
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
    score: float
    distortion: float = 0.0
    confidence: float | None = None
    confidence_1km: float | None = None
    refined: bool = False
    covariance_m2: tuple[tuple[float, float], tuple[float, float]] | None = None
    beyond_share: float | None = None
    residual_deg: float | None = None
    terrain_share: float | None = None
    rank: int | None = None

    @property
    def origin(self) -> str:
        """The source of the pose: "found, rank 1", "fitted" or "set by hand"."""
        if self.rank is not None:
            return f"found, rank {self.rank}"
        return "fitted" if self.refined else "set by hand"

    @property
    def name(self) -> str:
        """Name among the poses of its photo: "candidate 2", "the fitted pose" and so on."""
        if self.rank is not None:
            return f"candidate {self.rank}"
        return "the fitted pose" if self.refined else "the pose set by hand"

    @property
    def title(self) -> str:
        """The name in captions: "the best candidate", or as `name`."""
        return "the best candidate" if self.rank == 1 else self.name

    @property
    def radius_m(self) -> float | None:
        """Radius of the circle that holds the true place with 68 % probability; None if unknown.

        The probability is that of a round normal distribution with the covariance's mean variance,
        if the candidate is right.
        """
        if self.covariance_m2 is None:
            return None
        (east_m2, _), (_, north_m2) = self.covariance_m2
        return math.sqrt(-2.0 * math.log(1.0 - 0.68) * (east_m2 + north_m2) / 2.0)

    @property
    def grid_heading_deg(self) -> float:
        """Grid azimuth of the optical axis, in [0, 360), as renderers take it."""
        return (self.heading_deg - self.convergence_deg) % 360.0

    @property
    def residual_in_words(self) -> str:
        """The difference of the two skylines of a fitted pose, in words; empty for other poses."""
        if self.residual_deg is None or self.terrain_share is None:
            return ""
        return (
            f"the skylines are {self.residual_deg:.2f} degrees apart (rms) over "
            f"{100.0 * self.terrain_share:.0f} % of the skyline"
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the candidate as ``skyline match --json`` prints it."""
        return {name: getattr(self, name) for name in _JSON}

    def cells(self) -> list[str]:
        """Return the values of `COLUMNS` as text; empty where a value is not known."""
        values = [(getattr(self, name), form) for name, form in COLUMNS.values()]
        return [
            "" if value is None or not math.isfinite(value) else format(value, form)
            for value, form in values
        ]

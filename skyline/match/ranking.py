"""Rankings: the poses that a matcher returns, and how they are selected from all scores."""

from dataclasses import dataclass, fields

import numpy as np

from skyline.arrays import BoolArray, Float64Array, IntArray, Rows
from skyline.errors import InputError
from skyline.geodesy import Frame
from skyline.match.candidate import Candidate
from skyline.match.hypotheses import Hypotheses
from skyline.match.profiles import Profiles

_MEASURED = ("confidence", "confidence_1km", "beyond_share", "residual_deg", "terrain_share")


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """The M poses a matcher answers a query with, best first."""

    poses: Hypotheses
    confidence: Float64Array | None = None
    """(M,) float64. Probability that each is right within 200 m, where something has estimated
    it."""
    covariance_m2: Float64Array | None = None
    """(M, 2, 2) float64. Of easting and northing, where the poses were refined."""
    confidence_1km: Float64Array | None = None
    """(M,) float64. Probability that each is right within 1 km, where something has estimated
    it."""
    beyond_share: Float64Array | None = None
    residual_deg: Float64Array | None = None
    terrain_share: Float64Array | None = None
    """``beyond_share``, ``residual_deg``, ``terrain_share``: (M,) float64. See `Candidate`."""

    def __len__(self) -> int:
        return len(self.poses)

    def candidates(self, frame: Frame) -> tuple[Candidate, ...]:
        """Return the poses as candidates; ``frame`` is that of their eastings and northings."""
        easting_m, northing_m = self.poses.easting_m, self.poses.northing_m
        lon, lat = frame.to_lonlat(easting_m, northing_m)
        convergence_deg = np.zeros(0)
        if len(self):
            convergence_deg = frame.convergence_deg(easting_m=easting_m, northing_m=northing_m)
        heading_deg = (self.poses.heading_deg + convergence_deg) % 360.0
        columns = {f.name: getattr(self.poses, f.name).tolist() for f in fields(Hypotheses)} | {
            "lon": lon.tolist(),
            "lat": lat.tolist(),
            "heading_deg": heading_deg.tolist(),
            "convergence_deg": convergence_deg.tolist(),
            "rank": range(1, len(self) + 1),
        }
        for name in _MEASURED:
            if getattr(self, name) is not None:
                columns[name] = getattr(self, name).tolist()
        if self.covariance_m2 is not None:
            columns["refined"] = [True] * len(self)
            columns["covariance_m2"] = [tuple(map(tuple, m)) for m in self.covariance_m2.tolist()]
        rows = zip(*columns.values(), strict=True)
        return tuple(Candidate(**dict(zip(columns, row, strict=True))) for row in rows)


@dataclass(frozen=True, slots=True, eq=False)
class JointRanking:
    """The M places that a matcher answers N queries of one eye with, best first."""

    rankings: tuple[Ranking, ...]
    """Of each query, M poses; they differ in the camera alone."""
    agrees: BoolArray
    """(N,) bool. Whether each query was taken at the best place rather than anywhere else."""


@dataclass(frozen=True, slots=True, eq=False)
class Fits(Rows):
    """The best pose of a query at each of L locations."""

    score: Float64Array
    """(L,) float64. Lower is better; infinite where there is no fit."""
    heading_deg: Float64Array
    pitch_deg: Float64Array
    roll_deg: Float64Array
    """``heading_deg``, ``pitch_deg``, ``roll_deg``: (L,) float64."""

    @classmethod
    def none(cls, locations: int) -> "Fits":
        """Return no fit at any location."""
        return cls(np.full(locations, np.inf), *np.zeros((3, locations)))

    def placed_among(self, rows: IntArray, locations: int) -> "Fits":
        """Return these as the fits of ``rows`` among ``locations``, with none elsewhere."""
        wide = Fits.none(locations)
        for name in self._names():
            getattr(wide, name)[rows] = getattr(self, name)
        return wide

    def split(self, parts: int) -> list["Fits"]:
        """Return so many parts of equal length, in order."""
        return [self[rows] for rows in np.split(np.arange(len(self.score)), parts)]

    def best_with(self, other: "Fits") -> "Fits":
        """Return the better of two at each location; this one where they are equal."""
        return self.replaced(other.score < self.score, other)


def select(
    profiles: Profiles, fits: Fits, fov_deg: float, top: int, separation_m: float = 0.0
) -> Ranking:
    """Return the best poses, none within ``separation_m`` of a better one.

    Equal scores keep the order of the locations. Locations without a fit are left out. Raises
    `InputError` for a ``top`` below 1.
    """
    if top < 1:
        raise InputError(f"top is {top}; expected at least 1 candidate")
    poses = Hypotheses(
        profiles.easting_m,
        profiles.northing_m,
        profiles.eye_elevation_m,
        fits.heading_deg % 360.0,
        fits.pitch_deg,
        fits.roll_deg,
        np.full(len(profiles), fov_deg),
        np.zeros(len(profiles)),
        fits.score,
    )
    return Ranking(poses[poses.suppress_non_maxima(top, separation_m)])

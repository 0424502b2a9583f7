"""Poses with their scores, from the hypotheses of a search to the candidates of an answer."""

from dataclasses import dataclass, fields

import numpy as np

from skyline.arrays import Float64Array, IntArray, Rows
from skyline.geodesy import Frame, in_turn
from skyline.match.candidate import Candidate


@dataclass(frozen=True, slots=True, eq=False)
class Hypotheses(Rows):
    """M poses that the camera may have had, with their scores."""

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    """``easting_m``, ``northing_m``, ``eye_elevation_m``: (M,) float64. Position of the eye, in
    the store's frame and above the DEM's datum."""
    heading_deg: Float64Array
    """(M,) float64. Grid azimuth of the optical axis, in [0, 360)."""
    pitch_deg: Float64Array
    roll_deg: Float64Array
    fov_deg: Float64Array
    distortion: Float64Array
    """``pitch_deg``, ``roll_deg``, ``fov_deg``, ``distortion``: (M,) float64. As in `Candidate`."""
    score: Float64Array
    """(M,) float64. Lower is better; the unit depends on the step that gave it. Infinite for a
    pose that does not fit."""

    @classmethod
    def of_pose(cls, *pose: float) -> "Hypotheses":
        """Return one pose, given as the attributes in order, without the score, which is 0."""
        return cls(*(np.array([float(value)]) for value in (*pose, 0.0)))

    def distances_m(self) -> Float64Array:
        """Return the horizontal distances (M, M) between the poses."""
        place = self.easting_m + 1j * self.northing_m
        return np.asarray(np.abs(place[:, np.newaxis] - place))

    def rival_margin(self, farther_than_m: float) -> Float64Array:
        """Return the score (M,) of each pose's best rival minus the pose's own score.

        Rivals are the poses farther away than ``farther_than_m``. Infinite for a pose without
        rivals.
        """
        is_rival = self.distances_m() > farther_than_m
        rival = np.where(is_rival, self.score, np.inf).min(axis=1, initial=np.inf)
        return np.asarray(rival - self.score)

    def suppress_non_maxima(
        self, count: int, separation_m: float, turn_deg: float = 360.0
    ) -> IntArray:
        """Return the indices of at most ``count`` distinct poses, best first.

        A pose is left out where a better one lies nearer than ``separation_m`` and looks within
        ``turn_deg`` of the same direction, or where its score is infinite. Equal scores keep their
        order.
        """
        place = self.easting_m + 1j * self.northing_m
        left = np.isfinite(self.score)
        chosen: list[int] = []
        for index in np.argsort(self.score, kind="stable"):
            if len(chosen) == count:
                break
            if not left[index]:
                continue
            chosen.append(int(index))
            turn = np.abs(in_turn(self.heading_deg - self.heading_deg[index]))
            left &= (np.abs(place - place[index]) >= separation_m) | (turn > turn_deg)
            left[index] = False
        return np.array(chosen, dtype=np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class RefinedPoses(Rows):
    """M poses fitted by rendering, best first, with the figures a confidence is learned from."""

    hypotheses: Hypotheses
    """The score is the negative log-likelihood; only differences within one query are
    meaningful."""
    covariance_m2: Float64Array
    """(M, 2, 2) float64. Covariance of easting and northing, square metres, including other optima
    of the same answer."""
    residual_deg: Float64Array
    """(M,) float64. As in `Candidate`."""
    terrain_share: Float64Array
    """(M,) float64. As in `Candidate`."""
    effective_columns: Float64Array
    """(M,) float64. Number of independent columns that would hold as much information."""
    height_sd_m: Float64Array
    """(M,) float64. Standard deviation of the terrain model's height errors that the fit
    suggests."""
    beyond_share: Float64Array
    """(M,) float64. As in `Candidate`."""
    margin: Float64Array
    far_margin: Float64Array
    """``margin``, ``far_margin``: (M,) float64. `Hypotheses.rival_margin` for either of
    `DISTANCES_M`; below 0 for all but the best pose."""


@dataclass(frozen=True, slots=True, eq=False)
class Ranking:
    """The M poses that a matcher answers a query with, best first."""

    poses: Hypotheses
    confidence: Float64Array | None = None
    confidence_1km: Float64Array | None = None
    """``confidence``, ``confidence_1km``: (M,) float64. Probabilities that each is right within
    200 m, and within 1 km; None for matchers that estimate none."""
    refined: RefinedPoses | None = None
    """The same M poses with what refinement found; None where they were not refined."""

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
        for name in ("confidence", "confidence_1km"):
            if getattr(self, name) is not None:
                columns[name] = getattr(self, name).tolist()
        if self.refined is not None:
            for name in ("beyond_share", "residual_deg", "terrain_share"):
                columns[name] = getattr(self.refined, name).tolist()
            covariance_m2 = self.refined.covariance_m2.tolist()
            columns["covariance_m2"] = [tuple(map(tuple, matrix)) for matrix in covariance_m2]
            columns["refined"] = [True] * len(self)
        rows = zip(*columns.values(), strict=True)
        return tuple(Candidate(**dict(zip(columns, row, strict=True))) for row in rows)

"""What a candidate covers on the map: its view's wedge and its ellipse of uncertainty."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.matching.ranking import Candidate

_CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of chi square with two degrees of freedom: -2 ln 0.05."""
_ARC_STEP_DEG = 2.0
_ELLIPSE_POINTS = 72


@dataclass(frozen=True, slots=True)
class Ellipse:
    """The area that holds the true position with 95 % probability, were the errors normal."""

    easting_m: float
    northing_m: float
    """``easting_m``, ``northing_m``: centre."""
    semi_major_m: float
    semi_minor_m: float
    azimuth_deg: float
    """Grid azimuth of the major axis, in [0, 180)."""

    @classmethod
    def of(cls, candidate: Candidate) -> "Ellipse | None":
        """Return a candidate's ellipse, None where its covariance is not known."""
        if candidate.covariance_m2 is None:
            return None
        variance, axes = np.linalg.eigh(np.array(candidate.covariance_m2))
        minor, major = np.sqrt(_CHI_SQUARE_95 * np.maximum(variance, 0.0))
        azimuth_deg = float(np.degrees(np.arctan2(axes[0, 1], axes[1, 1])) % 180.0)
        return cls(
            candidate.easting_m, candidate.northing_m, float(major), float(minor), azimuth_deg
        )

    def outline_m(self) -> Float64Array:
        """Return the outline (P, 2), easting and northing, counter-clockwise and closed."""
        turn = np.linspace(0.0, 2.0 * np.pi, _ELLIPSE_POINTS + 1)
        along, across = self.semi_major_m * np.cos(turn), self.semi_minor_m * np.sin(turn)
        sine, cosine = np.sin(np.radians(self.azimuth_deg)), np.cos(np.radians(self.azimuth_deg))
        outline = np.stack(
            [
                self.easting_m + along * sine - across * cosine,
                self.northing_m + along * cosine + across * sine,
            ],
            axis=1,
        )
        outline[-1] = outline[0]
        return outline


def view_wedge_m(candidate: Candidate, reach_m: float) -> Float64Array:
    """Return what a candidate looks at, out to ``reach_m``: its field of view from above.

    The outline (P, 2), easting and northing, is counter-clockwise and closed; it begins at the
    camera.
    """
    steps = max(2, int(np.ceil(candidate.fov_deg / _ARC_STEP_DEG)) + 1)
    half = candidate.fov_deg / 2.0
    # Azimuths fall along the arc, since they count clockwise.
    azimuth = np.radians(candidate.grid_heading_deg + np.linspace(half, -half, steps))
    camera = np.array([[candidate.easting_m, candidate.northing_m]])
    arc = camera + reach_m * np.stack([np.sin(azimuth), np.cos(azimuth)], axis=1)
    return np.concatenate([camera, arc, camera])

"""A pose's outlines on a map: the 95 % ellipse of its position, and its view."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.pose.pose import Pose

_CHI_SQUARE_95 = 5.991464547107979
"""95 % quantile of chi square with two degrees of freedom: -2 ln 0.05."""
_ARC_STEP_DEG = 2.0
_ELLIPSE_POINTS = 72


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

"""Where the rays of two or more photos cross, and whether they meet at all.

Each photo has a pose, and a pixel of the same thing. The place is the one whose directions from the
cameras differ least from the pixels', in their standard errors; light bends as for skylines.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.geodesy.bounds import in_turn
from skyline.geodesy.earth import Curvature
from skyline.pose import Pose
from skyline.sun_clock import Pointing

LEAST_PROBABILITY = 0.01
"""Rays that would pass as far apart more seldom than this, if they met, are said to miss."""
_LEAST_ANGLE_SDS = 3.0
"""Rays whose azimuths differ by less than so many standard errors have no crossing."""
_ROUNDS = 20
_SETTLED_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Ray:
    """A ray from a camera.

    Attributes
    ----------
    pose : Pose
        The camera.
    pointing : Pointing
        Direction from true north, with its errors.
    position_sd_m : float
        Standard error of the camera's easting, and of its northing.
    height_sd_m : float
        Standard error of its elevation.
    """

    pose: Pose
    pointing: Pointing
    position_sd_m: float
    height_sd_m: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Crossing:
    """The place where rays cross.

    Attributes
    ----------
    easting_m, northing_m, elevation_m : float
        In the frame, above the DEM's datum.
    covariance_m2 : (3, 3) float64
        Of easting, northing and elevation.
    chi_square : float
        Squares of the misfits in standard errors.
    probability : float
        Probability of so great a misfit, or a greater one, if the rays meet.
    """

    easting_m: float
    northing_m: float
    elevation_m: float
    covariance_m2: Float64Array
    chi_square: float
    probability: float

    @property
    def meets(self) -> bool:
        """Whether the rays meet, as far as their errors tell."""
        return self.probability >= LEAST_PROBABILITY


def cross(rays: Sequence[Ray], curvature: Curvature) -> Crossing:
    """Return where rays cross.

    Parameters
    ----------
    rays : sequence of Ray
        Two or more, of cameras in one frame.

    Raises
    ------
    InputError
        There are fewer than two rays, they are parallel within their errors, or they cross behind a
        camera.
    """
    if len(rays) < 2:
        raise InputError(
            f"{len(rays)} ray was given; expected two photos or more of the same thing (for where "
            "one photo's ray meets the ground, use `skyline pixels`)"
        )
    eyes_m = np.array(
        [(one.pose.easting_m, one.pose.northing_m, one.pose.eye_elevation_m) for one in rays]
    )
    seen_deg = np.array(
        [
            (one.pointing.azimuth_deg - one.pose.convergence_deg, one.pointing.elevation_deg)
            for one in rays
        ]
    )
    _check_apart(rays, seen_deg[:, 0])
    place_m = _nearest(eyes_m, seen_deg)
    _check_ahead(place_m, eyes_m, seen_deg[:, 0])
    for _ in range(_ROUNDS):
        off_deg, slopes = _off(place_m, eyes_m, seen_deg, curvature)
        weights = np.array([_weight(ray, slope) for ray, slope in zip(rays, slopes, strict=True)])
        normal = np.einsum("nia,nij,njb->ab", slopes, weights, slopes)
        pull = np.einsum("nia,nij,nj->a", slopes, weights, off_deg)
        step_m = np.linalg.solve(normal, pull)
        place_m = place_m + step_m
        if np.abs(step_m).max() < _SETTLED_M:
            break
    _check_ahead(place_m, eyes_m, seen_deg[:, 0])
    off_deg, _ = _off(place_m, eyes_m, seen_deg, curvature)
    misfit = float(np.einsum("ni,nij,nj->", off_deg, weights, off_deg))
    return Crossing(
        easting_m=float(place_m[0]),
        northing_m=float(place_m[1]),
        elevation_m=float(place_m[2]),
        covariance_m2=np.linalg.inv(normal),
        chi_square=misfit,
        probability=float(chi2.sf(misfit, 2 * len(rays) - 3)),
    )


def _check_apart(rays: Sequence[Ray], azimuth_deg: Float64Array) -> None:
    """Raise `InputError` if all rays are parallel within their errors."""
    first, second = np.triu_indices(len(rays), 1)
    apart_deg = np.abs(in_turn(azimuth_deg[first] - azimuth_deg[second]))
    apart_deg = np.minimum(apart_deg, 180.0 - apart_deg)
    sd_deg = np.array([one.pointing.azimuth_sd_deg for one in rays])
    error_deg = np.hypot(sd_deg[first], sd_deg[second])
    best = int(np.argmax(apart_deg / error_deg))
    if apart_deg[best] < _LEAST_ANGLE_SDS * error_deg[best]:
        raise InputError(
            f"the rays are parallel within their errors: {apart_deg[best]:.2f} degrees apart, give "
            f"or take {error_deg[best]:.2f}; give photos from places farther aside"
        )


def _check_ahead(place_m: Float64Array, eyes_m: Float64Array, azimuth_deg: Float64Array) -> None:
    """Raise `InputError` if a place is behind a camera."""
    towards = place_m[:2] - eyes_m[:, :2]
    azimuth_rad = np.radians(azimuth_deg)
    ahead_m = towards[:, 0] * np.sin(azimuth_rad) + towards[:, 1] * np.cos(azimuth_rad)
    if (ahead_m <= 0.0).any():
        number = int(np.argmin(ahead_m)) + 1
        raise InputError(
            f"the rays cross behind camera {number}, so they do not show the same thing; check the "
            "pixels, and that each photo has its own pose"
        )


def _nearest(eyes_m: Float64Array, seen_deg: Float64Array) -> Float64Array:
    """Return the place with the least distances from straight rays."""
    azimuth, elevation = np.radians(seen_deg).T
    flat = np.cos(elevation)
    along = np.column_stack([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)])
    across = np.eye(3) - along[:, :, np.newaxis] * along[:, np.newaxis, :]
    middle = eyes_m.mean(axis=0)
    pull = np.einsum("nij,nj->i", across, eyes_m - middle)
    return np.asarray(middle + np.linalg.solve(across.sum(axis=0), pull))


def _off(
    place_m: Float64Array, eyes_m: Float64Array, seen_deg: Float64Array, curvature: Curvature
) -> tuple[Float64Array, Float64Array]:
    """Return how far directions are off a place's (N, 2), and their slopes by place (N, 2, 3).

    Degrees of azimuth and elevation, and degrees a metre.
    """
    east, north, up = (place_m - eyes_m).T
    away = np.hypot(east, north)
    tangent = (up - curvature.drop_m(away)) / away
    predicted_deg = np.degrees(np.column_stack([np.arctan2(east, north), np.arctan(tangent)]))
    off_deg = seen_deg - predicted_deg
    off_deg[:, 0] = in_turn(off_deg[:, 0])
    # The tangent's slope by distance, the drop included.
    by_away = -tangent / away - 2.0 * curvature.drop_per_m2
    slopes = np.zeros((len(eyes_m), 2, 3))
    slopes[:, 0, 0], slopes[:, 0, 1] = north / away**2, -east / away**2
    scale = 1.0 / (1.0 + tangent**2)
    slopes[:, 1, 0], slopes[:, 1, 1] = scale * by_away * east / away, scale * by_away * north / away
    slopes[:, 1, 2] = scale / away
    return off_deg, np.degrees(slopes)


def _weight(ray: Ray, slope: Float64Array) -> Float64Array:
    """Return the inverse covariance (2, 2) of a direction, the camera's position included."""
    position_m2 = np.diag([ray.position_sd_m**2, ray.position_sd_m**2, ray.height_sd_m**2])
    pointing = np.linalg.inv(ray.pointing.information)
    return np.asarray(np.linalg.inv(pointing + slope @ position_m2 @ slope.T))

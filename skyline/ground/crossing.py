"""Where rays of two or more photos cross, if they meet.

Each photo has a pose, and a pixel that shows the same thing. The place is the one whose directions
from the cameras differ least from the directions of the pixels, in standard errors; light bends as
for skylines. The errors of a pose's place and direction are correlated, so they are counted
together.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from skyline.angles import angle_between_deg
from skyline.arrays import Float64Array
from skyline.camera.pixels import Pixel
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.photo.skyline import PhotoForm
from skyline.pose.pose import Pose
from skyline.pose.pose_errors import HEADING, PIXEL_SD_PX, Bearings

LEAST_PROBABILITY = 0.01
"""Rays are taken to miss each other if rays that meet would seem so far apart with less than this
probability."""
_LEAST_ANGLE_SDS = 3.0
"""Rays whose azimuths differ by less than this many standard errors do not cross."""
_ROUNDS = 20
_SETTLED_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True)
class Ray:
    """A ray from a camera through a pixel.

    Attributes
    ----------
    pose : Pose
        The camera, with its errors.
    photo : Photo or PhotoSkyline
        Its size and its projection count.
    pixel : (float, float)
        Column and row.
    """

    pose: Pose
    photo: PhotoForm
    pixel: Pixel


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Crossing:
    """The place where rays cross.

    Attributes
    ----------
    easting_m, northing_m, elevation_m : float
        In the frame, above the DEM's datum.
    covariance_m2 : (3, 3) float64
        Covariance of easting, northing and elevation.
    chi_square : float
        Sum of the squared misfits, in standard errors.
    probability : float
        Probability of a misfit at least as great if the rays meet.
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


def cross(rays: Sequence[Ray], curvature: Curvature, pixel_sd_px: float = PIXEL_SD_PX) -> Crossing:
    """Return where rays cross, with the covariance of the place.

    Parameters
    ----------
    rays : sequence of Ray
        Two or more, of cameras in one frame.
    pixel_sd_px : float
        Standard deviation of a pixel's column and row.

    Raises
    ------
    InputError
        There are fewer than two rays, a pixel is outside its photo, or the rays are parallel within
        their errors or cross behind a camera.
    """
    check_enough(len(rays))
    seen = [_Seen.of(ray, pixel_sd_px) for ray in rays]
    _check_apart(seen)
    position_m = _nearest(seen)
    _check_ahead(position_m, seen)
    for _ in range(_ROUNDS):
        normal, pull, _ = _normal_equations(position_m, seen, curvature)
        step_m = np.linalg.solve(normal, pull)
        position_m = position_m + step_m
        if np.abs(step_m).max() < _SETTLED_M:
            break
    _check_ahead(position_m, seen)
    normal, _, misfit = _normal_equations(position_m, seen, curvature)
    return Crossing(
        easting_m=float(position_m[0]),
        northing_m=float(position_m[1]),
        elevation_m=float(position_m[2]),
        covariance_m2=np.asarray(np.linalg.inv(normal), dtype=np.float64),
        chi_square=misfit,
        probability=float(chdtrc(2 * len(rays) - 3, misfit)),
    )


def check_enough(count: int) -> None:
    """Raise `InputError` for fewer photos than cross."""
    if count < 2:
        raise InputError(
            f"photos given: {count}; expected two photos or more of the same thing (for where one "
            "photo's ray meets the ground, use `skyline pixels`)"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """The direction of a camera's pixel, and its errors."""

    eye_m: Float64Array
    """(3,) float64. Easting, northing and elevation."""
    grid_azimuth_rad: float
    elevation_tan: float
    by_pose: Float64Array
    """(2, P) float64. As in `Bearings`."""
    covariance: Float64Array
    """(P, P) float64. As `Pose.covariance`."""
    of_pixel: Float64Array
    """(2, 2) float64. Covariance of azimuth and tangent due to the error of the pixel."""

    @classmethod
    def of(cls, ray: Ray, pixel_sd_px: float) -> "_Seen":
        pose = ray.pose
        camera = pose.camera(ray.photo)
        camera.check_inside(ray.pixel)
        covariance = pose.covariance_or_assumed(ray.photo)
        column_px, row_px = ray.pixel
        seen = Bearings.of(camera, [column_px], [row_px], len(covariance))
        by_pixel = pixel_sd_px * seen.by_pixel[0]
        return cls(
            eye_m=np.array([pose.easting_m, pose.northing_m, pose.eye_elevation_m]),
            grid_azimuth_rad=float(seen.grid_azimuth_rad[0]),
            elevation_tan=float(seen.elevation_tan[0]),
            by_pose=seen.by_pose[0],
            covariance=covariance,
            of_pixel=by_pixel @ by_pixel.T,
        )

    @property
    def ahead(self) -> Float64Array:
        """The direction (3,) of the ray; its horizontal part has length 1."""
        return np.array(
            [np.sin(self.grid_azimuth_rad), np.cos(self.grid_azimuth_rad), self.elevation_tan]
        )

    @property
    def azimuth_sd_rad(self) -> float:
        """Standard error of the azimuth."""
        return float(np.sqrt(self.spread(np.zeros((2, 3)))[0, 0]))

    def spread(self, by_position: Float64Array) -> Float64Array:
        """Return the covariance (2, 2) of a position's offset from the ray.

        ``by_position`` (2, 3) are the derivatives of the position's direction by the position: an
        eye that moves the other way changes the direction alike.
        """
        by_pose = self.by_pose.copy()
        by_pose[:, :HEADING] += by_position
        return np.asarray(by_pose @ self.covariance @ by_pose.T + self.of_pixel)

    def off(
        self, position_m: Float64Array, curvature: Curvature
    ) -> tuple[Float64Array, Float64Array]:
        """Return the angles (2,) between the ray and a position's direction.

        The second result (2, 3) has the derivatives of that direction by the position. Azimuths are
        in radians, elevations are tangents.
        """
        azimuth, tangent, _ = seen = curvature.seen(*(position_m - self.eye_m))
        turn = math.remainder(self.grid_azimuth_rad - float(azimuth), 2.0 * math.pi)
        off = np.array([turn, self.elevation_tan - float(tangent)])
        return off, curvature.seen_changes(*seen)


def _normal_equations(
    position_m: Float64Array, seen: Sequence[_Seen], curvature: Curvature
) -> tuple[Float64Array, Float64Array, float]:
    """Return a position's normal matrix, its pull, and the squared misfits."""
    normal, pull, misfit = np.zeros((3, 3)), np.zeros(3), 0.0
    for one in seen:
        off, slopes = one.off(position_m, curvature)
        weight = np.linalg.inv(one.spread(slopes))
        normal += slopes.T @ weight @ slopes
        pull += slopes.T @ weight @ off
        misfit += float(off @ weight @ off)
    return normal, pull, misfit


def _check_apart(seen: Sequence[_Seen]) -> None:
    """Raise `InputError` if all rays are parallel within their errors."""
    first, second = np.triu_indices(len(seen), 1)
    grid_azimuth_deg = np.degrees([one.grid_azimuth_rad for one in seen])
    apart_deg = angle_between_deg(grid_azimuth_deg[first], grid_azimuth_deg[second])
    apart_deg = np.minimum(apart_deg, 180.0 - apart_deg)
    sd_deg = np.degrees([one.azimuth_sd_rad for one in seen])
    error_deg = np.hypot(sd_deg[first], sd_deg[second])
    best = int(np.argmax(apart_deg / error_deg))
    if apart_deg[best] < _LEAST_ANGLE_SDS * error_deg[best]:
        raise InputError(
            f"the rays are parallel within their errors: {apart_deg[best]:.2f} degrees apart, give "
            f"or take {error_deg[best]:.2f}; give photos from places farther apart"
        )


def _check_ahead(position_m: Float64Array, seen: Sequence[_Seen]) -> None:
    """Raise `InputError` if a position is behind a camera."""
    ahead_m = [float((position_m - one.eye_m)[:2] @ one.ahead[:2]) for one in seen]
    if min(ahead_m) <= 0.0:
        number = int(np.argmin(ahead_m)) + 1
        raise InputError(
            f"the rays cross behind camera {number}, so they do not show the same thing; check the "
            "pixels, and that each photo has its own pose"
        )


def _nearest(seen: Sequence[_Seen]) -> Float64Array:
    """Return the position with the least distances from straight rays."""
    eyes_m = np.array([one.eye_m for one in seen])
    along = np.array([one.ahead / np.linalg.norm(one.ahead) for one in seen])
    across = np.eye(3) - along[:, :, np.newaxis] * along[:, np.newaxis, :]
    middle = eyes_m.mean(axis=0)
    pull = np.einsum("nij,nj->i", across, eyes_m - middle)
    return np.asarray(middle + np.linalg.solve(across.sum(axis=0), pull))

r"""The ground that pixels show, with its errors, and the way back.

A ray of azimuth a and tangent y meets the ground at the distance d. There the ground rises by g,
and by s more steeply than the ray. If the eye stood at t (east, north) and up from where it is
taken to stand, the ray were off by da and dy, and the ground were higher by h, it would meet the
ground farther off by

.. math::

    \mathrm{d}d = (up + d\,\mathrm{d}y - g \cdot t - d\,g_\perp\,\mathrm{d}a - h) / s

where :math:`g_\perp` is the rise to the right of the ray. Ground is no plane, so s is the mean
slope up to where rays meet it that are two standard errors higher and lower.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import BoolArray, Float64Array, Rows
from skyline.camera.camera import Camera
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.pose.outlines import ellipse_axes
from skyline.pose.pose_errors import EAST, NORTH, PIXEL_SD_PX, UP, Bearings
from skyline.progress import Progress
from skyline.terrain.heightfield import HeightField, ground_of, ground_slope
from skyline.terrain.ray_casting import first_hits_m
from skyline.terrain.viewpoints import Viewpoints

GRAZING = 0.05
"""A ray grazes the ground if it meets it at a slope below this, about 3 degrees: a metre of height
moves the place by 20 m or more."""
_SDS = 2.0
"""The rays beside a ray are this many standard errors away from it."""
_LEAST_SD_RAD = 1e-4
"""They are at least this far away, a part of a pixel: any nearer, all ground is a plane."""
_LEAST_SLOPE = 1e-3
"""The slopes of a ray and the ground that it meets must differ by more than this."""
_HIDDEN_PX = 0.5
"""Ground is hidden if it would still be hidden this much higher up in the photo."""
_HIDDEN_SAMPLES = 2.0
"""Ground hides what lies at least this many samples behind it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundErrors:
    """Errors of drawn pixels, and of a terrain model."""

    pixel_sd_px: float = PIXEL_SD_PX
    """Standard deviation of a pixel's column and row: the accuracy of drawing by hand."""
    height_sd_m: float | None = None
    """Standard deviation of the model's heights; by default `HeightField.height_sd_m`."""

    def height_sd_on(self, terrain: HeightField) -> float:
        """Return the standard deviation of a terrain model's heights, metres."""
        return terrain.height_sd_m if self.height_sd_m is None else self.height_sd_m

    def __post_init__(self) -> None:
        for name in ("pixel_sd_px", "height_sd_m"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise InputError(f"{name} is {value:g}; expected 0 or more")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class GroundPoints(Rows):
    """N places on the ground that pixels show.

    NaN for sky. Derivatives are of easting, northing and elevation, metres.
    """

    easting_m: Float64Array
    """(N,) float64. In the terrain's frame."""
    northing_m: Float64Array
    """(N,) float64."""
    elevation_m: Float64Array
    """(N,) float64. Above the DEM's datum."""
    distance_m: Float64Array
    """(N,) float64. Horizontal distance from the camera."""
    by_pose: Float64Array
    """(N, 3, P) float64. By the unknowns of `Pose.covariance`."""
    by_pixel: Float64Array
    """(N, 3, 2) float64. By a column to the right and a row down."""
    by_height: Float64Array
    """(N, 3) float64. By a metre by which the model is too high there."""
    covariance_m2: Float64Array
    """(N, 3, 3) float64. Covariance of easting, northing and elevation."""
    slope: Float64Array
    """(N,) float64. How much more steeply the ground rises than the ray; a metre of height moves
    the place by 1 / slope."""

    @property
    def is_sky(self) -> BoolArray:
        """(N,) bool: True for sky."""
        return np.isnan(self.distance_m)

    @property
    def is_grazing(self) -> BoolArray:
        """(N,) bool: True where the ray grazes the ground, see `GRAZING`."""
        return self.slope < GRAZING

    @property
    def error_m(self) -> Float64Array:
        """(N,) float64: standard error of the place, as rms distance."""
        return np.asarray(np.sqrt(self.covariance_m2[:, 0, 0] + self.covariance_m2[:, 1, 1]))

    @property
    def axes(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Semi-axes and grid azimuths (N,) of the 95 % ellipses.

        The semi-axes are in metres; the azimuths are of the long ones, in radians.
        """
        return ellipse_axes(np.nan_to_num(self.covariance_m2[:, :2, :2]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class GroundPixels(Rows):
    """The pixels of N places on the ground."""

    column_px: Float64Array
    """(N,) float64. NaN for ground that is not in front of the camera."""
    row_px: Float64Array
    """(N,) float64."""
    distance_m: Float64Array
    """(N,) float64. Horizontal distance from the camera."""
    is_hidden: BoolArray
    """(N,) bool. Whether other ground stands in front of it; False far outside the photo."""


@dataclass(frozen=True, eq=False, kw_only=True)
class GroundView:
    """The ground as one camera sees it."""

    terrain: HeightField
    curvature: Curvature
    eye: Viewpoints
    """One eye."""
    camera: Camera
    covariance: Float64Array
    """(P, P) float64. As `Pose.covariance`."""

    @cached_property
    def _step_rad(self) -> float:
        """Half of the narrowest column."""
        width_px, fov_deg = self.camera.width_px, self.camera.fov_deg
        return math.radians(self.camera.projection.column_deg(width_px, fov_deg).min()) / 2.0

    def hits_m(
        self,
        azimuth_rad: Float64Array,
        elevation_tan: Float64Array,
        progress: Progress | None = None,
    ) -> Float64Array:
        """Return distances (N,) at which rays meet ground; NaN for sky.

        Azimuths are grid azimuths.
        """
        rays = azimuth_rad.ravel(), elevation_tan.ravel()
        found_m = first_hits_m(
            self.terrain, self.eye, self.curvature, *rays, self._step_rad, progress
        )
        return found_m.reshape(azimuth_rad.shape)

    def at_m(
        self, azimuth_rad: Float64Array, elevation_tan: Float64Array, distance_m: Float64Array
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Return easting, northing and elevation at distances along rays.

        Azimuths are grid azimuths.
        """
        eye = self.eye
        return (
            eye.easting_m + distance_m * np.sin(azimuth_rad),
            eye.northing_m + distance_m * np.cos(azimuth_rad),
            eye.eye_elevation_m + elevation_tan * distance_m + self.curvature.drop_m(distance_m),
        )

    def points(
        self, column_px: Float64Array, row_px: Float64Array, errors: GroundErrors | None = None
    ) -> GroundPoints:
        """Return the ground that N pixels show, with its errors.

        Raises `InputError` unless columns and rows are N finite numbers each.
        """
        column_px, row_px = _finite_pixels(column_px, row_px)
        errors = errors or GroundErrors()
        height_sd_m = errors.height_sd_on(self.terrain)
        known = len(self.covariance)
        bearings = Bearings.of(self.camera, column_px, row_px, known)
        azimuth, tan = bearings.grid_azimuth_rad, bearings.elevation_tan
        away_m = self.hits_m(azimuth, tan)
        easting_m, northing_m, elevation_m = self.at_m(azimuth, tan, away_m)
        ahead, aside = self._rises(azimuth, easting_m, northing_m)
        changes = np.concatenate([bearings.by_pose, bearings.by_pixel], axis=2)
        turn, lift = changes[:, 0], changes[:, 1]
        # How much higher rays pass over the place, by pose and by pixel.
        over = away_m[:, np.newaxis] * (lift - aside[:, np.newaxis] * turn)
        sine, cosine = np.sin(azimuth), np.cos(azimuth)
        over[:, EAST] -= ahead * sine + aside * cosine
        over[:, NORTH] -= ahead * cosine - aside * sine
        over[:, UP] += 1.0
        of_pose, of_pixel = over[:, :known], over[:, -2:]
        variance_m2 = height_sd_m**2 + errors.pixel_sd_px**2 * (of_pixel**2).sum(axis=1)
        variance_m2 += np.einsum("np,pq,nq->n", of_pose, self.covariance, of_pose)
        falls = 2.0 * self.curvature.drop_per_m2 * away_m
        slope = self._mean_slope(azimuth, tan, away_m, ahead - tan - falls, np.sqrt(variance_m2))
        # Metres farther along the ray, to its right, and up.
        along = over / slope[:, np.newaxis]
        right = away_m[:, np.newaxis] * turn
        rise = along * (tan + falls)[:, np.newaxis] + away_m[:, np.newaxis] * lift
        east = along * sine[:, np.newaxis] + right * cosine[:, np.newaxis]
        north = along * cosine[:, np.newaxis] - right * sine[:, np.newaxis]
        east[:, EAST] += 1.0
        north[:, NORTH] += 1.0
        rise[:, UP] += 1.0
        change = np.stack([east, north, rise], axis=1)
        by_height = np.stack([-sine, -cosine, -(tan + falls)], axis=1) / slope[:, np.newaxis]
        by_pose, by_pixel = change[..., :known], change[..., -2:]
        covariance_m2 = height_sd_m**2 * by_height[..., np.newaxis] * by_height[:, np.newaxis]
        covariance_m2 += errors.pixel_sd_px**2 * by_pixel @ by_pixel.swapaxes(1, 2)
        covariance_m2 += by_pose @ self.covariance @ by_pose.swapaxes(1, 2)
        return GroundPoints(
            easting_m=easting_m,
            northing_m=northing_m,
            elevation_m=elevation_m,
            distance_m=away_m,
            by_pose=by_pose,
            by_pixel=by_pixel,
            by_height=by_height,
            covariance_m2=covariance_m2,
            slope=slope,
        )

    def pixels(
        self, easting_m: Float64Array, northing_m: Float64Array, hides_m: float | None = None
    ) -> GroundPixels:
        """Return where N places of the ground appear; NaN off the map.

        Ground hides what lies ``hides_m`` behind it, or farther; by default two samples of the
        model.
        """
        ground_m = self.terrain.height_at(easting_m=easting_m, northing_m=northing_m)
        azimuth, tan, away_m = self.curvature.seen(
            easting_m - self.eye.easting_m,
            northing_m - self.eye.northing_m,
            ground_m - self.eye.eye_elevation_m,
        )
        column_px, row_px = self.camera.pixels(np.degrees(azimuth), tan)
        is_seen = np.abs(column_px - self.camera.width_px / 2.0) <= self.camera.width_px
        is_seen &= np.abs(row_px - self.camera.height_px / 2.0) <= self.camera.height_px
        clear_tan = tan[is_seen] + _HIDDEN_PX * 2.0 * self._step_rad * (1.0 + tan[is_seen] ** 2)
        hit_m = self.hits_m(azimuth[is_seen], clear_tan)
        if hides_m is None:
            hides_m = _HIDDEN_SAMPLES * self.terrain.spacing_m
        behind_m = away_m[is_seen] - hides_m
        is_hidden = np.zeros(len(away_m), dtype=bool)
        is_hidden[is_seen] = hit_m < behind_m
        return GroundPixels(
            column_px=column_px, row_px=row_px, distance_m=away_m, is_hidden=is_hidden
        )

    def _rises(
        self, azimuth_rad: Float64Array, easting_m: Float64Array, northing_m: Float64Array
    ) -> tuple[Float64Array, Float64Array]:
        """Return the ground's rise (N,) along rays, and to their right."""
        east, north = ground_slope(ground_of(self.terrain), easting_m, northing_m).T
        sine, cosine = np.sin(azimuth_rad), np.cos(azimuth_rad)
        return east * sine + north * cosine, east * cosine - north * sine

    def _mean_slope(
        self,
        azimuth_rad: Float64Array,
        elevation_tan: Float64Array,
        distance_m: Float64Array,
        slope: Float64Array,
        sd_m: Float64Array,
    ) -> Float64Array:
        """Return how much more steeply than rays (N,) the ground rises.

        ``sd_m`` (N,) is the standard error of a ray's height over the place where it meets the
        ground, and ``slope`` the slope right there, which stands in where the ray beside it shows
        sky.
        """
        sd_m = np.maximum(sd_m, _LEAST_SD_RAD * distance_m)
        with np.errstate(divide="ignore", invalid="ignore"):
            aside = _SDS * sd_m / distance_m
        beside_m = self.hits_m(
            np.stack([azimuth_rad, azimuth_rad]),
            np.stack([elevation_tan - aside, elevation_tan + aside]),
        )
        slope = np.maximum(slope, _LEAST_SLOPE)
        moved_m = np.where(np.isnan(beside_m), _SDS * sd_m / slope, np.abs(beside_m - distance_m))
        mean_m = np.sqrt(np.mean(moved_m**2, axis=0))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(_SDS * sd_m / mean_m)


def _finite_pixels(column_px: ArrayLike, row_px: ArrayLike) -> tuple[Float64Array, Float64Array]:
    """Return columns and rows (N,); raises as `GroundView.points`."""
    column, row = (np.asarray(one, dtype=np.float64) for one in (column_px, row_px))
    if column.ndim != 1 or column.shape != row.shape:
        raise InputError(
            f"columns are {column.shape} and rows {row.shape}; expected equally many, (N,)"
        )
    off = ~np.isfinite(column + row)
    if off.any():
        raise InputError(f"pixel {int(off.argmax())} is not a finite column and row")
    return column, row

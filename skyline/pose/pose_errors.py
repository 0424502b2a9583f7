"""Errors of a pose, and of the directions of its photo's pixels.

All of them start from one covariance, `Pose.covariance`; a pose that has none gets the
one of `AssumedErrors`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, Rows
from skyline.camera.camera import Camera
from skyline.camera.projection import MAX_PANORAMA_DEG

EAST, NORTH, UP, HEADING, PITCH, ROLL, LOG_SCALE, WARP = range(8)
"""Unknowns of a pose, in the order of the rows of `Pose.covariance`: metres, radians,
and the logarithm of the image's scale. The distortion or the wander is from `WARP` on."""
ANGLES = ("heading", "pitch", "roll", "fov")
"""Names of the angles whose standard errors are given."""
PIXEL_SD_PX = 1.0
"""Standard deviation of a marked pixel's column and row: the accuracy of drawing by hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AssumedErrors:
    """Standard errors of a pose without a covariance: a person wrote it."""

    position_sd_m: float = 10.0
    """Of easting and northing: as from a phone in the open, or a map."""
    elevation_sd_m: float = 7.0
    """Of the eye: as the heights of a 30 m model on whose ground the camera stands
    (`skyline.terrain.heightfield.HeightField.height_sd_m`)."""
    angle_sd_deg: float = 0.5
    """Of an angle that is written to a whole degree (0.3 degrees), and read no better than that."""
    level_pitch_sd_deg: float = 6.0
    """Of a pitch of exactly 0: nobody measured it, and cameras are held about this level."""
    level_roll_sd_deg: float = 3.0
    """Of a roll of exactly 0."""
    fov_sd_share: float = 0.02
    """Of a field of view, as a share of it: what people know of a lens. A full turn is exact."""

    def angles_deg(self, camera: Camera) -> tuple[float, float, float]:
        """Return the standard errors of heading, pitch and roll."""
        return (
            self.angle_sd_deg,
            self.angle_sd_deg if camera.pitch_deg else self.level_pitch_sd_deg,
            self.angle_sd_deg if camera.roll_deg else self.level_roll_sd_deg,
        )

    def covariance(self, camera: Camera) -> Float64Array:
        """Return the covariance (7, 7) of the unknowns of a camera's pose."""
        half_width = camera.projection.half_width(camera.fov_deg)
        narrower = camera.projection.half_width(camera.fov_deg * (1.0 - self._fov_share(camera)))
        sds = [self.position_sd_m, self.position_sd_m, self.elevation_sd_m]
        sds += map(math.radians, self.angles_deg(camera))
        return np.diag(np.square([*sds, math.log(half_width / narrower)]))

    def in_words(self, camera: Camera) -> str:
        """Return the standard errors of a camera's pose in words."""
        heading, pitch, roll = self.angles_deg(camera)
        return (
            f"place {self.position_sd_m:g} m, elevation {self.elevation_sd_m:g} m, heading "
            f"{heading:g}, pitch {pitch:g} and roll {roll:g} degrees, field of view "
            f"{100.0 * self._fov_share(camera):g} %"
        )

    def _fov_share(self, camera: Camera) -> float:
        return self.fov_sd_share if camera.fov_deg < MAX_PANORAMA_DEG else 0.0


ASSUMED = AssumedErrors()


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Bearings(Rows):
    """Directions of N pixels, and their derivatives by pose and pixel."""

    grid_azimuth_deg: Float64Array
    """(N,) float64. From grid north."""
    elevation_tan: Float64Array
    """(N,) float64."""
    by_pose: Float64Array
    """(N, 2, P) float64. Derivatives of azimuth, radians, and tangent by the unknowns of
    `Pose.covariance`; 0 for the eye's position."""
    by_pixel: Float64Array
    """(N, 2, 2) float64. The same by a column to the right and a row down."""

    @property
    def grid_azimuth_rad(self) -> Float64Array:
        """(N,) float64."""
        return np.radians(self.grid_azimuth_deg)

    @classmethod
    def of(
        cls, camera: Camera, column_px: ArrayLike, row_px: ArrayLike, unknowns: int
    ) -> "Bearings":
        """Return directions of a camera's pixels, for a number of unknowns."""
        grid_azimuth_deg, tangent = camera.directions(column_px, row_px)
        changes = np.stack(camera.changes(column_px, row_px), axis=1)
        still = np.zeros((len(changes), 2, HEADING))
        return cls(
            grid_azimuth_deg=grid_azimuth_deg,
            elevation_tan=tangent,
            by_pose=np.concatenate([still, changes], axis=2)[..., :unknowns],
            by_pixel=camera.spans(column_px, row_px),
        )

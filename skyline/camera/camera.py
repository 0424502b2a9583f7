"""A camera with its picture: from pixels to directions, and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, refuse_text
from skyline.camera.image_points import ImagePoints
from skyline.camera.levelling import level, project
from skyline.camera.pixels import Pixel, from_middle, in_picture
from skyline.camera.projection import Projection
from skyline.camera.warps import WANDER_DEGREES, distorted, undistorted, wandered
from skyline.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A camera with the size of its picture, held in an attitude.

    Attributes
    ----------
    projection : Projection
    width_px, height_px : int
        Size of the picture.
    fov_deg : float
        Horizontal field of view.
    grid_heading_deg : float
        Grid azimuth of the optical axis.
    pitch_deg, roll_deg : float
        See `level`.
    distortion : float
        See `undistorted`.
    wander : tuple of float
        See `wandered`; empty for none.
    """

    projection: Projection
    width_px: int
    height_px: int
    fov_deg: float
    grid_heading_deg: float
    pitch_deg: float
    roll_deg: float
    distortion: float = 0.0
    wander: tuple[float, ...] = ()

    def check_inside(self, pixel: Pixel) -> None:
        """Raise `InputError` for a pixel outside the picture."""
        if not in_picture(*pixel, self.width_px, self.height_px):
            raise InputError(
                f"pixel {pixel[0]:g},{pixel[1]:g} is outside the photo of {self.width_px} x "
                f"{self.height_px} pixels; expected COLUMN,ROW from the upper left corner"
            )

    @property
    def warp(self) -> tuple[float, ...]:
        """The distortion of a lens, or all factors of a panorama's wander."""
        if self.projection.is_panorama:
            return self.wander or (0.0,) * len(WANDER_DEGREES)
        return (self.distortion,)

    def pixels(
        self, grid_azimuth_deg: ArrayLike, elevation_tan: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return the columns and rows at which directions appear.

        NaN for directions that are not in front of the camera.
        """
        refuse_text(grid_azimuth_deg=grid_azimuth_deg, elevation_tan=elevation_tan)
        turn = np.radians(np.asarray(grid_azimuth_deg, dtype=np.float64) - self.grid_heading_deg)
        tangent = np.asarray(elevation_tan, dtype=np.float64)
        u, v = project(turn, tangent, self.pitch_deg, self.roll_deg, self.projection)
        if self.wander:
            v = v - wandered(u / self.projection.half_width(self.fov_deg), self.wander)
        across, above = self.projection.places(u, v, self.fov_deg)
        across, above = distorted(across, above, self.distortion, self.projection)
        half_px = self.width_px / 2.0
        return (
            across * half_px + (self.width_px - 1.0) / 2.0,
            (self.height_px - 1.0) / 2.0 - above * half_px,
        )

    def directions(
        self, column_px: ArrayLike, row_px: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return the grid azimuths, degrees, and elevation tangents of pixels.

        The inverse of `pixels`.
        """
        refuse_text(column_px=column_px, row_px=row_px)
        across, above = from_middle(column_px, row_px, self.width_px, self.height_px)
        straight = undistorted(across, above, self.distortion, self.projection)
        u, v = self.projection.rays(*straight, self.fov_deg)
        if self.wander:
            v = v + wandered(across, self.wander)
        turn, tangent = level(u, v, self.pitch_deg, self.roll_deg, self.projection)
        return np.degrees(turn) + self.grid_heading_deg, tangent

    def changes(self, column_px: ArrayLike, row_px: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return how the directions of N pixels change with the camera.

        Returns
        -------
        azimuth_change, tangent_change : (N, 4 + K) float64
            Derivatives of the azimuth, radians, and of the tangent of elevation, by heading, pitch
            and roll, radians, by the logarithm of the image's scale, and by K warps: the distortion
            of a lens, K = 1, or the ways in which a panorama's rows wander, K = 4.
        """
        across, above = from_middle(column_px, row_px, self.width_px, self.height_px)
        u, v = self.projection.rays(across, above, self.fov_deg)
        points = ImagePoints(u=u, v=v, fov_deg=self.fov_deg, projection=self.projection)
        pitch_rad, roll_rad = np.radians([[self.pitch_deg], [self.roll_deg]])
        _, _, by_azimuth, by_tangent = (
            one[0]
            for one in points.levelled_with_changes(
                pitch_rad, roll_rad, np.zeros(1), np.array([self.warp])
            )
        )
        by_heading = np.ones((len(by_azimuth), 1))
        return (
            np.concatenate([by_heading, by_azimuth], axis=1),
            np.concatenate([0.0 * by_heading, by_tangent], axis=1),
        )

    def spans(self, column_px: ArrayLike, row_px: ArrayLike) -> Float64Array:
        """Return how directions change from each of N pixels to the next.

        The derivatives (N, 2, 2) are of the azimuth, radians, and the tangent of elevation, by a
        column to the right and by a row down.
        """
        column, row = np.broadcast_arrays(
            np.asarray(column_px, dtype=np.float64), np.asarray(row_px, dtype=np.float64)
        )
        before, after = (
            self.directions(np.stack([column + side, column]), np.stack([row, row + side]))
            for side in (-0.5, 0.5)
        )
        return np.stack([np.radians(after[0] - before[0]).T, (after[1] - before[1]).T], axis=1)

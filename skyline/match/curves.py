r"""Skylines of eyes as curves, and their change as the eyes move.

An eye that moves by (e, n, up) sees a skyline point at azimuth a, elevation tangent y and
horizontal distance d move by

.. math::

    \mathrm{d}a = (n \sin a - e \cos a) / d, \qquad
    \mathrm{d}y = (y\,(e \sin a + n \cos a) - up) / d

The eye moves on the ground, whose slope ties up to e and n, at a height above it. One rendering
with its depth therefore gives the derivatives with respect to all unknowns.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Complex128Array, Float64Array, Rows
from skyline.match.rays import Rays
from skyline.pose.pose_errors import EAST, HEADING, NORTH, PITCH, UP, WARP

EYE_HEIGHT = UP
"""Column of a state with the eye's height above the ground, metres. The other columns of a state
are the unknowns of a pose: `EAST` and `NORTH` are the eye's displacement, and from `WARP` on there
is a column for each warp of `Rays.warp_sd`."""

MOVE = slice(EAST, HEADING)
"""The columns of a state that move the eye."""
_TANGENT, _SLOPE, _BY_MOVE, _DISTANCE, _RISE = 0, 1, slice(2, 5), 5, 6
"""Channels of curves: the elevation tangent, its slope by azimuth, its derivatives by a metre east,
north and up, the distance, and how far things may rise above the tangent."""


@dataclass(frozen=True, slots=True, eq=False)
class Linearization:
    """Residuals of M states and their derivatives."""

    residual_rad: Float64Array
    """(M, R) float64. Photo minus terrain; NaN where the terrain is unknown."""
    jacobian: Float64Array
    """(M, P, R) float64. 0 where the terrain is unknown."""
    azimuth_rad: Float64Array
    """(M, R) float64. Azimuth of the terrain's skyline in each column."""
    distance_m: Float64Array
    """(M, R) float64. Distance of the terrain's skyline in each column."""
    rise_rad: Float64Array | None
    """(M, R) float64. How far things may rise above the terrain's skyline; None without a surface
    model."""
    position_m: Complex128Array
    """(M,) complex128. Places of the states' eyes; see `Curves`."""
    eye_m: Float64Array
    """(M,) float64. Elevations of the states' eyes over level ground around the curve's eye."""
    elevation_tan: Float64Array
    """(M, R) float64. Elevation tangent of the terrain's skyline; NaN where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class Curves(Rows):
    """The skylines of M eyes, with derivatives by the eyes' moves."""

    channels: Float64Array
    """(M, B, 6 or 7) float64. The channels `_TANGENT` to `_RISE`, without the last if there is no
    surface model, at azimuth 360 b / B degrees. NaN where unknown."""
    position_m: Complex128Array
    """(M,) complex128. Eastings of the eyes, and northings as the imaginary part."""
    ground_m: Float64Array
    """(M,) float64. Elevation of the ground there."""
    eye_height_m: Float64Array
    """(M,) float64. Height of the eyes above the ground."""

    @classmethod
    def of(
        cls,
        y: Float64Array,
        distance_m: Float64Array,
        position_m: Complex128Array,
        ground_m: Float64Array,
        ground_slope: Float64Array,
        eye_height_m: Float64Array,
        surface_y: Float64Array | None = None,
    ) -> "Curves":
        """Return the curves of skylines all the way round.

        The skylines are as `joined_views` returns them. ``ground_slope`` (M, 2) is the rise of the
        ground per metre to the east and to the north, ``surface_y`` (M, B) the elevation tangents
        of the surface model, seen by the same eyes.
        """
        step = 2.0 * np.pi / y.shape[1]
        slope = (np.roll(y, -1, axis=1) - np.roll(y, 1, axis=1)) / (2.0 * step)
        sine, cosine = np.sin(step * np.arange(y.shape[1])), np.cos(step * np.arange(y.shape[1]))
        east = (y * sine + slope * cosine - ground_slope[:, :1]) / distance_m
        north = (y * cosine - slope * sine - ground_slope[:, 1:]) / distance_m
        channels = [y, slope, east, north, -1.0 / distance_m, distance_m]
        if surface_y is not None:
            channels.append(np.maximum(surface_y - y, 0.0))
        return cls(np.stack(channels, axis=-1), position_m, ground_m, eye_height_m)

    def at(self, azimuth_rad: Float64Array) -> Float64Array:
        """Return the channels (M, R, 6 or 7) at azimuths (M, R).

        They are linear between bins.
        """
        count, bins, channels = self.channels.shape
        position = azimuth_rad * (bins / (2.0 * np.pi))
        left = np.floor(position).astype(np.intp)
        share = (position - left)[..., np.newaxis]
        flat = self.channels.reshape(-1, channels)
        row = np.arange(count)[:, np.newaxis] * bins
        before, after = flat[row + left % bins], flat[row + (left + 1) % bins]
        return np.asarray(before + (after - before) * share)

    def linearized(self, rays: Rays, state: Float64Array) -> Linearization:
        """Return the residuals of rays and their derivatives at states (M, P)."""
        pitch, roll, log_scale = state[:, PITCH:WARP].T
        turned, ray_y, turned_change, ray_change = rays.levelled_with_changes(
            pitch, roll, log_scale, state[:, WARP:]
        )
        azimuth = turned + state[:, HEADING, np.newaxis]
        skyline = self.at(azimuth)
        by_move = skyline[..., _BY_MOVE]
        move = state[:, MOVE].copy()
        move[:, EYE_HEIGHT] -= self.eye_height_m
        y = skyline[..., _TANGENT] + (by_move @ move[..., np.newaxis])[..., 0]
        # Differences of tangents become angles; the derivative of this factor is left out.
        to_angle = 1.0 / (1.0 + ray_y**2)
        by_heading = -skyline[..., _SLOPE, np.newaxis]
        by_attitude = ray_change + by_heading * turned_change
        change = np.concatenate([-by_move, by_heading, by_attitude], axis=-1)
        # The photo's columns come last, since products sum over them.
        jacobian = np.ascontiguousarray(change.swapaxes(1, 2))
        jacobian *= to_angle[:, np.newaxis]
        residual = (ray_y - y) * to_angle
        # Next to an unknown column the curve may be known but not its slope.
        known = np.isfinite(residual) & np.isfinite(jacobian).all(axis=1)
        has_surface = skyline.shape[-1] > _RISE
        return Linearization(
            residual_rad=np.where(known, residual, np.nan),
            jacobian=np.where(known[:, np.newaxis], jacobian, 0.0),
            azimuth_rad=azimuth,
            distance_m=skyline[..., _DISTANCE],
            rise_rad=skyline[..., _RISE] * to_angle if has_surface else None,
            position_m=self.position_m + state[:, EAST] + 1j * state[:, NORTH],
            eye_m=self.ground_m + state[:, EYE_HEIGHT],
            elevation_tan=y,
        )

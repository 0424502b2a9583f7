"""Points of an image, at many attitudes, scales and warps at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skyline.arrays import Float32Array, Float64Array
from skyline.camera.levelling import axes_with_changes, level_axes, panorama_with_changes
from skyline.camera.projection import Projection
from skyline.camera.warps import fixed_at, wander_ways

_LEAST_FORWARD = np.float32(0.05)
"""`ImagePoints.levelled` moves rays of a lens that point less far forward to this value."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ImagePoints:
    """R points on an image of unit focal length, and its projection."""

    u: Float64Array
    """(R,) float64. Position to the right of the image's middle; see `Projection.rays`."""
    v: Float64Array
    """(R,) float64. Position above the image's middle."""
    fov_deg: float
    """Horizontal field of view with which u and v were computed."""
    projection: Projection = Projection.PERSPECTIVE

    @property
    def is_panorama(self) -> bool:
        """True if the photo was swept or stitched."""
        return self.projection.is_panorama

    @property
    def half_width(self) -> float:
        """Half the width of the image."""
        return float(self.projection.half_width(self.fov_deg))

    @property
    def reach(self) -> Float64Array:
        """Share (R,) by which a distortion of 1 moves points outwards; see `undistorted`."""
        square = (self.u**2 + self.v**2) / self.half_width**2
        return np.asarray(square - fixed_at(self.projection))

    @property
    def wander_ways(self) -> Float64Array:
        """`wander_ways` (R, 4) at the points of a panorama; none (R, 0) for a lens."""
        if not self.is_panorama:
            return np.zeros((len(self.u), 0))
        return wander_ways(self.u / self.half_width)

    def log_scale(self, fov_deg: Float64Array | float) -> Float64Array:
        """Return the logarithm of the scale that gives a field of view.

        The scale is the factor on u and v.
        """
        half_width = self.projection.half_width(fov_deg)
        return np.asarray(np.log(half_width) - np.log(self.half_width))

    def fov_at(self, log_scale: Float64Array) -> Float64Array:
        """Return fields of view, degrees, from logarithms of scales.

        The inverse of `log_scale`.
        """
        half_width = self.half_width * np.exp(log_scale)
        return np.asarray(self.projection.fov_deg(half_width))

    def scaled(self, scale: Any) -> tuple[Any, Any]:
        """Return u and v for half widths ``scale`` times as large.

        Their dtype is the dtype of ``scale``.
        """
        u, v = (ray.astype(scale.dtype) for ray in (self.u, self.v))
        if self.projection is Projection.EQUIRECTANGULAR:
            return u * scale, np.tan(np.arctan(v) * scale)
        return u * scale, v * scale

    def levelled(
        self, pitch: Float32Array, roll: Float32Array, log_scale: Float32Array, lift: Any
    ) -> tuple[Float32Array, Float32Array]:
        """Return azimuths and elevation tangents (M, R) at M attitudes.

        Each attitude has its own scale. ``pitch``, ``roll`` and ``log_scale`` are (M, 1), angles in
        radians; ``lift`` (M, R) is added to v. Azimuths of a lens are within a quarter turn of the
        axis, even for rays that look back.
        """
        u, v = self.scaled(np.exp(log_scale))
        right, up, forward = level_axes(u, v + lift, pitch, roll, self.projection)
        if self.projection.spreads_angles:
            return np.arctan2(right, forward), up / np.hypot(right, forward)
        forward = np.maximum(forward, _LEAST_FORWARD)
        return np.arctan(right / forward), up / np.hypot(right, forward)

    def levelled_with_changes(
        self,
        pitch_rad: Float64Array,
        roll_rad: Float64Array,
        log_scale: Float64Array,
        warp: Float64Array,
    ) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
        """Return directions at M attitudes, scales and warps (M, K), with derivatives.

        The warp is the distortion of a lens, K = 1, or none, K = 0; for a panorama, the factors of
        `wander_ways`, K = 4.

        Returns
        -------
        azimuth, elevation_tan : (M, R) float64
            As in `level`.
        azimuth_change, elevation_change : (M, R, 3 + K) float64
            Their derivatives by pitch and roll, radians, the logarithm of the scale, and warps.
        """
        scale = np.exp(log_scale)[:, np.newaxis]
        attitude = pitch_rad[:, np.newaxis], roll_rad[:, np.newaxis]
        warped = self._wandered_axes if self.is_panorama else self._distorted_axes
        (right, up, forward), changes = warped(scale, *attitude, warp)
        right_change, up_change, forward_change = changes
        flat = np.hypot(right, forward)
        right_, forward_, up_, flat_ = (a[..., np.newaxis] for a in (right, forward, up, flat))
        flat_change = (right_ * right_change + forward_ * forward_change) / flat_
        return (
            np.arctan2(right, forward),
            up / flat,
            (forward_ * right_change - right_ * forward_change) / flat_**2,
            (up_change - up_ * flat_change / flat_) / flat_,
        )

    def _wandered_axes(
        self, scale: Float64Array, pitch: Float64Array, roll: Float64Array, warp: Float64Array
    ) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
        """Return `panorama_with_changes` of these points, whose rows wander."""
        u, v = self.scaled(scale)
        ways = scale[..., np.newaxis] * self.wander_ways
        grown = v
        if self.projection is Projection.EQUIRECTANGULAR:
            grown = np.arctan(self.v) * scale * (1.0 + np.square(v))
        lift = (ways @ warp[..., np.newaxis])[..., 0]
        return panorama_with_changes(u, v + lift, grown + lift, ways, pitch, roll, self.projection)

    def _distorted_axes(
        self, scale: Float64Array, pitch: Float64Array, roll: Float64Array, warp: Float64Array
    ) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
        """Return `axes_with_changes` of these points, distorted by a lens."""
        u, v = self.scaled(scale)
        stretch: Any = 1.0
        share = np.zeros((*u.shape, 0))
        if warp.shape[1]:
            stretch = 1.0 + warp * self.reach
            share = (self.reach / stretch)[..., np.newaxis]
        axes, changes = axes_with_changes(u * stretch, v * stretch, pitch, roll, self.projection)
        # Distortion moves rays outwards like the scale, but the more the farther out they are.
        return axes, [np.concatenate([one, one[..., 2:] * share], axis=-1) for one in changes]

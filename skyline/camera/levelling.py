"""Rays of a pitched and rolled camera in a level frame, and back."""

from __future__ import annotations

from typing import Any

import numpy as np

from skyline.arrays import Float32Array, Float64Array
from skyline.camera.projection import Projection

_NO_ANGLE = 1e-12
"""Replaces the angle 0 off a fisheye's axis, by which nothing can be divided."""
_BACKMOST_RAD = np.radians(170.0)
"""Largest angle off a fisheye's axis that `project` follows: no lens shows what is behind it, and a
line that passes there would cross the whole picture."""


def level(
    u: Float64Array,
    v: Float64Array,
    pitch_deg: float,
    roll_deg: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return azimuths and elevation tangents of a camera's rays.

    Azimuths are radians clockwise from the vertical plane of the optical axis, in (-pi, pi]. The
    elevation tangent is up over horizontal distance. The pitch is the axis's angle above the
    horizon; the roll turns the camera clockwise as seen from behind it. u and v are as in
    `Projection.rays`.
    """
    attitude = np.radians(pitch_deg), np.radians(roll_deg)
    right, up, forward = level_axes(u, v, *attitude, projection)
    return np.arctan2(right, forward), up / np.hypot(right, forward)


def level_axes(
    u: Any, v: Any, pitch: Any, roll: Any, projection: Projection = Projection.PERSPECTIVE
) -> tuple[Any, Any, Any]:
    """Return rays as components of a level camera.

    The components are right, up and forward; angles are in radians. A panorama's camera turns about
    an upright axis, so its pitch raises the rows equally all the way round: tangents of a
    cylindrical photo, elevations of an equirectangular one.
    """
    if not projection.is_panorama:
        return _held(*_ray(u, v, projection), pitch, roll)
    raised, side = _raised(v, np.tan(pitch), projection)
    return _held(side * np.sin(u), side * raised, side * np.cos(u), 0.0, roll)


def _held(right: Any, up: Any, forward: Any, pitch: Any, roll: Any) -> tuple[Any, Any, Any]:
    """Return a pitched and rolled camera's ray in a level frame.

    Both the ray given, in the camera's own frame, and the result are right, up and forward.
    """
    unrolled = up * np.cos(roll) - right * np.sin(roll)
    return (
        right * np.cos(roll) + up * np.sin(roll),
        unrolled * np.cos(pitch) + forward * np.sin(pitch),
        forward * np.cos(pitch) - unrolled * np.sin(pitch),
    )


def _ray(u: Any, v: Any, projection: Projection) -> tuple[Any, Any, Any]:
    """Return the ray of a lens in its frame: right, up and forward."""
    if projection is Projection.PERSPECTIVE:
        return u, v, 1.0
    off_axis = np.hypot(u, v)
    share = np.sinc(off_axis / np.pi)
    return u * share, v * share, np.cos(off_axis)


def _ray_by_log_scale(u: Any, v: Any, projection: Projection) -> tuple[Any, Any, Any]:
    """Return the derivative of `_ray` by the logarithm of the scale."""
    if projection is Projection.PERSPECTIVE:
        return u, v, 0.0
    off_axis = np.hypot(u, v)
    return u * np.cos(off_axis), v * np.cos(off_axis), -off_axis * np.sin(off_axis)


def _raised(v: Any, tangent: Any, projection: Projection) -> tuple[Any, Any]:
    """Return v raised by a pitch, and the side it is on.

    ``tangent`` is the tangent of the pitch. The side is 1, or -1 where v is raised past the zenith.
    An equirectangular photo is raised by the angle.
    """
    if projection is not Projection.EQUIRECTANGULAR:
        return v + tangent, 1.0
    cosine = 1.0 - v * tangent
    return (v + tangent) / cosine, np.sign(cosine)


def project(
    azimuth_rad: Float64Array,
    y: Float64Array,
    pitch_deg: float,
    roll_deg: float,
    projection: Projection = Projection.PERSPECTIVE,
) -> tuple[Float64Array, Float64Array]:
    """Return u and v of directions; the inverse of `level`.

    NaN for directions that are not in front of a lens, that are right behind a fisheye, or that a
    pitch moves past the zenith.
    """
    pitch, roll = np.radians(pitch_deg), np.radians(roll_deg)
    level_right, level_forward = np.sin(azimuth_rad), np.cos(azimuth_rad)
    if projection.is_panorama:
        right = level_right * np.cos(roll) - y * np.sin(roll)
        up = level_right * np.sin(roll) + y * np.cos(roll)
        v, side = _raised(up / np.hypot(right, level_forward), -np.tan(pitch), projection)
        return np.arctan2(right, level_forward), np.where(side > 0.0, v, np.nan)
    forward = level_forward * np.cos(pitch) + y * np.sin(pitch)
    unpitched = y * np.cos(pitch) - level_forward * np.sin(pitch)
    right = level_right * np.cos(roll) - unpitched * np.sin(roll)
    up = level_right * np.sin(roll) + unpitched * np.cos(roll)
    if projection is Projection.FISHEYE:
        aside = np.hypot(right, up)
        off_axis = np.arctan2(aside, forward)
        stretch = np.where(off_axis < _BACKMOST_RAD, off_axis, np.nan) / np.fmax(aside, _NO_ANGLE)
        return right * stretch, up * stretch
    forward = np.where(forward > 0.0, forward, np.nan)
    return right / forward, up / forward


def axes_with_changes(
    u: Float64Array,
    v: Float64Array,
    pitch: Float64Array,
    roll: Float64Array,
    projection: Projection,
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a lens or a fisheye, with derivatives.

    The derivatives of each axis are (M, R, 3): by pitch, roll and log scale.
    """
    right, up, forward = axes = level_axes(u, v, pitch, roll, projection)
    own_right, own_up, _ = _ray(u, v, projection)
    unrolled = own_up * np.cos(roll) - own_right * np.sin(roll)
    scaled = _held(*_ray_by_log_scale(u, v, projection), pitch, roll)
    changes = [
        [np.zeros_like(up), unrolled, scaled[0]],
        [forward, -right * np.cos(pitch), scaled[1]],
        [-up, right * np.sin(pitch), scaled[2]],
    ]
    return axes, [np.stack(change, axis=-1) for change in changes]


def panorama_with_changes(
    u: Float64Array,
    v: Float64Array,
    v_change: Float64Array,
    ways: Float64Array,
    pitch: Float64Array,
    roll: Float64Array,
    projection: Projection,
) -> tuple[tuple[Any, Any, Any], list[Float64Array]]:
    """Return `level_axes` of a panorama, with derivatives.

    The derivatives of each axis are (M, R, 3 + K): by pitch, roll, log scale and warps.
    ``v_change`` (M, R) and ``ways`` (M, R, K) are the derivatives of v by log scale and warps.
    """
    raised, _ = _raised(v, np.tan(pitch), projection)
    if projection is Projection.EQUIRECTANGULAR:
        by_pitch = 1.0 + np.square(raised)
        by_v = by_pitch / (1.0 + np.square(v))
    else:
        by_pitch = np.ones_like(v) / np.square(np.cos(pitch))
        by_v = np.ones_like(v)
    # Pitch, scale and warps move a ray up the image; scale moves it across, too.
    lifts = [by_pitch, np.zeros_like(v), by_v * v_change]
    lifted = np.concatenate([np.stack(lifts, axis=-1), by_v[..., np.newaxis] * ways], axis=-1)
    right, up, forward = axes = level_axes(u, raised, 0.0, roll, projection)
    right_change, up_change = (
        lifted * turned[..., np.newaxis] for turned in (np.sin(roll), np.cos(roll))
    )
    forward_change = np.zeros_like(lifted)
    right_change[..., 1] = up
    up_change[..., 1] = -right
    right_change[..., 2] += u * forward * np.cos(roll)
    up_change[..., 2] -= u * forward * np.sin(roll)
    forward_change[..., 2] = -u * np.sin(u)
    return axes, [right_change, up_change, forward_change]


def near_level_changes(
    azimuth: Float32Array, elevation_tan: Float32Array, slope: Float32Array, projection: Projection
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Return how fast a nearly level camera's rays rise above a curve.

    The camera turns about its middle, so these are exact for a level camera that sees the horizon,
    and neglect products of the pitch, the roll and the elevations otherwise.

    Parameters
    ----------
    azimuth, elevation_tan : (M, R) float32
        Directions of the rays, the azimuths from the optical axis, radians.
    slope : (M, R) float32
        Slope of the curve, a tangent of elevation over a radian of azimuth.

    Returns
    -------
    by_pitch, by_roll, by_log_scale : (M, R) float32
        Tangents by a radian of pitch and of roll, and by the logarithm of the image's scale.
    """
    sine, cosine = np.sin(azimuth), np.cos(azimuth)
    if projection.is_panorama:
        return np.ones_like(elevation_tan), -sine, elevation_tan - slope * azimuth
    if projection is Projection.FISHEYE:
        by_log_scale = elevation_tan * cosine / np.sinc(azimuth / np.float32(np.pi))
        return cosine, -sine, by_log_scale - slope * azimuth
    by_log_scale = elevation_tan * np.square(cosine) - slope * sine * cosine
    return cosine, -sine, by_log_scale

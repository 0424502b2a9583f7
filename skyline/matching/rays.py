"""Query rays as a solver needs them: no more than useful, and levelled with derivatives."""

from dataclasses import dataclass, replace

import numpy as np

from skyline.arrays import Float64Array
from skyline.matching.query import QueryRays


@dataclass(frozen=True, slots=True, eq=False)
class LevelledRays:
    """R rays at each of M attitudes."""

    azimuth_rad: Float64Array
    """(M, R) float64. Clockwise from the vertical plane of the optical axis."""
    y: Float64Array
    """(M, R) float64. Tangent of the elevation angle: up over horizontal distance."""
    azimuth_change: Float64Array
    y_change: Float64Array
    """``azimuth_change``, ``y_change``: (M, R, 3 or 4) float64. Derivatives by pitch, by roll, both
    in radians, by the logarithm of the scale, and by the distortion of a lens that has one."""


def level_with_changes(
    query: QueryRays,
    pitch_rad: Float64Array,
    roll_rad: Float64Array,
    log_scale: Float64Array,
    distortion: Float64Array | None = None,
) -> LevelledRays:
    """Level a query's R rays at M attitudes, scales and distortions; as `query.level`."""
    axes = _panorama_axes if query.is_panorama else _lens_axes
    angles = (angle[:, np.newaxis] for angle in (pitch_rad, roll_rad))
    scale = np.exp(log_scale)[:, np.newaxis]
    stretch = 1.0 if distortion is None else 1.0 + distortion[:, np.newaxis] * query.reach
    (right, up, forward), (right_change, up_change, forward_change) = axes(
        query.u * scale * stretch, query.v * scale * stretch, *angles
    )
    if distortion is not None:
        # Like the scale, it moves rays outwards, but the more the farther out they are.
        share = (query.reach / stretch)[..., np.newaxis]
        right_change, up_change, forward_change = (
            np.concatenate([change, change[..., 2:] * share], axis=-1)
            for change in (right_change, up_change, forward_change)
        )
    flat = np.hypot(right, forward)
    right_, forward_, up_, flat_ = (a[..., np.newaxis] for a in (right, forward, up, flat))
    flat_change = (right_ * right_change + forward_ * forward_change) / flat_
    return LevelledRays(
        np.arctan2(right, forward),
        up / flat,
        (forward_ * right_change - right_ * forward_change) / flat_**2,
        (up_change - up_ * flat_change / flat_) / flat_,
    )


_Axes = tuple[Float64Array, Float64Array, Float64Array]
"""To the right, up and forward."""


def _lens_axes(
    u: Float64Array, v: Float64Array, pitch: Float64Array, roll: Float64Array
) -> tuple[_Axes, _Axes]:
    """Return rays (M, R) on the axes of a level camera, and (M, R, 3) how they change.

    As `LevelledRays`: by pitch, by roll, and by the logarithm of the scale.
    """
    cos_roll, sin_roll, cos_pitch, sin_pitch = _turns(pitch, roll)
    right = u * cos_roll + v * sin_roll
    above = v * cos_roll - u * sin_roll
    forward = cos_pitch - above * sin_pitch
    up = above * cos_pitch + sin_pitch
    return (right, up, forward), (
        np.stack([np.zeros_like(up), above, right], axis=-1),
        np.stack([forward, -right * cos_pitch, above * cos_pitch], axis=-1),
        np.stack([-up, right * sin_pitch, -above * sin_pitch], axis=-1),
    )


def _panorama_axes(
    u: Float64Array, v: Float64Array, pitch: Float64Array, roll: Float64Array
) -> tuple[_Axes, _Axes]:
    """Return the same of a panorama."""
    cos_roll, sin_roll, cos_pitch, sin_pitch = _turns(pitch, roll)
    across, forward = np.sin(u), np.cos(u)
    above = v + sin_pitch / cos_pitch
    right = across * cos_roll + above * sin_roll
    up = above * cos_roll - across * sin_roll
    raised, turned = np.ones_like(u) / cos_pitch**2, u * forward
    return (right, up, forward), (
        np.stack([raised * sin_roll, up, turned * cos_roll + v * sin_roll], axis=-1),
        np.stack([raised * cos_roll, -right, v * cos_roll - turned * sin_roll], axis=-1),
        np.stack([np.zeros_like(u), np.zeros_like(u), -u * across], axis=-1),
    )


def _turns(
    pitch: Float64Array, roll: Float64Array
) -> tuple[Float64Array, Float64Array, Float64Array, Float64Array]:
    return np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)


def thinned(query: QueryRays, bins: int) -> QueryRays:
    """Average rays that fall into one of ``bins`` steps of azimuth, as a level camera has them.

    Averages keep what many columns say together, at the cost of few: the terrain's curve is no
    finer than its bins. Rays come out from left to right; an average weighs as much as its rays
    do on average, so the noise of averages is what the weights refer to.
    """
    step = np.floor(query.azimuth_rad * (bins / (2.0 * np.pi))).astype(np.intp)
    step -= step.min()
    total = np.bincount(step, query.weight)
    kept = np.flatnonzero(total)
    return replace(
        query,
        u=np.bincount(step, query.weight * query.u)[kept] / total[kept],
        v=np.bincount(step, query.weight * query.v)[kept] / total[kept],
        weight=total[kept] / np.bincount(step)[kept],
    )

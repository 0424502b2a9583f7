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
    """``azimuth_change``, ``y_change``: (M, R, 3) float64. Derivatives by pitch, by roll, both in
    radians, and by the logarithm of the scale."""


def level_with_changes(
    u: Float64Array,
    v: Float64Array,
    pitch_rad: Float64Array,
    roll_rad: Float64Array,
    log_scale: Float64Array,
) -> LevelledRays:
    """Level R rays (u, v, 1) at M attitudes, u and v scaled; as `skyline.matching.query.level`.

    The scale is the tangent of half the assumed field of view over that which the rays were made
    with.
    """
    scale = np.exp(log_scale)[:, np.newaxis]
    cos_roll, sin_roll = np.cos(roll_rad)[:, np.newaxis], np.sin(roll_rad)[:, np.newaxis]
    cos_pitch, sin_pitch = np.cos(pitch_rad)[:, np.newaxis], np.sin(pitch_rad)[:, np.newaxis]
    right = scale * (u * cos_roll + v * sin_roll)
    above = scale * (v * cos_roll - u * sin_roll)
    forward = cos_pitch - above * sin_pitch
    up = above * cos_pitch + sin_pitch
    flat = np.hypot(right, forward)
    none = np.zeros_like(up)
    right_change = np.stack([none, above, right], axis=-1)
    forward_change = np.stack([-up, right * sin_pitch, -above * sin_pitch], axis=-1)
    up_change = np.stack([forward, -right * cos_pitch, above * cos_pitch], axis=-1)
    right_, forward_, up_, flat_ = (a[..., np.newaxis] for a in (right, forward, up, flat))
    flat_change = (right_ * right_change + forward_ * forward_change) / flat_
    return LevelledRays(
        np.arctan2(right, forward),
        up / flat,
        (forward_ * right_change - right_ * forward_change) / flat_**2,
        (up_change - up_ * flat_change / flat_) / flat_,
    )


def thinned(query: QueryRays, bins: int) -> QueryRays:
    """Average rays that fall into one of ``bins`` steps of azimuth, as a level camera has them.

    Averages keep what many columns say together, at the cost of few: the terrain's curve is no
    finer than its bins. Rays come out from left to right; an average weighs as much as its rays
    do on average, so the noise of averages is what the weights refer to.
    """
    step = np.floor(np.arctan(query.u) * (bins / (2.0 * np.pi))).astype(np.intp)
    step -= step.min()
    total = np.bincount(step, query.weight)
    kept = np.flatnonzero(total)
    return replace(
        query,
        u=np.bincount(step, query.weight * query.u)[kept] / total[kept],
        v=np.bincount(step, query.weight * query.v)[kept] / total[kept],
        weight=total[kept] / np.bincount(step)[kept],
    )

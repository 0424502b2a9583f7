"""Sky view factors: the share of the sky's light left by horizons."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array, refuse_text
from skyline.errors import InputError, numbers_of


def sky_view_factor(
    azimuth_deg: ArrayLike,
    elevation_deg: ArrayLike,
    tilt_deg: float = 0.0,
    facing_deg: float = 180.0,
) -> Float64Array:
    """Return how much of the sky's light reaches a surface.

    A factor is the light of the visible sky as a share of an unobstructed sky's. Source: Dozier and
    Frew, Rapid calculation of terrain parameters for radiation modeling from digital elevation
    data, IEEE Transactions on Geoscience and Remote Sensing 28 (1990), equation 7b: the mean over
    all azimuths a of cos S sin(H)^2 + sin S cos(a - A) (H - sin H cos H), where S and A are the
    surface's tilt and azimuth and H is the angle from the zenith down to the lower end of the sky:
    the horizon, or the surface's own plane where that is higher. A surface that overhangs hides the
    sky above its plane: the same term, of the angle down to the plane, is subtracted. The sky is
    assumed equally bright everywhere.

    Parameters
    ----------
    azimuth_deg : (A,) array_like
        Equal steps over a full turn.
    elevation_deg : (..., A) array_like
        Elevation of horizons; negative elevations count as 0.
    tilt_deg, facing_deg : float
        Tilt of the surface from the horizontal, 0 to 180, and the azimuth that it faces. For a
        level surface, the default, the factor is the mean of the squared cosine of the horizon's
        elevation; beyond 90 the surface overhangs, and at 180 it faces the ground.

    Returns
    -------
    (...) float64
        0 to 1; NaN if the horizon is unknown at some azimuth.

    Raises
    ------
    InputError
        The azimuths are not equal steps over a full turn, the elevations are more or fewer, the
        tilt is not from 0 to 180, or the azimuth that the surface faces is not a number.
    """
    refuse_text(azimuth_deg=azimuth_deg, elevation_deg=elevation_deg)
    azimuth, elevation = (np.asarray(a, dtype=np.float64) for a in (azimuth_deg, elevation_deg))
    even = np.arange(azimuth.size) * (360.0 / max(azimuth.size, 1))
    if azimuth.ndim != 1 or not np.allclose(
        wrapped_deg(azimuth - azimuth[:1] - even), 0.0, atol=1e-3
    ):
        raise InputError("azimuths are not equal steps, in degrees, over a full turn")
    if elevation.shape[-1:] != azimuth.shape:
        raise InputError(
            f"elevations have shape {elevation.shape}; expected (..., {azimuth.size}), one for "
            "each azimuth"
        )
    error = (
        f"tilt and azimuth are {tilt_deg!r} and {facing_deg!r}; expected degrees, a tilt from 0 "
        "(level) to 180 (facing the ground)"
    )
    tilt_deg, facing_deg = numbers_of((tilt_deg, facing_deg), 2, error)
    if not (0.0 <= tilt_deg <= 180.0 and math.isfinite(facing_deg)):
        raise InputError(error)
    tilt = np.radians(tilt_deg)
    away = np.cos(np.radians(azimuth - facing_deg))
    own_plane = np.arctan2(-np.sin(tilt) * away, np.cos(tilt))
    horizon = np.radians(elevation)
    # Angles from the zenith down to the lower and the upper end of the sky.
    low = 0.5 * np.pi - np.clip(np.maximum(horizon, own_plane), 0.0, 0.5 * np.pi)
    zenith = np.stack([low, np.clip(-0.5 * np.pi - own_plane, 0.0, low)])
    sine = np.sin(zenith)
    light = np.cos(tilt) * sine**2 + np.sin(tilt) * away * (zenith - sine * np.cos(zenith))
    return np.asarray((light[0] - light[1]).mean(axis=-1), dtype=np.float64)

"""The share of the sky that a surface sees over its horizon."""

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array


def sky_view_factor(
    azimuth_deg: ArrayLike,
    elevation_deg: ArrayLike,
    tilt_deg: float = 0.0,
    facing_deg: float = 180.0,
) -> Float64Array:
    """Return sky view factors: the sky's light on a surface, as a share of that of a free sky.

    Source: Dozier and Frew, Rapid calculation of terrain parameters for radiation modeling from
    digital elevation data, IEEE Transactions on Geoscience and Remote Sensing 28 (1990), equation
    7b: the mean over all azimuths a of cos S sin(H)^2 + sin S cos(a - A) (H - sin H cos H), where
    S and A are the surface's tilt and azimuth and H is the angle from the zenith down to what ends
    the sky: the horizon, or the surface's own plane where that is higher. The sky is equally bright
    everywhere.

    Parameters
    ----------
    azimuth_deg : (A,) array_like
        In equal steps all the way round.
    elevation_deg : (..., A) array_like
        Of horizons; what lies under the horizontal plane hides no sky.
    tilt_deg, facing_deg : float
        Of the surface, from the horizontal, and the azimuth it faces; level by default, where the
        factor is the mean of the cosine of the horizon's elevation, squared.

    Returns
    -------
    (...) float64
        0 to 1; NaN where the horizon is not known all the way round.
    """
    tilt = np.radians(tilt_deg)
    away = np.cos(np.radians(np.asarray(azimuth_deg, dtype=np.float64) - facing_deg))
    own_plane = np.arctan2(-np.sin(tilt) * away, np.cos(tilt))
    horizon = np.radians(np.asarray(elevation_deg, dtype=np.float64))
    zenith = 0.5 * np.pi - np.maximum(np.maximum(horizon, own_plane), 0.0)
    sine, cosine = np.sin(zenith), np.cos(zenith)
    light = np.cos(tilt) * sine**2 + np.sin(tilt) * away * (zenith - sine * cosine)
    return np.asarray(light.mean(axis=-1), dtype=np.float64)

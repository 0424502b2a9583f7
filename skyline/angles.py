"""Angles on a circle: turns of less than half of it."""

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array


def wrapped_deg(angle_deg: ArrayLike, about_deg: float = 0.0) -> Float64Array:
    """Return angles within half a turn of another, by default [-180, 180)."""
    least_deg = about_deg - 180.0
    return (np.asarray(angle_deg, dtype=np.float64) - least_deg) % 360.0 + least_deg


def angle_between_deg(one_deg: ArrayLike, other_deg: ArrayLike) -> Float64Array:
    """Return the angles between directions, 0 to 180 degrees."""
    return np.abs(wrapped_deg(np.subtract(one_deg, other_deg)))

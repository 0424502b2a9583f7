"""How the height errors of a terrain model are correlated."""

import numpy as np

from skyline.arrays import Float64Array

HEIGHT_REACH_M = 300.0
"""Distance at which the correlation of height errors has fallen to 1 / e."""


def height_correlation(distance_m: Float64Array) -> Float64Array:
    """Return the correlation of height errors at some distance."""
    # (1 + x) exp(-x) is 1 / e at this x.
    x = distance_m * (2.1461932206205825 / HEIGHT_REACH_M)
    return np.asarray((1.0 + x) * np.exp(-x))

"""What spacing costs: how likely a search loses a view where places lie so far apart.

A view that is taken between places differs from theirs by what its skyline moves, and that is the
spacing over the skyline's distance. The odds that a whole search, refinement included, then fails
grow with a power of that ratio. The power and the ratio of even odds were fitted to searches for
made views, 60 degrees wide; docs/method.md has the terrain, and how well the law holds elsewhere.
"""

import numpy as np

from skyline.arrays import Float32Array, Float64Array

_WINDOWS = 36
"""Views 60 degrees wide, each as likely as the others."""

_NEAREST_M = 1.0
_FARTHEST_M = 1e6
"""Of a skyline; directions without data count as far as this."""

_EVEN_ODDS = 0.72
"""Spacing over distance where half of the views are lost."""

_POWER = 1.55
"""Of that ratio, in the odds of a loss."""


def window_losses(distance_m: Float32Array, spacing_m: Float64Array) -> Float64Array:
    """Return how likely views round N places are lost where they lie S spacings apart, (N, S, 36).

    The views are 60 degrees wide and begin at 0, 10, 20, ... degrees. ``distance_m`` (N, B) is of
    the skylines all the way round; NaN where there is no data.
    """
    # The nearest stretches of a skyline move most, so the mean is one of nearness.
    nearness = 1.0 / np.clip(
        np.nan_to_num(distance_m.astype(np.float64), nan=_FARTHEST_M), _NEAREST_M, _FARTHEST_M
    )
    bins = distance_m.shape[1]
    width = bins // 6
    ahead = np.concatenate([nearness, nearness[:, :width]], axis=1)
    total = np.cumsum(np.pad(ahead, ((0, 0), (1, 0))), axis=1)
    starts = np.arange(_WINDOWS) * bins // _WINDOWS
    mean = (total[:, starts + width] - total[:, starts]) / width
    odds = (spacing_m[:, None] * mean[:, None, :] / _EVEN_ODDS) ** _POWER
    return np.asarray(odds / (1.0 + odds), dtype=np.float64)


def lost_shares(distance_m: Float32Array, spacing_m: Float64Array) -> Float64Array:
    """Return the share (N, S) of the views round places that is expected to be lost.

    As `window_losses`, over all directions.
    """
    return np.asarray(window_losses(distance_m, spacing_m).mean(axis=2), dtype=np.float64)

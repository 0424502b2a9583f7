"""The colours of heights on maps, low to high, and how dark a slope away from the light is."""

import numpy as np

from skyline.arrays import Float64Array

TINTS = ("#7fa87a", "#a9bd8b", "#d3c79b", "#c4a983", "#b59f8d", "#d9d5d1", "#ffffff")
DARKEST = 0.35
"""Of a slope away from the light, as a share of a level one."""


def tint_table(count: int) -> Float64Array:
    """Return as many colours, (count, 3) from 0 to 255, red, green and blue, lowest first."""
    stops = np.array([[int(tint[k : k + 2], 16) for k in (1, 3, 5)] for tint in TINTS])
    at = np.linspace(0.0, len(TINTS) - 1.0, count)
    return np.stack([np.interp(at, np.arange(len(TINTS)), stops[:, k]) for k in range(3)], axis=1)

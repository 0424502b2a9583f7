"""Shaded relief, tinted by height.

Light falls from the north-west.
"""

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from skyline.arrays import Float32Array, FloatArray, UInt8Array

_TINTS = ("#7fa87a", "#a9bd8b", "#d3c79b", "#c4a983", "#b59f8d", "#d9d5d1", "#ffffff")
"""Colours of heights, low to high."""
_RGB = 255.0 * LinearSegmentedColormap.from_list("heights", _TINTS)(np.arange(256))[:, :3]
"""Colours (256, 3) from the lowest height to the highest."""
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)], dtype=np.float32)
"""Direction to the light (east, north, up): from the north-west, halfway up."""


def relief(heights_m: Float32Array, pixel_m: float, range_m: tuple[float, float]) -> UInt8Array:
    """Return shaded relief as RGBA (H, W, 4) uint8.

    It is transparent where there is no height. ``heights_m`` (H + 2, W + 2) belong to the picture's
    pixels, ``pixel_m`` apart, and to one pixel beyond each side; rows run south. ``range_m`` has
    the heights of the lowest and the highest tint.
    """
    east = (heights_m[1:-1, 2:] - heights_m[1:-1, :-2]) / np.float32(2.0 * pixel_m)
    north = (heights_m[:-2, 1:-1] - heights_m[2:, 1:-1]) / np.float32(2.0 * pixel_m)
    up = 1.0 / np.sqrt(1.0 + east**2 + north**2)
    lit = (_LIGHT[2] - _LIGHT[0] * east - _LIGHT[1] * north) * up
    inner = heights_m[1:-1, 1:-1]
    low, high = range_m
    known = np.isfinite(inner)
    share = np.clip((np.where(known, inner, low) - low) / (high - low), 0.0, 1.0)
    tinted = _RGB[np.rint(share * (len(_RGB) - 1)).astype(np.uint8)]
    darkest = 0.35  # Brightness of a slope facing away from the light, 1 if it faces the light.
    shade = darkest + (1.0 - darkest) * np.clip(np.nan_to_num(lit, nan=0.7), 0.0, 1.0)
    picture = np.empty((*inner.shape, 4), dtype=np.uint8)
    picture[..., :3] = np.rint(tinted * shade[..., np.newaxis])
    picture[..., 3] = np.where(known, 255, 0)
    return picture


def tint_range_m(heights_m: FloatArray) -> tuple[float, float]:
    """Return the heights of the lowest and the highest tint of terrain.

    Half a percent of the heights lie below this range, and half a percent above.
    """
    low, high = np.nanpercentile(heights_m, [0.5, 99.5])
    return float(low), max(float(high), float(low) + 1.0)

"""The rendering camera of the paper's section 4.1: four ideal 90 degree pin-hole views.

World axes are X = east, Y = up, Z = north; camera axes are x = right, y = up, z = forward.
Both are left-handed, so every rotation here has determinant +1.
"""

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError

HEADINGS = (0, 1, 2, 3)
"""Grid north, east, south, west: grid azimuths ``90 * heading``, degrees."""

DEFAULT_WIDTH = 640
MAX_WIDTH = 16384


def check_width(width: int) -> int:
    """Return ``width`` if it is a usable number of columns, else raise `InputError`."""
    if not 2 <= width <= MAX_WIDTH:
        raise InputError(
            f"width is {width} columns; expected 2 to {MAX_WIDTH} (the paper uses {DEFAULT_WIDTH})"
        )
    return width


def columns_u(width: int) -> Float64Array:
    """Return the image-plane abscissa u of each column centre, shape (width,), in (-1, 1)."""
    return (2.0 * np.arange(width) + 1.0) / width - 1.0


def pixel_size(width: int) -> float:
    """Return the size of one pixel in units of u or v: 1 px = 2 / width."""
    return 2.0 / width


def rotation(heading: int) -> Float64Array:
    """Return R_heading (3, 3): world (east, up, north) to camera (right, up, forward)."""
    # Quarter turns have exact sines; np.sin(pi) would leave 1e-16 behind.
    sine = (0.0, 1.0, 0.0, -1.0)[heading]
    cosine = (1.0, 0.0, -1.0, 0.0)[heading]
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


def elevation_deg(elevation_tan: Float64Array, u: Float64Array) -> Float64Array:
    """Return elevation angles in degrees of image-plane ordinates v at abscissas u."""
    return np.degrees(np.arctan(elevation_tan * np.cos(np.arctan(u))))

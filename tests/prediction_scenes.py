"""Views of made-up skylines, without any terrain."""

import numpy as np

from skyline.camera import columns_u
from skyline.skylines import Views

WIDTH = 320
U = columns_u(WIDTH)


def views_of(tan, depth_m, heading=0, east=0.0, north=0.0, eye=0.0):
    """Make views (N, W) of skylines; eyes and headings broadcast to the rows."""
    tan, depth_m = np.broadcast_arrays(np.atleast_2d(tan), np.atleast_2d(depth_m))
    row = np.zeros(len(tan))
    return Views(
        row + east,
        row + north,
        row + eye,
        np.broadcast_to(np.asarray(heading, dtype=np.uint8), len(tan)),
        tan.astype(np.float32),
        depth_m.astype(np.float32),
        np.zeros(tan.shape, dtype=np.uint8),
    )


def mountains(u, seed=0, height=0.1):
    """Return a smooth skyline over abscissas u, in units of the image plane."""
    generator = np.random.default_rng(seed)
    waves = generator.uniform(2.0, 9.0, 5)
    phases = generator.uniform(0.0, 6.0, 5)
    return height * (1.5 + np.sin(np.multiply.outer(u, waves) + phases).sum(axis=-1) / 3.0)

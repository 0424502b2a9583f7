"""Views of made-up skylines, without any terrain."""

import numpy as np

from skyline.camera import columns_u
from skyline.views import Shells, Views

WIDTH = 320
U = columns_u(WIDTH)


def views_of(tan, depth_m, heading=0, east=0.0, north=0.0, eye=0.0, shells=None):
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
        shells,
    )


def layered(ridges, heading=0, width=WIDTH):
    """Make one view of (elevation_tan (W,), depth_m) ridges, each a shell of its own."""
    tan = np.stack([np.broadcast_to(tan, width) for tan, _ in ridges]).astype(np.float32)
    depth = np.stack([np.broadcast_to(depth, width) for _, depth in ridges]).astype(np.float32)
    edges = np.array([0.0, *(1.1 * depth.max(axis=1))])
    highest = tan.argmax(axis=0)
    column = np.arange(width)
    return views_of(
        tan[highest, column],
        depth[highest, column],
        heading,
        shells=Shells(edges, tan[np.newaxis], depth[np.newaxis]),
    )


def mountains(u, seed=0, height=0.1):
    """Return a smooth skyline over abscissas u, in units of the image plane."""
    generator = np.random.default_rng(seed)
    waves = generator.uniform(2.0, 9.0, 5)
    phases = generator.uniform(0.0, 6.0, 5)
    return height * (1.5 + np.sin(np.multiply.outer(u, waves) + phases).sum(axis=-1) / 3.0)

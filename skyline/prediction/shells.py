"""Which distance shells are worth keeping."""

import numpy as np

from skyline.errors import InputError

_NEAREST_EDGE_M = 60.0
_FAR_M = 45_000.0
_ALL_TERRAIN_M = 1_000_000.0


def shell_edges_m(count: int) -> tuple[float, ...]:
    """Return the edges of some shells, narrow near the eye, where moving changes most.

    The first begins at the eye; the next edges are a geometric series of forward depth, 60 m to
    45 km, but for the last, so that the last shell holds all that is farther.

    Parameters
    ----------
    count : int
        Shells, at least 2.

    Raises
    ------
    InputError
    """
    if count < 2:
        raise InputError(f"{count} distance shells; expected at least 2, or none at all")
    edges = np.geomspace(_NEAREST_EDGE_M, _FAR_M, count)[:-1]
    return (0.0, *edges.tolist(), _ALL_TERRAIN_M)

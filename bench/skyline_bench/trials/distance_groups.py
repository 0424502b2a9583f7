"""Queries in three groups by how far their skyline is, as the paper's Table 2 has them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.errors import InputError

CLOSE, MEDIUM, FAR, ALL = "close", "medium", "far", "all"
_NAMES = (CLOSE, MEDIUM, FAR)


@dataclass(frozen=True, slots=True)
class DistanceGroup:
    """Queries whose skylines are about as far off."""

    name: str  # ``close``, ``medium``, ``far`` or ``all``
    queries: tuple[int, ...]  # Their numbers, increasing
    # Least and greatest median distance of their skylines; NaN where none is known.
    from_m: float
    to_m: float


def distance_groups(distance_m: ArrayLike) -> tuple[DistanceGroup, ...]:
    """Split queries (N) at the terciles of their skylines' distance; all of them come last.

    Groups differ by at most one query. A query without any skyline in its image, of distance NaN,
    is among the close: what fills its image stands right before it.
    """
    distance = np.asarray(distance_m, dtype=np.float64)
    if len(distance) < len(_NAMES):
        raise InputError(
            f"the number of queries is {len(distance)}; expected at least {len(_NAMES)}, one for "
            "each group of distances"
        )
    order = np.argsort(np.where(np.isnan(distance), -np.inf, distance), kind="stable")
    parts = np.array_split(order, len(_NAMES))
    return tuple(
        _group(name, np.sort(members), distance)
        for name, members in zip((*_NAMES, ALL), (*parts, order), strict=True)
    )


def _group(name: str, members: NDArray[np.intp], distance: NDArray[np.float64]) -> DistanceGroup:
    known = distance[members][~np.isnan(distance[members])]
    low, high = (float(known.min()), float(known.max())) if known.size else (np.nan, np.nan)
    return DistanceGroup(name, tuple(members.tolist()), low, high)

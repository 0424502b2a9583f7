"""What a comparison of stores comes to: which costs buy the accuracy of the finest uniform one.

Everything is taken from the rows of the group of all queries.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skyline_bench.measuring.record import Row
from skyline_bench.trials.distance_groups import ALL
from skyline_bench.trials.matchers import PAPER, WHAT

UNIFORM = "uniform"
COSTS = ("renderings", "bytes")
"""Keys of a row that say what a store costs."""
_LEAST_M = 1e-3
"""Errors below have no logarithm worth speaking of."""


@dataclass(frozen=True, slots=True)
class Store:
    """A store as one matcher uses it."""

    name: str
    planner: str
    matcher: str
    renderings: int
    size_bytes: int
    # Errors over all queries.
    mean_m: float
    median_m: float

    def cost(self, key: str) -> float:
        """Return one of the `COSTS`."""
        return float(self.renderings if key == "renderings" else self.size_bytes)


def stores_of(rows: Iterable[Row]) -> list[Store]:
    """Return what the rows of all queries say, in their order."""
    return [
        Store(
            str(row["store"]),
            str(row["planner"]),
            str(row["matcher"]),
            int(str(row["renderings"])),
            int(str(row["bytes"])),
            float(str(row["mean_m"])),
            float(str(row["median_m"])),
        )
        for row in rows
        if row["group"] == ALL
    ]


def reached_rows(rows: Iterable[Row]) -> list[dict[str, object]]:
    """Return what it takes adaptive stores to be as accurate as the finest uniform one.

    Returns
    -------
    list of dict
        A row for each goal (that store with the same matcher, and with the paper's), planner and
        cost. ``store`` is the cheapest measured store whose mean error is no worse than the
        goal's, ``needed`` its cost and ``share`` that cost over the goal's; None where none is as
        good. ``interpolated`` is the cost at which a line between that store and the next cheaper
        one, on logarithmic axes, comes to the goal's error; None without such a pair.
    """
    stores = stores_of(rows)
    planners = list(dict.fromkeys(one.planner for one in stores if one.planner != UNIFORM))
    return [
        _reached(stores, goal, planner, matcher, cost)
        for matcher in WHAT
        if any(one.matcher == matcher for one in stores)
        for goal in _goals(stores, matcher)
        for planner in planners
        for cost in COSTS
    ]


def equal_rows(rows: Iterable[Row]) -> list[dict[str, object]]:
    """Return each adaptive store's errors beside those of uniform ones of as many renderings.

    Returns
    -------
    list of dict
        ``uniform_mean_m`` is interpolated between the uniform stores on logarithmic axes, and
        ``gain`` is it over the store's own mean error; None outside their range.
    """
    stores = stores_of(rows)
    told: list[dict[str, object]] = []
    for store in stores:
        if store.planner == UNIFORM:
            continue
        uniform_m = _uniform_mean_m(stores, store)
        told.append(
            {
                "store": store.name,
                "matcher": store.matcher,
                "renderings": store.renderings,
                "mean_m": store.mean_m,
                "median_m": store.median_m,
                "uniform_mean_m": uniform_m,
                "gain": None if uniform_m is None else uniform_m / max(store.mean_m, _LEAST_M),
            }
        )
    return told


def _reached(
    stores: Sequence[Store], goal: Store, planner: str, matcher: str, cost: str
) -> dict[str, object]:
    mine = sorted(
        (one for one in stores if (one.planner, one.matcher) == (planner, matcher)),
        key=lambda one: one.cost(cost),
    )
    at = next((i for i, one in enumerate(mine) if one.mean_m <= goal.mean_m), None)
    found = None if at is None else mine[at]
    needed = None if found is None else found.cost(cost)
    return {
        "goal": f"{goal.matcher} on {goal.name}",
        "goal_mean_m": goal.mean_m,
        "cost": cost,
        "goal_cost": goal.cost(cost),
        "matcher": matcher,
        "planner": planner,
        "store": None if found is None else found.name,
        "mean_m": None if found is None else found.mean_m,
        "needed": needed,
        "share": None if needed is None else needed / goal.cost(cost),
        "interpolated": _between(mine[at - 1], mine[at], goal.mean_m, cost) if at else None,
    }


def _goals(stores: Sequence[Store], matcher: str) -> list[Store]:
    """Return the finest uniform store with a matcher, and with the paper's."""
    goals = []
    for name in dict.fromkeys((matcher, PAPER)):
        grid = [one for one in stores if (one.planner, one.matcher) == (UNIFORM, name)]
        goals += [max(grid, key=lambda one: one.renderings)] if grid else []
    return goals


def _uniform_mean_m(stores: Sequence[Store], store: Store) -> float | None:
    """Return the mean error that uniform stores would have with a store's renderings."""
    grid = sorted(
        (one.renderings, max(one.mean_m, _LEAST_M))
        for one in stores
        if (one.planner, one.matcher) == (UNIFORM, store.matcher)
    )
    if not grid or not grid[0][0] <= store.renderings <= grid[-1][0]:
        return None
    renderings, mean_m = np.log(np.array(grid)).T
    return float(np.exp(np.interp(np.log(store.renderings), renderings, mean_m)))


def _between(worse: Store, better: Store, mean_m: float, cost: str) -> float:
    low, high = np.log([worse.cost(cost), better.cost(cost)])
    far, near, goal = np.log(np.maximum([worse.mean_m, better.mean_m, mean_m], _LEAST_M))
    return float(np.exp(low + (far - goal) / (far - near) * (high - low)))

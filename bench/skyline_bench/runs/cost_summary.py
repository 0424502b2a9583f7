"""What a comparison of stores comes to: which costs buy the accuracy of the finest uniform one.

Everything is taken from the rows of the group of all queries.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from skyline_bench.measuring.record import Row
from skyline_bench.trials.trials import ALL, PAPER, WHAT

UNIFORM = "uniform"
COSTS = ("renderings", "bytes")
"""Keys of a row that say what a store costs."""
_LEAST_M = 1e-3
"""Errors below have no logarithm worth speaking of."""


def reached_rows(rows: Iterable[Row]) -> list[Row]:
    """Return what it takes adaptive stores to be as accurate as the finest uniform one.

    There is a row for each goal (that store with the same matcher, and with the paper's), planner
    and cost. ``store`` is the cheapest measured store whose mean error is no worse than the goal's,
    ``needed`` its cost and ``share`` that cost over the goal's; None where none is as good.
    ``interpolated`` is the cost at which a line between that store and the next cheaper one, on
    logarithmic axes, comes to the goal's error; None without such a pair.
    """
    stores = [row for row in rows if row["group"] == ALL]
    planners = list(dict.fromkeys(one["planner"] for one in stores if one["planner"] != UNIFORM))
    return [
        _reached(_of(stores, planner, matcher), grid[-1], matcher, planner, cost)
        for matcher in WHAT
        if any(one["matcher"] == matcher for one in stores)
        for grid in (_of(stores, UNIFORM, goal) for goal in dict.fromkeys((matcher, PAPER)))
        if grid
        for planner in planners
        for cost in COSTS
    ]


def equal_rows(rows: Iterable[Row]) -> list[Row]:
    """Return each adaptive store's errors beside those of uniform ones of as many renderings.

    ``uniform_mean_m`` is interpolated between the uniform stores on logarithmic axes, and ``gain``
    is it over the store's own mean error; None outside their range.
    """
    stores = [row for row in rows if row["group"] == ALL]
    told: list[Row] = []
    for store in stores:
        if store["planner"] == UNIFORM:
            continue
        uniform_m = _uniform_mean_m(_of(stores, UNIFORM, store["matcher"]), store["renderings"])
        gain = None if uniform_m is None else uniform_m / max(store["mean_m"], _LEAST_M)
        names = ("store", "matcher", "renderings", "mean_m", "median_m")
        own = {name: store[name] for name in names}
        told.append({**own, "uniform_mean_m": uniform_m, "gain": gain})
    return told


def _of(stores: Sequence[Row], planner: str, matcher: str) -> list[Row]:
    """Return the stores of one planner as one matcher uses them, by their renderings."""
    mine = [one for one in stores if (one["planner"], one["matcher"]) == (planner, matcher)]
    return sorted(mine, key=lambda one: float(one["renderings"]))


def _reached(stores: list[Row], goal: Row, matcher: str, planner: str, cost: str) -> Row:
    stores = sorted(stores, key=lambda one: float(one[cost]))
    at = next((i for i, one in enumerate(stores) if one["mean_m"] <= goal["mean_m"]), None)
    found: Row = {} if at is None else stores[at]
    needed = found.get(cost)
    return {
        "goal": f"{goal['matcher']} on {goal['store']}",
        "goal_mean_m": goal["mean_m"],
        "cost": cost,
        "goal_cost": goal[cost],
        "matcher": matcher,
        "planner": planner,
        "store": found.get("store"),
        "mean_m": found.get("mean_m"),
        "needed": needed,
        "share": None if needed is None else needed / goal[cost],
        "interpolated": _between(stores[at - 1], found, goal["mean_m"], cost) if at else None,
    }


def _uniform_mean_m(grids: Sequence[Row], renderings: int) -> float | None:
    """Return the mean error that uniform stores would have with so many renderings."""
    if not grids or not grids[0]["renderings"] <= renderings <= grids[-1]["renderings"]:
        return None
    mean_m = np.log([max(one["mean_m"], _LEAST_M) for one in grids])
    return float(
        np.exp(np.interp(np.log(renderings), np.log([one["renderings"] for one in grids]), mean_m))
    )


def _between(worse: Row, better: Row, mean_m: float, cost: str) -> float:
    low, high = np.log([worse[cost], better[cost]])
    far, near, goal = np.log(np.maximum([worse["mean_m"], better["mean_m"], mean_m], _LEAST_M))
    return float(np.exp(low + (far - goal) / (far - near) * (high - low)))

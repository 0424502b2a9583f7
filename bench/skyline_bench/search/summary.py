"""Figures of trials: shares with Wilson's intervals, errors, and the savings of adaptive stores."""

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.stats import binomtest

from skyline_bench.measuring.record import Row
from skyline_bench.search.specs import UNIFORM
from skyline_bench.search.trials import STAGES, Trial

ALL = "all"
THIRDS = ("close", "medium", "far")
CLASSES = {"< 150 m": (0.0, 150.0), "150-400 m": (150.0, 400.0), "> 400 m": (400.0, math.inf)}
"""Distances of skylines, harmonic means in metres: how much a skyline moves with the eye."""

_RIGHT_M, _ROUGHLY_M = 200.0, 1000.0
_RESAMPLES = 2000
_LEAST_M = 1e-3
"""Smaller errors count as this, so that they have a logarithm."""


def groups(distance_m: Sequence[float], by_thirds: bool) -> Mapping[str, Sequence[int]]:
    """Return the numbers of queries by the distance of their skylines; all of them come last.

    Queries are split at 150 and 400 m, or into thirds of equal size, as in the paper.
    """
    every = list(range(len(distance_m)))
    if not by_thirds:
        members: dict[str, Sequence[int]] = {
            name: [index for index in every if low <= distance_m[index] < high]
            for name, (low, high) in CLASSES.items()
        }
        return {name: some for name, some in members.items() if some} | {ALL: every}
    order = np.argsort(distance_m, kind="stable")
    parts = zip(THIRDS, np.array_split(order, len(THIRDS)), strict=True)
    return {name: sorted(part.tolist()) for name, part in parts} | {ALL: every}


def summarize(trials: Sequence[Trial], miss_m: float, seed: int) -> Row:
    """Return the figures of trials; a query without a candidate is wrong by ``miss_m``.

    The interval of the mean is a percentile bootstrap over the queries. One seed draws the same
    queries for every row, so that rows can be compared.
    """
    found = np.array([trial.error_m for trial in trials])
    error_m = np.where(np.isfinite(found), found, miss_m)
    within_m = np.array([trial.within_m for trial in trials], dtype=np.float64)
    right, answered = found <= _RIGHT_M, np.isfinite(within_m)
    share = binomtest(int(right.sum()), len(trials)).proportion_ci(0.95, "wilson")
    draws = np.random.default_rng(seed).integers(0, len(trials), (_RESAMPLES, len(trials)))
    mean_low, mean_high = np.percentile(error_m[draws].mean(axis=1), (2.5, 97.5))
    turn_deg = np.array([trial.heading_error_deg for trial in trials])[right]
    distance_m = [trial.distance_m for trial in trials]
    radius_m = np.array([trial.radius_m for trial in trials], dtype=np.float64)
    sized = right & np.isfinite(radius_m)
    row: dict[str, object] = {
        "n": len(trials),
        "from_m": min(distance_m),
        "to_m": max(distance_m),
        "within_200m": float(right.mean()),
        "within_200m_low": float(share.low),
        "within_200m_high": float(share.high),
        "within_1km": float((found <= _ROUGHLY_M).mean()),
        "median_m": float(np.median(error_m)),
        "mean_m": float(error_m.mean()),
        "mean_m_low": float(mean_low),
        "mean_m_high": float(mean_high),
        "p90_m": float(np.percentile(error_m, 90.0)),
        "heading_median_deg": float(np.median(turn_deg)) if right.any() else None,
        "answered": float(answered.mean()),
        "answered_200m": float((within_m <= _RIGHT_M).mean()),
        "precision": float((found <= within_m)[answered].mean()) if answered.any() else None,
        "radius_holds": float((found <= radius_m)[sized].mean()) if sized.any() else None,
        "highest_confidence": max((trial.confidence or 0.0 for trial in trials), default=0.0),
        "named": float(np.mean([trial.named for trial in trials])),
        "query_s": float(np.median([trial.seconds for trial in trials])),
        "query_cpu_s": float(np.mean([trial.cpu_s for trial in trials])),
    }
    for stage in STAGES:
        known = [getattr(trial, stage) for trial in trials if getattr(trial, stage) is not None]
        if known:
            row[stage] = float(np.mean(known))
    screened_s = [trial.screen_s for trial in trials if trial.screen_s is not None]
    if screened_s:
        row["screen_s"] = float(np.median(screened_s))
    return row


def against_uniform(rows: Iterable[Row]) -> list[Row]:
    """Hold each adaptive store to the uniform ones that the same matcher searches.

    ``uniform_mean_m`` is the mean error that a uniform store of as many renderings would have, and
    ``gain`` is that over the store's own; ``uniform_renderings`` is how many renderings a uniform
    store would take to be as accurate, and ``share`` the store's own over those. They are
    interpolated between the uniform stores on logarithmic axes, and None outside their range.
    """
    stores = [row for row in rows if row["group"] == ALL]
    held: list[Row] = []
    for store in stores:
        if store["planner"] == UNIFORM:
            continue
        key = store["matcher"], store["queries"]
        grids = [
            row
            for row in stores
            if row["planner"] == UNIFORM and (row["matcher"], row["queries"]) == key
        ]
        grids.sort(key=lambda row: float(row["renderings"]))
        renderings = [float(row["renderings"]) for row in grids]
        mean_m = [max(float(row["mean_m"]), _LEAST_M) for row in grids]
        own_m = max(float(store["mean_m"]), _LEAST_M)
        uniform_m = interpolated(renderings, mean_m, float(store["renderings"]))
        # Errors of finer grids are less; where noise has it otherwise, the least so far counts.
        falling = np.minimum.accumulate(mean_m).tolist() if mean_m else []
        as_good = interpolated(falling[::-1], renderings[::-1], own_m)
        names = ("store", "matcher", "queries", "renderings", "mean_m")
        held.append(
            {name: store[name] for name in names}
            | {
                "uniform_mean_m": uniform_m,
                "gain": None if uniform_m is None else uniform_m / own_m,
                "uniform_renderings": as_good,
                "share": None if as_good is None else store["renderings"] / as_good,
            }
        )
    return held


def interpolated(x: Sequence[float], y: Sequence[float], at: float) -> float | None:
    """Return y at a place between increasing x, on logarithmic axes; None outside their range."""
    if not x or not x[0] <= at <= x[-1]:
        return None
    return float(np.exp(np.interp(np.log(at), np.log(x), np.log(y))))

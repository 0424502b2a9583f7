"""Trials: matchers run on synthetic queries, how wrong their answers are, and their summary."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.match_config import MatchConfig
from skyline.matching.ranking import Candidate
from skyline.pipeline.match import Matcher
from skyline.pipeline.matchers import FULL, MATCHERS
from skyline.pipeline.results import MatchResult
from skyline.store.format import RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, Truth

PAPER, CORRELATION, RETRIEVED = "paper", "correlation", "retrieved"
MATCHING = MatchConfig(fov_slack=QueryConfig().fov_slack)
"""The field of view of synthetic queries is known to 5 %."""

WHAT: Mapping[str, str] = MappingProxyType(
    {
        PAPER: "the paper's: keypoints, Chamfer, RANSAC",
        CORRELATION: "skylines slid along renderings",
        RETRIEVED: "ours, among places, not refined",
        FULL: "ours, among places, refined by rendering",
    }
)
"""Matchers by name, and what they are."""


def searched_by(name: str) -> str:
    """Return what a store must hold for a matcher to search it: places or renderings."""
    return MATCHERS[FULL if name == RETRIEVED else name].searches


def open_matcher(name: str, store: Path, terrain: HeightField) -> Matcher:
    """Open a store for a matcher; raises as `Matcher`."""
    if searched_by(name) == RENDERINGS:
        return Matcher(store, terrain, name, MATCHING)
    return Matcher(store, terrain, FULL, replace(MATCHING, refine=name == FULL))


_RESAMPLES = 2000
_INTERVAL = (2.5, 97.5)
"""Percentiles of the bootstrap that bound an interval of 95 %."""


@dataclass(frozen=True, slots=True)
class Trial:
    """What one matcher made of one query; errors and radius are of its best candidate."""

    distance_m: float  # Median distance of the query's skyline
    error_m: float  # Distance from the truth; without a candidate, what a miss is set to
    heading_error_deg: float  # 0 to 180; NaN without a candidate
    radius_m: float | None
    # How near the matcher says it is, 200 m if it does not say; None where it does not stand by it.
    answered_within_m: float | None
    seconds: float

    @property
    def right(self) -> bool:
        """Whether there is a candidate, and it is within 200 m."""
        return self.error_m <= RIGHT_WITHIN_M and not math.isnan(self.heading_error_deg)


def run_trials(
    matcher: Matcher, queries: Sequence[SyntheticQuery], miss_m: float, top: int
) -> Iterator[Trial]:
    """Yield a trial of each query; a query without any candidate is wrong by ``miss_m``."""
    for query in queries:
        started = time.perf_counter()
        try:
            result: MatchResult | None = matcher.match(query.skyline, top=top)
        except InputError:
            # Too little of the skyline is in the image: a refusal, and no answer.
            result = None
        yield trial_of(query, result, time.perf_counter() - started, miss_m)


def trial_of(
    query: SyntheticQuery, result: MatchResult | None, seconds: float, miss_m: float
) -> Trial:
    """Return what a result, None for a refusal, makes of a query."""
    best = result.candidates[0] if result and result.candidates else None
    answered = result is not None and result.answer is not None
    return Trial(
        query.distance_m,
        *((miss_m, np.nan) if best is None else errors(best, query.truth)),
        None if best is None else best.radius_m,
        result.within_m or RIGHT_WITHIN_M if result and answered else None,
        seconds,
    )


def errors(candidate: Candidate, truth: Truth) -> tuple[float, float]:
    """Return a candidate's distance from the truth, metres, and its turn from it, 0 to 180 deg."""
    turn = (candidate.grid_heading_deg - truth.heading_deg + 180.0) % 360.0 - 180.0
    return float(truth.off_m(candidate.easting_m, candidate.northing_m)), abs(turn)


def accuracy(
    errors_m: Sequence[float] | Float64Array, within_m: Sequence[float | None]
) -> dict[str, object]:
    """Return how often errors (N,) are small, and how often what is answered (N,) is true."""
    error_m, said_m = np.asarray(errors_m), np.array(within_m, dtype=np.float64)
    answered = np.isfinite(said_m)
    return {
        "n": len(error_m),
        "within_200m": float((error_m <= RIGHT_WITHIN_M).mean()),
        "median_m": float(np.median(error_m)),
        "answered": float(answered.mean()),
        "answered_200m": float((said_m <= RIGHT_WITHIN_M).mean()),
        "precision": float((error_m <= said_m)[answered].mean()) if answered.any() else None,
    }


def summarize(trials: Sequence[Trial], seed: int) -> dict[str, object]:
    """Return the figures of one table row.

    Intervals are percentile bootstraps over the queries. One seed draws the same queries for
    every row, so that rows can be compared.
    """
    error_m = np.array([trial.error_m for trial in trials])
    right = np.array([trial.right for trial in trials])
    turn_deg = np.array([trial.heading_error_deg for trial in trials])[right]
    row = accuracy(error_m, [trial.answered_within_m for trial in trials])
    draws = np.random.default_rng(seed).integers(0, len(trials), (_RESAMPLES, len(trials)))
    for name, values, statistic in (
        ("within_200m", right, np.mean),
        ("mean_m", error_m, np.mean),
        ("median_m", error_m, np.median),
    ):
        low, high = np.percentile(statistic(values[draws], axis=1), _INTERVAL)
        row |= {name: float(statistic(values)), f"{name}_low": low, f"{name}_high": high}
    return {
        **row,
        "p90_m": float(np.percentile(error_m, 90.0)),
        "heading_median_deg": float(np.median(turn_deg)) if right.any() else None,
        "query_ms": 1e3 * float(np.median([trial.seconds for trial in trials])),
    }


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

"""Trials: one matcher's answers to synthetic queries, how wrong they are, and their summary."""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from skyline.errors import InputError
from skyline.matching import Candidate
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.photo import QuerySkyline
from skyline.pipeline.results import MatchResult
from skyline_bench.queries.synthetic import SyntheticQuery, Truth

_RESAMPLES = 2000
_INTERVAL = (2.5, 97.5)
"""Percentiles of the bootstrap that bound an interval of 95 %."""


class QueryMatcher(Protocol):
    """Anything that finds query skylines on the map."""

    def match(self, query: QuerySkyline, fov_deg: float | None = None, top: int = 5) -> MatchResult:
        """Return what was found, best first."""
        ...


@dataclass(frozen=True, slots=True)
class Trial:
    """What one matcher made of one query.

    Attributes
    ----------
    query : int
        The query's number.
    truth : Truth
    distance_m : float
        Median distance of the query's skyline.
    candidates : tuple of Candidate
        Best first; empty where the matcher found nothing or refused the query.
    answered_within_m : float or None
        How near the matcher says the best of them is, 200 m if it does not say; None where it does
        not stand by it.
    error_m : float
        Distance of the best candidate from the truth; without any, what a miss is set to.
    heading_error_deg : float
        Of the best candidate, 0 to 180; NaN without any.
    seconds : float
    """

    query: int
    truth: Truth
    distance_m: float
    candidates: tuple[Candidate, ...]
    answered_within_m: float | None
    error_m: float
    heading_error_deg: float
    seconds: float

    @property
    def right(self) -> bool:
        """Whether there is a best candidate, and it is within 200 m."""
        return bool(self.candidates) and self.error_m <= RIGHT_WITHIN_M


def run_trials(
    matcher: QueryMatcher, queries: Sequence[SyntheticQuery], miss_m: float, top: int
) -> Iterator[Trial]:
    """Yield a trial of each query; a query without any candidate is wrong by ``miss_m``."""
    for index, query in enumerate(queries):
        started = time.perf_counter()
        try:
            result: MatchResult | None = matcher.match(query.skyline, top=top)
        except InputError:
            # Too little of the skyline is in the image: a refusal, and no answer.
            result = None
        yield trial_of(index, query, result, time.perf_counter() - started, miss_m)


def trial_of(
    index: int, query: SyntheticQuery, result: MatchResult | None, seconds: float, miss_m: float
) -> Trial:
    """Return what a result, None for a refusal, makes of the query of that number."""
    candidates = result.candidates if result else ()
    error_m, turn_deg = miss_m, np.nan
    if candidates:
        error_m, turn_deg = errors(candidates[0], query.truth)
    return Trial(
        index,
        query.truth,
        query.distance_m,
        candidates,
        None if result is None or result.answer is None else result.within_m or RIGHT_WITHIN_M,
        error_m,
        turn_deg,
        seconds,
    )


def errors(candidate: Candidate, truth: Truth) -> tuple[float, float]:
    """Return a candidate's distance from the truth, metres, and its turn from it, 0 to 180 deg."""
    east, north = (
        candidate.easting_m - truth.easting_m,
        candidate.northing_m - truth.northing_m,
    )
    turn = (candidate.grid_heading_deg - truth.heading_deg + 180.0) % 360.0 - 180.0
    return float(np.hypot(east, north)), abs(turn)


def summarize(trials: Sequence[Trial], seed: int) -> dict[str, object]:
    """Return the figures of one table row; see `runs.matching.measure`.

    Intervals are percentile bootstraps over the queries. One seed draws the same queries for
    every row, so that rows can be compared.
    """
    error_m = np.array([trial.error_m for trial in trials])
    right = np.array([trial.right for trial in trials])
    within_m = np.array([trial.answered_within_m for trial in trials], dtype=np.float64)
    answered = np.isfinite(within_m)
    turn_deg = np.array([trial.heading_error_deg for trial in trials])[right]
    draws = np.random.default_rng(seed).integers(0, len(trials), (_RESAMPLES, len(trials)))
    within = np.percentile(right[draws].mean(axis=1), _INTERVAL)
    mean = np.percentile(error_m[draws].mean(axis=1), _INTERVAL)
    median = np.percentile(np.median(error_m[draws], axis=1), _INTERVAL)
    return {
        "n": len(trials),
        "within_200m": float(right.mean()),
        "within_200m_low": float(within[0]),
        "within_200m_high": float(within[1]),
        "mean_m": float(error_m.mean()),
        "mean_m_low": float(mean[0]),
        "mean_m_high": float(mean[1]),
        "median_m": float(np.median(error_m)),
        "median_m_low": float(median[0]),
        "median_m_high": float(median[1]),
        "p90_m": float(np.percentile(error_m, 90.0)),
        "heading_median_deg": float(np.median(turn_deg)) if right.any() else None,
        "answered": float(answered.mean()),
        "answered_200m": float((within_m <= RIGHT_WITHIN_M).mean()),
        "precision": float((error_m <= within_m)[answered].mean()) if answered.any() else None,
        "query_ms": 1e3 * float(np.median([trial.seconds for trial in trials])),
    }

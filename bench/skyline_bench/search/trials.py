"""Trials of matchers, and their figures.

In a trial, a matcher searches a store for a query; the error of a trial is the best candidate's.
Shares have Wilson's intervals. Adaptive stores are compared with uniform ones.
"""

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import binomtest

from skyline import JointResult, Matcher, MatchResult, Narrowing
from skyline.angles import angle_between_deg
from skyline.errors import InputError
from skyline.match.config import MatchConfig
from skyline.match.matcher import FULL
from skyline.match.posterior import SHARES, Posterior
from skyline.pose.pose import RIGHT_WITHIN_M, ROUGHLY_WITHIN_M
from skyline.pose.poses import Poses
from skyline.store.layout import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring import Row, timed
from skyline_bench.queries.kinds import Query, distance_m
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, Truth
from skyline_bench.search.stages import STAGES, stage_of_loss
from skyline_bench.search.stores import UNIFORM, are_as_many

PAPER = "paper"
"""The paper's matcher."""
UNREFINED = "unrefined"
"""The full matcher without its refinement."""
MATCHERS = (PAPER, "correlation", UNREFINED, FULL)
"""All matchers."""

MATCHING = MatchConfig(fov_sd_share=QueryConfig().fov_sd_share)
"""The field of view of synthetic queries is known to 5 %."""


def searched_by(matcher: str) -> str:
    """Return the kind of rows, places or renderings, that a matcher searches."""
    return PLACES if matcher in {FULL, UNREFINED} else RENDERINGS


@dataclass(frozen=True, slots=True)
class Trial:
    """A query, and the best candidate that was found for it."""

    distance_m: float  # Distance of the skyline; see `skyline_bench.queries.kinds.distance_m`
    error_m: float = math.inf  # Distance from the truth; infinite without a candidate
    heading_error_deg: float = math.nan  # 0 to 180; NaN without a candidate
    confidence: float | None = None
    radius_m: float | None = None  # Radius within which 68 % of the errors should be
    within_m: float | None = None  # How near the matcher answers; None without an answer
    # How much better the true pose of a lost query fits than the best candidate; else None.
    truth_ahead: float | None = None
    lost_in: str | None = None  # Which of `skyline_bench.search.stages.STAGES` lost it, if one did
    # Whether a photo is named as taken elsewhere; with a stranger, whether the stranger is named.
    named: bool = False
    # Share of the posterior in more probable cells than the true one's, and how much more probable
    # the true cell is than if all were alike; None where no posterior was asked for.
    share: float | None = None
    gain_bits: float | None = None
    seconds: float = 0.0
    cpu_s: float = 0.0


def open_matcher(name: str, store: Path, terrain: HeightField) -> Matcher:
    """Open a store for a matcher of `MATCHERS`; raises as `Matcher`."""
    config = replace(MATCHING, refine=name != UNREFINED)
    return Matcher(store, terrain, FULL if name == UNREFINED else name, config)


def tried(
    matcher: Matcher,
    store: Path,
    query: Query,
    narrowing: Narrowing | None,
    *,
    strange: bool,
    with_posterior: bool = False,
) -> Trial:
    """Match a query to a store; a query that is refused has no candidate."""

    def match() -> MatchResult | JointResult | None:
        with suppress(InputError):  # No place lies within the narrowing.
            if len(query) > 1:
                return matcher.match_together([one.skyline for one in query], top=5)
            return matcher.match(query[0].skyline, top=5, narrowing=narrowing)
        return None

    result, timing = timed(match)
    trial = trial_of(query, result, strange)
    ahead = lost_in = None
    if not strange and trial.error_m > RIGHT_WITHIN_M and isinstance(result, MatchResult):
        ahead = _truth_ahead(matcher, query[0], result)
    if ahead is not None and ahead > _AHEAD:
        lost_in = stage_of_loss(matcher, store, query[0], narrowing)
    if with_posterior and result is not None:
        with suppress(InputError):  # The photo shows no skyline at all.
            trial = _with_posterior(trial, matcher.posterior(result), query[0].truth)
    return replace(
        trial,
        truth_ahead=ahead,
        lost_in=lost_in,
        seconds=timing.seconds,
        cpu_s=timing.cpu_seconds,
    )


def _with_posterior(trial: Trial, posterior: Posterior, truth: Truth) -> Trial:
    """Return a trial with the figures of a posterior."""
    place = {"easting_m": truth.easting_m, "northing_m": truth.northing_m}
    cell = posterior.probability_at(**place) * posterior.probability.size
    gain_bits = math.log2(max(cell, _LEAST_SHARE))
    return replace(trial, share=posterior.share_at(**place), gain_bits=gain_bits)


def _truth_ahead(matcher: Matcher, query: SyntheticQuery, result: MatchResult) -> float | None:
    """Return how much less the true pose costs than the best candidate.

    The true pose is refined. Returns None where either pose is missing: without refinement, or
    where nothing fits.
    """
    truth = query.truth
    fov_deg = query.skyline.fov_deg or query.truth.fov_deg
    true = Poses(
        easting_m=np.array([truth.easting_m]),
        northing_m=np.array([truth.northing_m]),
        eye_elevation_m=np.array([truth.eye_elevation_m]),
        grid_heading_deg=np.array([truth.grid_heading_deg]),
        pitch_deg=np.array([truth.pitch_deg]),
        roll_deg=np.array([truth.roll_deg]),
        fov_deg=np.array([fov_deg]),
        cost=np.zeros(1),
    )
    with suppress(InputError):  # The matcher does not refine.
        start = true.on_map(matcher.frame)[0]
        fitted = matcher.fit(query.skyline, start).candidates
        if fitted and result.candidates:
            return result.candidates[0].cost - fitted[0].cost
    return None


def trial_of(
    query: Query, result: MatchResult | JointResult | None, strange: bool = False
) -> Trial:
    """Return the trial of a result, None for a refusal.

    Nothing is right for a stranger.
    """
    if result is None or not result.candidates:
        return Trial(distance_m(query))
    best = result.candidates[0]
    truth = query[0].truth
    named = False
    turn_deg = float(angle_between_deg(best.grid_heading_deg, truth.grid_heading_deg))
    if isinstance(result, JointResult):
        has_stranger = query[-1].truth.easting_m != query[0].truth.easting_m
        named = not (result.agrees[-1] if has_stranger else all(result.agrees))
    return Trial(
        distance_m(query),
        math.inf if strange else float(truth.off_m(best.easting_m, best.northing_m)),
        math.nan if strange else turn_deg,
        best.confidence,
        best.radius_m,
        result.within_m,
        named=named,
    )


# --- figures of trials ----------------------------------------------------------------------


ALL = "all"
THIRDS = ("close", "medium", "far")
CLASSES = {"< 150 m": (0.0, 150.0), "150-400 m": (150.0, 400.0), "> 400 m": (400.0, math.inf)}
"""Distances of skylines, harmonic means in metres: how much a skyline moves with the eye."""

_AHEAD = 3.0
"""Difference of scores from which a pose fits clearly better."""
_SAME = "matcher", "queries", "search"
"""Columns that are equal in rows of stores that are searched alike."""
_LEAST_M = 1e-3
"""A smaller mean error counts as this."""
_LEAST_SHARE = 1e-9
"""Cells that are less probable than this share of the mean cell count as this."""


def groups(distance_m: Sequence[float], by_thirds: bool) -> Mapping[str, Sequence[int]]:
    """Return the numbers of queries by the distance of their skylines.

    The group of all queries comes last. Queries are split at 150 and 400 m, or into thirds of equal
    size, as in the paper.
    """
    away_m = np.array(distance_m)
    if by_thirds:
        parts = np.array_split(np.argsort(away_m, kind="stable"), len(THIRDS))
        members = {name: sorted(part.tolist()) for name, part in zip(THIRDS, parts, strict=True)}
    else:
        members = {
            name: np.flatnonzero((low <= away_m) & (away_m < high)).tolist()
            for name, (low, high) in CLASSES.items()
        }
    return {name: some for name, some in members.items() if some} | {ALL: list(range(len(away_m)))}


def summarize(trials: Sequence[Trial], miss_m: float, seed: int) -> Row:
    """Return the figures of trials.

    A query without a candidate is wrong by ``miss_m``. Queries over 200 m off are lost by the
    search if the true pose fits clearly better than the best candidate, and lost to likeness if the
    best candidate fits as well or better. ``lost_in`` counts the former by the stage that lost
    them.

    The interval of the mean is a percentile bootstrap over the queries. One seed draws the same
    queries for every row, so that rows can be compared.
    """
    found = np.array([trial.error_m for trial in trials])
    error_m = np.where(np.isfinite(found), found, miss_m)
    within_m = np.array([trial.within_m for trial in trials], dtype=np.float64)
    right = found <= RIGHT_WITHIN_M
    answered = np.isfinite(within_m)
    share = binomtest(int(right.sum()), len(trials)).proportion_ci(0.95, "wilson")
    draws = np.random.default_rng(seed).integers(0, len(trials), (2000, len(trials)))
    mean_low, mean_high = np.percentile(error_m[draws].mean(axis=1), (2.5, 97.5))
    turn_deg = np.array([trial.heading_error_deg for trial in trials])[right]
    distance_m = [trial.distance_m for trial in trials]
    radius_m = np.array([trial.radius_m for trial in trials], dtype=np.float64)
    sized = right & np.isfinite(radius_m)
    ahead = np.array([trial.truth_ahead for trial in trials], dtype=np.float64)
    lost = Counter(trial.lost_in for trial in trials)
    return {
        "n": len(trials),
        "from_m": min(distance_m),
        "to_m": max(distance_m),
        "within_200m": float(right.mean()),
        "within_200m_low": float(share.low),
        "within_200m_high": float(share.high),
        "each_within_200m": "".join("1" if one else "0" for one in right),
        "within_1km": float((found <= ROUGHLY_WITHIN_M).mean()),
        "median_m": float(np.median(error_m)),
        "mean_m": float(error_m.mean()),
        "mean_m_low": float(mean_low),
        "mean_m_high": float(mean_high),
        "p90_m": float(np.percentile(error_m, 90.0)),
        "heading_median_deg": float(np.median(turn_deg)) if right.any() else None,
        "answered": float(answered.mean()),
        "answered_200m": float((within_m <= RIGHT_WITHIN_M).mean()),
        "precision": float((found <= within_m)[answered].mean()) if answered.any() else None,
        "radius_holds": float((found <= radius_m)[sized].mean()) if sized.any() else None,
        "highest_confidence": max((trial.confidence or 0.0 for trial in trials), default=0.0),
        "lost_by_search": float((ahead > _AHEAD).mean()),
        "lost_in": {stage: count for stage in STAGES if (count := lost[stage])},
        "lost_to_likeness": float((ahead <= _AHEAD).mean()),
        **_held(trials),
        "named": float(np.mean([trial.named for trial in trials])),
        "query_s": float(np.median([trial.seconds for trial in trials])),
        "query_cpu_s": float(np.mean([trial.cpu_s for trial in trials])),
    }


def _held(trials: Sequence[Trial]) -> Row:
    """Return how often posteriors' regions hold the true place, if any."""
    share = np.array([one.share for one in trials if one.share is not None])
    gain = [one.gain_bits for one in trials if one.gain_bits is not None]
    if not len(share):
        return {}
    held = {f"in_{100 * one:.0f}": float((share < one).mean()) for one in SHARES}
    return {"posteriors": len(share), **held, "gain_bits": float(np.mean(gain))}


def _searched_alike(row: Row, other: Row) -> bool:
    """Return whether one matcher searched two stores for the same queries, in the same areas."""
    return all(row[name] == other[name] for name in _SAME)


def by_planner(rows: Iterable[Row]) -> tuple[list[Row], list[Row]]:
    """Return the uniform and the adaptive stores of a record.

    They are in order of their renderings.
    """
    every = sorted((row for row in rows if row["group"] == ALL), key=lambda row: row["renderings"])
    uniform = [row for row in every if row["planner"] == UNIFORM]
    return uniform, [row for row in every if row["planner"] != UNIFORM]


def as_large(plan: Row, rows: Iterable[Row]) -> Row | None:
    """Return the uniform store with a planned one's number of places, searched alike.

    It is the nearest in number; None where there is none.
    """
    places = plan["renderings"]
    equal = [
        row
        for row in by_planner(rows)[0]
        if _searched_alike(row, plan) and are_as_many(places, row["renderings"])
    ]
    return min(equal, key=lambda row: abs(row["renderings"] - places), default=None)


def against_equal(rows: Sequence[Row]) -> list[Row]:
    """Compare each adaptive store with the uniform one of as many places, where there is one.

    ``gain_points`` is how many points more of the queries the adaptive store finds, with its 95 %
    interval, ``half_points`` to either side. ``error_ratio`` is its mean error over the grid's.
    """
    held: list[Row] = []
    for plan in by_planner(rows)[1]:
        grid = as_large(plan, rows)
        if grid is not None:
            gain, half = gain_points(plan, grid)
            about = {name: plan[name] for name in ("store", *_SAME, "km2", "n")}
            held.append(
                {
                    **about,
                    "uniform": grid["store"],
                    "gain_points": gain,
                    "half_points": half,
                    "error_ratio": plan["mean_m"] / max(grid["mean_m"], _LEAST_M),
                }
            )
    return held


def gain_points(plan: Row, grid: Row) -> tuple[float, float]:
    """Return a plan's gain in points, and its 95 % half width.

    Both searched the same queries, so only queries that one of them finds alone count.
    """
    gains = np.array([int(one) for one in plan["each_within_200m"]])
    gains -= np.array([int(one) for one in grid["each_within_200m"]])
    return 100.0 * float(gains.mean()), 196.0 * float(gains.std()) / math.sqrt(len(gains))

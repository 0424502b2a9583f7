"""Trials: the error of a matcher that searches a store for a query."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from skyline import Candidate, JointResult, Matcher, MatchResult, Narrowing
from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.geodesy import Rectangle, in_turn
from skyline.match.candidate import Hypotheses
from skyline.match.confidence import MatchConfig
from skyline.match.full import FullMatcher
from skyline.match.matcher import FULL
from skyline.store import open_store
from skyline.store.format import PLACES, RENDERINGS
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.kinds import Query, distance_m
from skyline_bench.queries.synthetic import QueryConfig, Truth

PAPER, CORRELATION, RETRIEVED = "paper", "correlation", "retrieved"
MATCHERS = (PAPER, CORRELATION, RETRIEVED, FULL)
"""The matchers of Skyline, and ``retrieved``, the full one without its refinement."""

STAGES = ("screened", "retrieved", "refined")
"""Stages of the full matcher: the places most alike, the short list of poses, the candidates."""

MATCHING = MatchConfig(fov_slack=QueryConfig().fov_slack)
"""The field of view of synthetic queries is known to 5 %."""
_TOP = 5
_TURN_DEG = 10.0
_SAMPLE = 100_000
"""Number of places from which the median spacing is taken."""


def searched_by(matcher: str) -> str:
    """Return the kind of rows, places or renderings, that a matcher searches."""
    return PLACES if matcher in {FULL, RETRIEVED} else RENDERINGS


@dataclass(frozen=True, slots=True)
class Area:
    """A square or a circle that holds a query's place anywhere, or everything."""

    name: str
    km2: float
    side_m: float | None = None
    radius_m: float | None = None

    def about(
        self, truth: Truth, area_m: Rectangle, terrain: HeightField, seed: int
    ) -> Narrowing | None:
        """Return the area about a place, squares within the whole area; None for everything."""
        place = np.array([truth.easting_m, truth.northing_m])
        entropy = [seed, round(1e6 * self.km2), *np.abs(place).astype(int).tolist()]
        generator = np.random.default_rng(entropy)
        if self.side_m is not None:
            low, high = np.array(area_m).reshape(2, 2)
            side_m = np.minimum(self.side_m, high - low)
            corner = generator.uniform(
                np.maximum(low, place - side_m), np.minimum(high - side_m, place)
            )
            lon, lat = terrain.frame.to_lonlat(*np.stack([corner, corner + side_m], axis=1))
            return Narrowing(
                bounds_deg=(float(lon[0]), float(lat[0]), float(lon[1]), float(lat[1]))
            )
        if self.radius_m is not None:
            off_m = self.radius_m * math.sqrt(generator.uniform())
            turn = generator.uniform(0.0, 2.0 * np.pi)
            lon, lat = terrain.frame.to_lonlat(
                place[0] + off_m * math.sin(turn), place[1] + off_m * math.cos(turn)
            )
            return Narrowing(near=(float(lon), float(lat), self.radius_m / 1000.0))
        return None


@dataclass(frozen=True, slots=True)
class Trial:
    """A query, and the best candidate that was found for it."""

    distance_m: float  # Of the query's skyline; see `skyline_bench.queries.kinds.distance_m`
    error_m: float = math.inf  # From the truth; infinite without a candidate
    heading_error_deg: float = math.nan  # 0 to 180; NaN without a candidate
    confidence: float | None = None
    radius_m: float | None = None  # That 68 % of the errors should be within
    within_m: float | None = None  # How near the matcher answers; None without an answer
    # Whether a photo is named as not of the others' place; with a stranger, whether that is named.
    named: bool = False
    seconds: float = 0.0
    cpu_s: float = 0.0
    screen_s: float | None = None  # Of the seconds, those of screening
    # Whether a place within one spacing of the truth was there after each of the `STAGES`; since
    # retrieval, looking within 10 degrees of the right way. None where stages are not known.
    screened: bool | None = None
    retrieved: bool | None = None
    refined: bool | None = None


class Searcher:
    """A matcher on a store; of the full matcher the stages are followed."""

    def __init__(self, matcher: Matcher, store: Path, follows: bool) -> None:
        self._matcher = matcher
        self._follows = follows
        self._retrieved: Hypotheses | None = None
        if follows:
            with open_store(store) as opened:
                self._places = opened.places()
            step = max(1, len(self._places) // _SAMPLE)
            some = self._places.take(np.arange(0, len(self._places), step, dtype=np.intp))
            self._spacing_m = 2.0 * float(np.median(some.tolerance_m))
            ranker = matcher._ranker
            assert isinstance(ranker, FullMatcher)
            retrieve = ranker.retrieve

            def noting(*arguments: Any, **named: Any) -> Hypotheses:
                self._retrieved = retrieve(*arguments, **named)
                return self._retrieved

            ranker.retrieve = noting  # type: ignore[method-assign]

    def trial(self, query: Query, narrowing: Narrowing | None = None, *, strange: bool) -> Trial:
        """Match a query; a query that is refused has no candidate."""
        first = query[0].skyline
        wall, cpu, screened, screen_s = time.perf_counter(), time.process_time(), None, None
        result: MatchResult | JointResult | None = None
        try:
            if len(query) > 1:
                result = self._matcher.match_together([one.skyline for one in query], top=_TOP)
            else:
                if self._follows:
                    self._retrieved = None
                    screened = self._matcher.screen(first, narrowing)
                    screen_s = time.perf_counter() - wall
                result = self._matcher.match(
                    first, top=_TOP, narrowing=narrowing, screened=screened
                )
        except InputError:  # No place lies within the narrowing.
            result = None
        taken = time.perf_counter() - wall, time.process_time() - cpu
        trial = replace(
            trial_of(query, result, strange), seconds=taken[0], cpu_s=taken[1], screen_s=screen_s
        )
        if not self._follows or len(query) > 1 or strange:
            return trial
        truth, found = query[0].truth, self._retrieved
        candidates = [] if result is None else _places_of(result)
        east_m, north_m, heading_deg = (
            np.array([getattr(one, name) for one in candidates])
            for name in ("easting_m", "northing_m", "grid_heading_deg")
        )
        return replace(
            trial,
            screened=screened is not None and self._near(screened.row, truth),
            retrieved=found is not None
            and self._is_there(found.easting_m, found.northing_m, found.heading_deg, truth),
            refined=self._is_there(east_m, north_m, heading_deg, truth),
        )

    def _near(self, rows: np.ndarray, truth: Truth) -> bool:
        places = self._places.take(rows)
        off_m = truth.off_m(places.easting_m, places.northing_m)
        return bool((off_m <= self._spacing_m).any())

    def _is_there(
        self,
        easting_m: Float64Array,
        northing_m: Float64Array,
        heading_deg: Float64Array,
        truth: Truth,
    ) -> bool:
        near = truth.off_m(easting_m, northing_m) <= self._spacing_m
        return bool((near & (_turn_deg(heading_deg, truth) <= _TURN_DEG)).any())


@contextmanager
def open_searcher(name: str, store: Path, terrain: HeightField) -> Iterator[Searcher]:
    """Open a store for a matcher of `MATCHERS`; raises as `Matcher`."""
    if searched_by(name) == RENDERINGS:
        with Matcher(store, terrain, name, MATCHING) as matcher:
            yield Searcher(matcher, store, follows=False)
        return
    config = replace(MATCHING, refine=name == FULL)
    with Matcher(store, terrain, FULL, config) as matcher:
        yield Searcher(matcher, store, follows=True)


def trial_of(
    query: Query, result: MatchResult | JointResult | None, strange: bool = False
) -> Trial:
    """Return the trial of a result, None for a refusal; nothing is right for a stranger."""
    trial = Trial(distance_m(query))
    best = next(iter(_places_of(result)), None) if result is not None else None
    if result is None or best is None:
        return trial
    error_m, turn_deg = (math.inf, math.nan) if strange else errors(best, query[0].truth)
    named = False
    if isinstance(result, JointResult):
        has_stranger = query[-1].truth.easting_m != query[0].truth.easting_m
        named = not (result.agrees[-1] if has_stranger else all(result.agrees))
    answered = result.answer is not None
    return replace(
        trial,
        error_m=error_m,
        heading_error_deg=turn_deg,
        confidence=best.confidence,
        radius_m=best.radius_m,
        within_m=result.within_m or 200.0 if answered else None,
        named=named,
    )


def errors(candidate: Candidate, truth: Truth) -> tuple[float, float]:
    """Return a candidate's distance from the truth, metres, and its turn from it, 0 to 180 deg."""
    turn_deg = _turn_deg(np.array(candidate.grid_heading_deg), truth)
    return float(truth.off_m(candidate.easting_m, candidate.northing_m)), float(turn_deg)


def _turn_deg(heading_deg: Float64Array, truth: Truth) -> Float64Array:
    return np.abs(in_turn(heading_deg - truth.heading_deg))


def _places_of(result: MatchResult | JointResult) -> Sequence[Candidate]:
    return result.candidates if isinstance(result, MatchResult) else result.places

"""Accuracy against time: how long a short list, how deep a refinement, and what that buys.

The store holds places, and queries are drawn over its own area. Seconds are processor time a
query, which other work on the machine hardly changes.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np

from skyline import MatchConfig
from skyline.errors import InputError
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.full import FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.match_config import FullConfig
from skyline.matching.refine_config import RefineConfig
from skyline.matching.retrieval import RetrievalConfig, Retriever
from skyline.pipeline import Progress
from skyline.pipeline.config import mapped_area_m, read_dem_of
from skyline.pipeline.scene import RenderedScene
from skyline.planning.uniform import map_bounds
from skyline.store import open_store
from skyline_bench.queries.synthetic import QueryConfig, SyntheticQuery, Truth, make_queries

T = TypeVar("T")

FULL = FullConfig()
FITTED = (500, 2000, 8192)
"""Places whose pose is fitted well in retrieval; the last before every refinement."""
SHORTLISTS = (4, 16, 64, 400)
"""Retrieved poses that a refinement starts from."""
UNREFINED = "none"
DEPTHS = {
    "least": (
        RefineConfig(
            particles=4, rounds=2, keep_least=2, restarts=0, finalists=3, final_rounds=1, rivals=1
        ),
        -math.inf,
    ),
    "quick": (FULL.quick, -math.inf),
    "thorough where unsure (the default)": (FULL.quick, FULL.sure_margin),
    "thorough": (FULL.quick, math.inf),
}
"""How a query is refined at first, and with what margin that stands."""


class Setting(NamedTuple):
    """What a point of the plot was measured with."""

    refinement: str
    fitted: int
    shortlist: int


class Outcome(NamedTuple):
    """What became of a query: how far off it was found, and what that took."""

    error_m: float
    cpu_s: float


class _Bench:
    """Matches a query in every setting.

    Parameters
    ----------
    retrievers : dict of int to Retriever
        By how many places they fit well.
    scene : RenderedScene
    miss_m : float
        The error of a query that nothing fits, or without a skyline.
    """

    def __init__(
        self, retrievers: dict[int, Retriever], scene: RenderedScene, miss_m: float
    ) -> None:
        self._retrieval = {
            fitted: FullMatcher(retriever) for fitted, retriever in retrievers.items()
        }
        self._refinement = {
            (name, shortlist): FullMatcher(retrievers[FITTED[-1]], scene, _full(name, shortlist))
            for name in DEPTHS
            for shortlist in SHORTLISTS
        }
        self._miss_m = miss_m

    def outcomes(self, query: SyntheticQuery) -> Iterator[tuple[Setting, Outcome]]:
        """Yield what became of a query in every setting."""
        try:
            rays = query.rays()
        except InputError:  # No skyline is left to be seen.
            settings = [Setting(UNREFINED, fitted, FULL.shortlist) for fitted in self._retrieval]
            settings += [Setting(name, FITTED[-1], count) for name, count in self._refinement]
            yield from ((setting, Outcome(self._miss_m, 0.0)) for setting in settings)
            return
        for fitted, matcher in self._retrieval.items():
            found, retrieval_s = _timed(partial(matcher.retrieve, rays))
            error_m = self._error_m(found, query.truth)
            yield Setting(UNREFINED, fitted, FULL.shortlist), Outcome(error_m, retrieval_s)
        # What was found last, by the retrieval that fits most, is refined.
        for (name, shortlist), matcher in self._refinement.items():
            best = found[np.arange(min(shortlist, len(found)))]
            poses, refinement_s = _timed(partial(matcher.refine, best, rays))
            error_m = self._error_m(poses.hypotheses if poses else best, query.truth)
            yield (
                Setting(name, FITTED[-1], shortlist),
                Outcome(error_m, retrieval_s + refinement_s),
            )

    def _error_m(self, found: Hypotheses, truth: Truth) -> float:
        if not len(found):
            return self._miss_m
        best = int(np.argmin(found.score))
        east_m = found.easting_m[best] - truth.easting_m
        north_m = found.northing_m[best] - truth.northing_m
        return float(np.hypot(east_m, north_m))


def _full(name: str, shortlist: int) -> FullConfig:
    first, sure_margin = DEPTHS[name]
    first, then = (
        replace(config, shortlist=min(config.shortlist, shortlist))
        for config in (first, FULL.refine)
    )
    return replace(FULL, quick=first, sure_margin=sure_margin, refine=then)


def _timed(work: Callable[[], T]) -> tuple[T, float]:
    started = time.process_time()
    done = work()
    return done, time.process_time() - started


def _summary(setting: Setting, outcomes: Sequence[Outcome]) -> dict[str, object]:
    """Return a row of the table."""
    error_m, cpu_s = np.array(outcomes).T
    return setting._asdict() | {
        "n": len(outcomes),
        "within_200m": float((error_m <= RIGHT_WITHIN_M).mean()),
        "median_m": float(np.median(error_m)),
        "mean_m": float(error_m.mean()),
        "cpu_ms": float(1000.0 * cpu_s.mean()),
        "cpu_ms_p90": float(1000.0 * np.percentile(cpu_s, 90.0)),
    }


def measure(
    path: Path, dem: Sequence[str], queries: int, seed: int, progress: Progress | None = None
) -> list[dict[str, object]]:
    """Match synthetic queries to a store of places in every setting; return a row a setting."""
    with open_store(path) as store:
        terrain = read_dem_of(store.header, dem)
        west, south, east, north = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        places, scene = store.places(), RenderedScene.of_store(terrain, store.header, MatchConfig())
    retrievers = {
        fitted: Retriever(places, terrain.height_at, RetrievalConfig(fitted=fitted))
        for fitted in FITTED
    }
    bench = _Bench(retrievers, scene, 0.5 * math.hypot(east - west, north - south))
    made = make_queries(terrain, (west, south, east, north), queries, seed, QueryConfig())
    deque(bench.outcomes(made[0]), maxlen=0)  # The first compiles shaders.
    told: dict[Setting, list[Outcome]] = {}
    for number, query in enumerate(made, start=1):
        for setting, outcome in bench.outcomes(query):
            told.setdefault(setting, []).append(outcome)
        if progress:
            progress(number, len(made))
    scene.release()
    return [_summary(setting, outcomes) for setting, outcomes in told.items()]

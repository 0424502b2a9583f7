"""Accuracy against time: how long a short list, how deep a refinement, and what that buys.

Run as ``python bench/accuracy_time.py STORE.h5 DEM...``; writes accuracy_time.json and .png to
bench/results. The store holds places, and queries are drawn over its own area. Seconds are
processor time a query, which other work on the machine hardly changes.
"""

import argparse
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from skyline import MatchConfig
from skyline.console import progress_bar
from skyline.errors import InputError
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.full import FullConfig, FullMatcher
from skyline.matching.hypotheses import Hypotheses
from skyline.matching.refine_config import RefineConfig
from skyline.matching.retrieval import RetrievalConfig, Retriever
from skyline.pipeline.config import mapped_area_m, read_dem_of
from skyline.pipeline.match import RenderedScene
from skyline.planning.uniform import map_bounds
from skyline.store import open_store
from skyline_bench.measuring.record import write_record
from skyline_bench.queries.made import MadeQuery, QueryConfig, Truth, make_queries

T = TypeVar("T")

RESULTS = Path(__file__).parent / "results"
FULL = FullConfig()
FITTED = (125, 500, 2000)
"""Places whose pose is fitted well in retrieval; the last before every refinement."""
SHORTLISTS = (4, 16, 64, 400)
"""Retrieved poses that a refinement starts from."""
UNREFINED = "none"
DEPTHS = {
    "least": (
        RefineConfig(
            walkers=4, rounds=2, keep_least=2, restarts=0, finalists=3, final_rounds=1, rivals=1
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


class Bench:
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

    def outcomes(self, query: MadeQuery) -> Iterator[tuple[Setting, Outcome]]:
        """Yield what became of a query in every setting."""
        try:
            rays = query.rays()
        except InputError:  # No skyline is left to be seen.
            settings = [Setting(UNREFINED, fitted, FULL.shortlist) for fitted in self._retrieval]
            settings += [Setting(name, FITTED[-1], count) for name, count in self._refinement]
            yield from ((setting, Outcome(self._miss_m, 0.0)) for setting in settings)
            return
        for fitted, matcher in self._retrieval.items():
            found, retrieval_s = _timed(lambda m=matcher: m.retrieve(rays))
            error_m = self._error_m(found, query.truth)
            yield Setting(UNREFINED, fitted, FULL.shortlist), Outcome(error_m, retrieval_s)
        # What was found last, by the retrieval that fits most, is refined.
        for (name, shortlist), matcher in self._refinement.items():
            best = found[np.arange(min(shortlist, len(found)))]
            poses, refinement_s = _timed(lambda m=matcher, b=best: m.refine(b, rays))
            error_m = self._error_m(poses.hypotheses, query.truth)
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


def summary(setting: Setting, outcomes: Sequence[Outcome]) -> dict[str, object]:
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


def save_plot(rows: Sequence[dict[str, object]], path: Path) -> None:
    """Save error against time, one line a depth of refinement."""
    figure = Figure(figsize=(10.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    error, within = figure.subplots(1, 2)
    _draw(error, rows, "median_m", "median error (m)")
    _draw(within, rows, "within_200m", f"share within {RIGHT_WITHIN_M:.0f} m")
    error.legend(fontsize=8, title="refinement")
    figure.suptitle(
        f"retrieval fits {', '.join(map(str, FITTED))} places; the best "
        f"{', '.join(map(str, SHORTLISTS))} are refined",
        fontsize=10,
    )
    figure.savefig(path, dpi=90)


def _draw(axis: Axes, rows: Sequence[dict[str, object]], key: str, label: str) -> None:
    for name in (UNREFINED, *DEPTHS):
        line = [row for row in rows if row["refinement"] == name]
        axis.plot([row["cpu_ms"] for row in line], [row[key] for row in line], "o-", label=name)
    axis.set(xscale="log", xlabel="processor time a query (ms)", ylabel=label)
    axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter(ScalarFormatter())
    axis.xaxis.set_minor_formatter(NullFormatter())
    axis.grid(alpha=0.3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", nargs="+", type=Path)
    parser.add_argument("--queries", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    config = MatchConfig()
    with open_store(given.store) as store:
        terrain = read_dem_of(store.header, given.dem)
        west, south, east, north = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        places, scene = store.places(), RenderedScene(terrain, store.header, config)
    retrievers = {
        fitted: Retriever(places, terrain.height_at, RetrievalConfig(fitted=fitted))
        for fitted in FITTED
    }
    bench = Bench(retrievers, scene, 0.5 * math.hypot(east - west, north - south))
    area_m = west, south, east, north
    queries = make_queries(terrain, area_m, given.queries, given.seed, QueryConfig())
    deque(bench.outcomes(queries[0]), maxlen=0)  # The first compiles shaders.
    told: dict[Setting, list[Outcome]] = {}
    with progress_bar("queries") as progress:
        for number, query in enumerate(queries, start=1):
            for setting, outcome in bench.outcomes(query):
                told.setdefault(setting, []).append(outcome)
            progress(number, len(queries))
    scene.release()
    rows = [summary(setting, outcomes) for setting, outcomes in told.items()]
    write_record(RESULTS / "accuracy_time.json", "accuracy-time", rows)
    save_plot(rows, RESULTS / "accuracy_time.png")


if __name__ == "__main__":
    main()

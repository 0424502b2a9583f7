"""Accuracy against time: how long a short list, how deep a refinement, and what that buys.

Run as ``python bench/accuracy_time.py STORE.h5 DEM...``; writes accuracy_time.json and .png to
bench/results. Queries are drawn over the store's own area. Seconds are processor time a query,
which other work on the machine does not change; predictions are made once, before.
"""

import argparse
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from skyline import MatchConfig, read_dem
from skyline.console import progress_bar
from skyline.errors import InputError
from skyline.experiments.queries import MadeQuery, QueryConfig, make_queries
from skyline.experiments.record import write_record
from skyline.matching.dense import DenseProfiles
from skyline.matching.full import FullConfig, FullMatcher
from skyline.matching.pose import RefineConfig
from skyline.matching.retrieval import RetrievalConfig, Retriever
from skyline.pipeline.config import mapped_area_m
from skyline.pipeline.match import RenderedScene
from skyline.pipeline.predicted import cache_folder, predicted_profiles
from skyline.planning.uniform import map_bounds
from skyline.store import open_store

RESULTS = Path(__file__).parent / "results"
FULL = FullConfig()
SHORTLISTS = (4, 16, 64, 400)
"""Retrieved poses that are refined, or of which the best is taken."""
FITTED = (250, 1000, 4000)
"""Entries whose pose is fitted in retrieval."""
AT_MOST_M = 11_000.0


@dataclass(frozen=True)
class Depth:
    """A depth of refinement: its name, and its configuration for a short list."""

    name: str
    full: FullConfig | None


def depths(shortlist: int) -> list[Depth]:
    """Return how far a short list may be refined, from not at all to always thoroughly."""

    def cut(config: RefineConfig) -> RefineConfig:
        return replace(config, shortlist=min(config.shortlist, shortlist))

    least = RefineConfig(
        walkers=4, rounds=2, keep_least=2, restarts=0, finalists=3, final_rounds=1, rivals=1
    )
    base = FullConfig(quick=cut(FULL.quick), refine=cut(FULL.refine))
    alone = -math.inf
    return [
        Depth("not refined", None),
        Depth("least", replace(base, quick=cut(least), sure_margin=alone)),
        Depth("quick", replace(base, sure_margin=alone)),
        Depth("as it is: thorough where unsure", base),
        Depth("always thorough", replace(base, sure_margin=math.inf)),
    ]


def rows_of(
    profiles: DenseProfiles, scene: RenderedScene, queries: tuple[MadeQuery, ...]
) -> Iterator[dict[str, object]]:
    """Yield a row of the table for every length of the short list and depth of refinement."""
    for fitted in FITTED:
        retriever = Retriever(profiles, RetrievalConfig(fitted=fitted))
        for shortlist in SHORTLISTS if fitted == FITTED[-1] else SHORTLISTS[-1:]:
            for depth in depths(shortlist):
                matcher = FullMatcher(retriever, scene, depth.full)
                told = [_told(matcher, query, shortlist, depth) for query in queries]
                error_m, seconds = np.array(told).T
                yield {
                    "fitted": fitted,
                    "shortlist": shortlist,
                    "refinement": depth.name,
                    "n": len(queries),
                    "within_200m": float((error_m <= 200.0).mean()),
                    "median_m": float(np.median(error_m)),
                    "mean_m": float(error_m.mean()),
                    "cpu_ms": float(1000.0 * seconds.mean()),
                    "cpu_ms_p90": float(1000.0 * np.percentile(seconds, 90.0)),
                }


def _told(
    matcher: FullMatcher, query: MadeQuery, shortlist: int, depth: Depth
) -> tuple[float, float]:
    """Return the error, metres, and the processor time, seconds."""
    started = time.process_time()
    try:
        rays = query.rays()
    except InputError:  # No skyline is left to be seen.
        return AT_MOST_M, time.process_time() - started
    found = matcher.retrieve(rays)
    best = found[np.arange(min(shortlist, len(found)))]
    if depth.full is not None:
        poses = matcher.refine(best, rays)
        best = best[:0] if poses is None else poses.hypotheses
    seconds = time.process_time() - started
    if not len(best):
        return AT_MOST_M, seconds
    east_m = best.easting_m[0] - query.truth.easting_m
    north_m = best.northing_m[0] - query.truth.northing_m
    return float(np.hypot(east_m, north_m)), seconds


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Draw error against time, one line a depth of refinement."""
    figure, axes = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained")
    names = list(dict.fromkeys(str(row["refinement"]) for row in rows))
    for axis, key, label in (
        (axes[0], "median_m", "median error, m"),
        (axes[1], "within_200m", "share within 200 m"),
    ):
        for name in names:
            line = [row for row in rows if row["refinement"] == name]
            for fitted, style in ((FITTED[-1], "o-"), (None, "x:")):
                some = [
                    row for row in line if (row["fitted"] == FITTED[-1]) == (fitted is not None)
                ]
                x, y = [row["cpu_ms"] for row in some], [row[key] for row in some]
                colour = f"C{names.index(name)}"
                axis.plot(x, y, style, color=colour, label=name if fitted else None)
        axis.set_xscale("log")
        axis.set_xlabel("processor time a query, ms")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].set_yscale("log")
    axes[1].legend(fontsize=8, title="refinement")
    figure.suptitle(
        f"Short lists of {', '.join(map(str, SHORTLISTS))} (dots); crosses: "
        f"{', '.join(map(str, FITTED[:-1]))} entries fitted",
        fontsize=10,
    )
    figure.savefig(path, dpi=90)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", nargs="+", type=Path)
    parser.add_argument("--queries", type=int, default=60)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    terrain = read_dem(given.dem)
    config = MatchConfig()
    with open_store(given.store) as store:
        area_m = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        profiles = predicted_profiles(store, terrain, config.densify, cache_folder())
        scene = RenderedScene(terrain, store.header, config)
    queries = make_queries(terrain, area_m, given.queries, given.seed, QueryConfig())
    rows = []
    total = len(depths(1)) * (len(SHORTLISTS) + len(FITTED) - 1)
    with progress_bar("configurations") as progress:
        for row in rows_of(profiles, scene, queries):
            rows.append(row)
            progress(len(rows), total)
    scene.release()
    write_record(RESULTS / "accuracy_time.json", "accuracy-time", rows)
    draw(rows, RESULTS / "accuracy_time.png")


if __name__ == "__main__":
    main()

"""A store of places searched among very many others, and for skylines of elsewhere.

Very many: a store's own places are joined by others made of them, turned, mirrored and made steeper
or flatter, skylines of terrain of the same kind. It is told how long a search takes, in how much
memory, and whether the place still comes first. Elsewhere: plain queries from the middle of strange
terrain. It is told how many a store answers, and how sure it is of them.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from skyline import MatchConfig, Matcher
from skyline.build.cluster import Progress
from skyline.build.grid import map_bounds
from skyline.horizons import Horizons
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.retrieval import Retriever
from skyline.matching.threads import one_blas_thread
from skyline.pipeline.stored_dem import read_dem_of
from skyline.places import BINS, DISTANCE_BINS, Places
from skyline.store import open_store
from skyline.terrain.heightfield import HeightField, ground_of
from skyline_bench.measuring.record import Row
from skyline_bench.measuring.timing import own_bytes
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.stores.reference import mapped_area_m

STEEPER = (0.6, 1.5)
"""Tangents of made-up places are those of the store's times a number between these."""
ELSEWHERE_M = 100_000.0
"""Made-up places stand this far off, and as far again with each set of them."""
BLOCK = 1024
HALF_SIDE_M = 4_000.0
"""Of the square in strange terrain that queries come from."""


@dataclass(frozen=True, slots=True, eq=False)
class InMemory:
    """Places in memory in blocks, as a store has them; a `PlaceSource`."""

    places: Places

    def __len__(self) -> int:
        return len(self.places)

    def blocks(self) -> Iterator[Places]:
        """Yield all places in order."""
        for start in range(0, len(self), BLOCK):
            yield self.places[start : start + BLOCK]

    def take(self, rows: np.ndarray) -> Places:
        """Return some places, in order."""
        return self.places[rows]


def made_up(places: Places, generator: np.random.Generator, offset_m: float) -> Places:
    """Return as many places as those given, turned, mirrored, steeper or flatter."""
    turn = np.arange(BINS) * generator.choice((-1, 1), (len(places), 1))
    turn = (turn + generator.integers(0, BINS, (len(places), 1))) % BINS
    steeper = generator.uniform(*STEEPER, (len(places), 1)).astype(np.float32)
    distance_m = np.repeat(places.distance_m(), BINS // DISTANCE_BINS, axis=1)
    horizons = Horizons(
        places.easting_m + offset_m,
        places.northing_m,
        places.eye_elevation_m.astype(np.float64),
        steeper * np.take_along_axis(places.elevation_tan(), turn, axis=1),
        np.take_along_axis(distance_m, turn, axis=1),
        np.zeros((len(places), BINS), dtype=np.uint8),
    )
    return Places.of(horizons, places.tolerance_m)


def grown(places: Places, count: int, seed: int) -> Places:
    """Return ``count`` places, those given first."""
    generator = np.random.default_rng(seed)
    # Filled in place: memory is measured afterwards.
    whole = Places(
        *(
            np.empty((count, *values.shape[1:]), values.dtype)
            for values in (getattr(places, field.name) for field in fields(Places))
        )
    )
    for start in range(0, count, len(places)):
        sets = start // len(places)
        part = made_up(places, generator, sets * ELSEWHERE_M) if sets else places
        for field in fields(Places):
            held = getattr(whole, field.name)[start : start + len(places)]
            held[:] = getattr(part, field.name)[: len(held)]
    return whole


def retrieval_scale(
    path: Path, dem: Sequence[str], places: int, queries: int, seed: int, progress: Progress
) -> list[Row]:
    """Look for synthetic queries among a store's places, then among many; a row for each."""
    with open_store(path) as store:
        terrain = read_dem_of(store.header, dem)
        area_m = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        own = Places.concatenate(list(store.places().blocks()))
    made = make_queries(terrain, area_m, queries, seed, QueryConfig())
    seen = [query for query in made if query.skyline.trusted.any()]
    shortlist, rows = MatchConfig().full.shortlist, list[Row]()
    for count in (len(own), places):
        retriever = Retriever(InMemory(grown(own, count, seed)), ground_of(terrain))
        off_m, taken = [], []
        with one_blas_thread():
            for query in seen:
                rays, clocks = query.rays(), [(time.perf_counter(), time.process_time())]
                alike = retriever.screened(rays)
                clocks.append((time.perf_counter(), time.process_time()))
                best = retriever.shortlist(rays, shortlist, screened=alike)
                clocks.append((time.perf_counter(), time.process_time()))
                taken.append(np.diff(clocks, axis=0))
                off_m.append(query.truth.off_m(best.easting_m[0], best.northing_m[0]))
                progress(len(rows) * len(seen) + len(off_m), 2 * len(seen))
        (screen_s, screen_cpu_s), (fit_s, fit_cpu_s) = np.median(taken, axis=0).tolist()
        rows.append(
            {
                "places": count,
                "n": len(seen),
                "within_200m": float((np.array(off_m) <= RIGHT_WITHIN_M).mean()),
                "median_m": float(np.median(off_m)),
                "screen_s": screen_s,
                "screen_cpu_s": screen_cpu_s,
                "fit_s": fit_s,
                "fit_cpu_s": fit_cpu_s,
                "own_bytes": own_bytes(),
            }
        )
    return rows


def strangers(
    store: Path,
    dem: Sequence[str],
    strange: HeightField,
    queries: int,
    seed: int,
    progress: Progress,
) -> Row:
    """Match queries of strange terrain to a store of places of a DEM."""
    asked = QueryConfig()
    west, south, east, north = strange.bounds_m
    middle = np.array([(west + east) / 2.0, (south + north) / 2.0])
    area = (*(middle - HALF_SIDE_M), *(middle + HALF_SIDE_M))
    made = make_queries(strange, area, queries, seed, asked)
    config = MatchConfig(fov_slack=asked.fov_slack)
    sure, answered, seconds = list[float](), 0, list[float]()
    with Matcher(store, dem, config=config) as matcher:
        for number, query in enumerate(made, start=1):
            found = matcher.match(query.skyline)
            sure.append(found.candidates[0].confidence or 0.0 if found.candidates else 0.0)
            answered += found.answer is not None
            seconds.append(found.seconds)
            progress(number, len(made))
    return {
        "n": len(made),
        "answered": answered,
        "min_confidence": config.min_confidence,
        "above_half": int(np.sum(np.array(sure) >= 0.5)),
        "highest": float(max(sure)),
        "query_ms": float(1000.0 * np.median(seconds)),
    }

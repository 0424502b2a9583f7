"""Retrieval among very many places: seconds, memory, and whether the place still comes first.

A store's own places are joined by others made of them, turned, mirrored and made steeper or
flatter: skylines of terrain of the same kind.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path

import numpy as np

from skyline import MatchConfig
from skyline.horizons import Horizons
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.retrieval import Retriever
from skyline.matching.threads import one_blas_thread
from skyline.pipeline.config import read_dem_of
from skyline.pipeline.jobs import Progress
from skyline.places import BINS, DISTANCE_BINS, Places
from skyline.planning.uniform import map_bounds
from skyline.store import open_store
from skyline_bench.measuring.memory import own_bytes
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.stores.reference import mapped_area_m

STEEPER = (0.6, 1.5)
"""Tangents of made-up places are those of the store's times a number between these."""
ELSEWHERE_M = 100_000.0
"""Made-up places stand this far off, and as far again with each set of them."""
BLOCK = 1024


class InMemory:
    """Places in memory in blocks, as a store has them; a `PlaceSource`."""

    def __init__(self, places: Places) -> None:
        self._places = places

    def __len__(self) -> int:
        return len(self._places)

    def blocks(self) -> Iterator[Places]:
        """Yield all places in order."""
        for start in range(0, len(self), BLOCK):
            yield self._places[start : start + BLOCK]

    def take(self, rows: np.ndarray) -> Places:
        """Return some places, in order."""
        return self._places[rows]


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


def measure(
    path: Path,
    dem: Sequence[str],
    places: int,
    queries: int,
    seed: int,
    progress: Progress | None = None,
) -> list[dict[str, object]]:
    """Look for synthetic queries among a store's places, then among many; a row for each."""
    with open_store(path) as store:
        terrain = read_dem_of(store.header, dem)
        area_m = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        own = Places.concatenate(list(store.places().blocks()))
    made = make_queries(terrain, area_m, queries, seed, QueryConfig())
    seen = [query for query in made if query.skyline.trusted.any()]
    shortlist, rows = MatchConfig().full.shortlist, list[dict[str, object]]()
    for count in (len(own), places):
        retriever = Retriever(InMemory(grown(own, count, seed)), terrain.height_at)
        off_m, taken = [], []
        with one_blas_thread():
            for query in seen:
                rays, clocks = query.rays(), [(time.perf_counter(), time.process_time())]
                alike = retriever.screened(rays)
                clocks.append((time.perf_counter(), time.process_time()))
                best = retriever.shortlist(rays, shortlist, screened=alike)
                clocks.append((time.perf_counter(), time.process_time()))
                taken.append(np.diff(clocks, axis=0))
                east_m = best.easting_m[0] - query.truth.easting_m
                north_m = best.northing_m[0] - query.truth.northing_m
                off_m.append(float(np.hypot(east_m, north_m)))
                if progress:
                    progress(len(rows) * len(seen) + len(off_m), 2 * len(seen))
        (screen_s, screen_cpu_s), (fit_s, fit_cpu_s) = np.median(taken, axis=0).tolist()
        row: dict[str, object] = {
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
        rows.append(row)
    return rows

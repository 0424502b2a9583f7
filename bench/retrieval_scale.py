"""Retrieval among very many profiles: seconds, memory, and whether the place still comes first.

Run as ``python bench/retrieval_scale.py STORE.h5 DEM... [--bins 720]``; writes
retrieval_scale.json to bench/results. The store's own predictions are joined by others made of
them, turned, mirrored and made steeper or flatter, until there are a million: skylines of terrain
of the same kind. Predictions of 360 bins are every second of 720.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from skyline import MatchConfig
from skyline.console import progress_bar
from skyline.experiments.memory import peak_bytes, reset_peak
from skyline.experiments.queries import QueryConfig, make_queries
from skyline.experiments.record import write_record
from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline.matching.dense import UNKNOWN_Y, DenseProfiles
from skyline.matching.retrieval import Retriever
from skyline.pipeline.config import mapped_area_m, read_dem_of
from skyline.pipeline.predicted import cache_folder, predicted_profiles
from skyline.planning.uniform import map_bounds
from skyline.store import open_store

RESULT = Path(__file__).parent / "results" / "retrieval_scale.json"
STEEPER = (0.6, 1.5)
"""Tangents of made-up profiles are those of predicted ones times a number between these."""
ELSEWHERE_M = 100_000.0
"""Made-up profiles stand this far off, and as far again with each set of them."""


def made_up(profiles: DenseProfiles, seed: int) -> Iterator[DenseProfiles]:
    """Yield sets of profiles as many as those given, turned, mirrored, steeper or flatter."""
    generator = np.random.default_rng(seed)
    offset_m = 0.0
    while True:
        offset_m += ELSEWHERE_M
        turn = np.arange(profiles.bins) * generator.choice((-1, 1), (len(profiles), 1))
        turn = (turn + generator.integers(0, profiles.bins, (len(profiles), 1))) % profiles.bins
        y = np.take_along_axis(profiles.y_steps, turn, axis=1)
        steeper = generator.uniform(*STEEPER, (len(profiles), 1))
        steps: NDArray[np.int16] = np.where(
            y == UNKNOWN_Y, y, np.clip(np.rint(y * steeper), UNKNOWN_Y + 1, -(UNKNOWN_Y + 1))
        ).astype(np.int16)
        yield replace(
            profiles,
            easting_m=profiles.easting_m + offset_m,
            y_steps=steps,
            distance=np.take_along_axis(profiles.distance, turn, axis=1),
        )


def grown(profiles: DenseProfiles, count: int, seed: int) -> DenseProfiles:
    """Return ``count`` profiles, those given first."""
    whole = DenseProfiles(
        *(
            np.empty((count, *values.shape[1:]), values.dtype)
            for values in (getattr(profiles, field.name) for field in fields(DenseProfiles))
        )
    )
    filled, others = 0, made_up(profiles, seed)
    part = profiles
    while filled < count:
        taken = min(len(part), count - filled)
        for field in fields(DenseProfiles):
            getattr(whole, field.name)[filled : filled + taken] = getattr(part, field.name)[:taken]
        filled, part = filled + taken, next(others)
    return whole


def thinned(profiles: DenseProfiles, bins: int) -> DenseProfiles:
    """Return profiles with fewer bins, which must divide theirs."""
    step, left = divmod(profiles.bins, bins)
    if left:
        raise SystemExit(f"--bins is {bins}; expected a divisor of {profiles.bins}")
    return replace(
        profiles,
        y_steps=profiles.y_steps[:, ::step].copy(),
        distance=profiles.distance[:, ::step].copy(),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", nargs="+", type=Path)
    parser.add_argument("--bins", type=int, default=720)
    parser.add_argument("--profiles", type=int, default=1_000_000)
    parser.add_argument("--queries", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    config = MatchConfig()
    with open_store(given.store) as store:
        terrain = read_dem_of(store.header, given.dem)
        area_m = mapped_area_m(store.header, terrain) or map_bounds(terrain, None)
        own = predicted_profiles(store, terrain, config.densify, cache_folder())
    own = thinned(own, given.bins)
    made = make_queries(terrain, area_m, given.queries, given.seed, QueryConfig())
    queries = [query for query in made if query.skyline.trusted.any()]
    rows = []
    for count in (len(own), given.profiles):
        profiles = grown(own, count, given.seed)
        reset_peak()
        started = time.perf_counter()
        retriever = Retriever(profiles)
        prepare_s = time.perf_counter() - started
        off_m, wall_s, cpu_s = [], [], []
        with progress_bar(f"queries among {count:,}") as progress:
            for number, query in enumerate(queries, start=1):
                started, busy = time.perf_counter(), time.process_time()
                best = retriever.shortlist(query.rays(), config.full.shortlist)
                wall_s.append(time.perf_counter() - started)
                cpu_s.append(time.process_time() - busy)
                east_m = best.easting_m[0] - query.truth.easting_m
                north_m = best.northing_m[0] - query.truth.northing_m
                off_m.append(float(np.hypot(east_m, north_m)))
                progress(number, len(queries))
        row: dict[str, object] = {
            "profiles": count,
            "bins": given.bins,
            "n": len(queries),
            "within_200m": float((np.array(off_m) <= RIGHT_WITHIN_M).mean()),
            "median_m": float(np.median(off_m)),
            "query_s": float(np.median(wall_s)),
            "query_cpu_s": float(np.median(cpu_s)),
            "prepare_s": prepare_s,
            "peak_bytes": peak_bytes(),
        }
        print(row)
        rows.append(row)
    write_record(RESULT, "retrieval-scale", rows)


if __name__ == "__main__":
    main()

"""Skylines of elsewhere: how many a store answers, and how sure it is of them.

Queries are plain ones from the middle of the strange terrain.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyline import MatchConfig, Matcher
from skyline.pipeline.jobs import Progress
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.synthetic import QueryConfig, make_queries

HALF_SIDE_M = 4_000.0


def measure(
    store: Path,
    dem: Sequence[str],
    strange: HeightField,
    queries: int,
    seed: int,
    progress: Progress | None = None,
) -> dict[str, object]:
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
            if progress:
                progress(number, len(made))
    return {
        "n": len(made),
        "answered": answered,
        "min_confidence": config.min_confidence,
        "above_half": int(np.sum(np.array(sure) >= 0.5)),
        "highest": float(max(sure)),
        "query_ms": float(1000.0 * np.median(seconds)),
    }

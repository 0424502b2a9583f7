"""Skylines of elsewhere: how many a store answers, and how sure it is of them.

Run as ``python bench/strangers.py STORE.h5 DEM... --strange DEM``; the store holds places of DEM.
Queries are plain ones from the middle of the strange terrain. Writes strangers.json to
bench/results.
"""

import argparse
from pathlib import Path

import numpy as np

from skyline import MatchConfig, Matcher, read_dem
from skyline.console import progress_bar
from skyline.terrain.dem import DemOptions
from skyline.terrain.heightfield import HeightField
from skyline_bench.measuring.record import write_record
from skyline_bench.queries.made import QueryConfig, make_queries

RESULT = Path(__file__).parent / "results" / "strangers.json"
HALF_SIDE_M = 4_000.0


def middle_m(terrain: HeightField) -> tuple[float, float, float, float]:
    """Return the square in a terrain's middle that queries are taken from."""
    west, south, east, north = terrain.bounds_m
    easting_m, northing_m = (west + east) / 2.0, (south + north) / 2.0
    return (
        easting_m - HALF_SIDE_M,
        northing_m - HALF_SIDE_M,
        easting_m + HALF_SIDE_M,
        northing_m + HALF_SIDE_M,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("dem", nargs="+", type=Path)
    parser.add_argument("--strange", nargs="+", type=Path, required=True)
    parser.add_argument("--queries", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    strange = read_dem(given.strange, DemOptions(reproject=True))
    asked = QueryConfig()
    queries = make_queries(strange, middle_m(strange), given.queries, given.seed, asked)
    config = MatchConfig(fov_slack=asked.fov_error)
    sure, answered, seconds = [], 0, []
    with (
        Matcher(given.store, given.dem, config=config) as matcher,
        progress_bar("strangers") as progress,
    ):
        for number, query in enumerate(queries, start=1):
            found = matcher.match(query.skyline)
            sure.append(found.candidates[0].confidence or 0.0 if found.candidates else 0.0)
            answered += found.answer is not None
            seconds.append(found.seconds)
            progress(number, len(queries))
    row: dict[str, object] = {
        "strange": [path.name for path in given.strange],
        "n": len(queries),
        "answered": answered,
        "min_confidence": config.min_confidence,
        "above_half": int(np.sum(np.array(sure) >= 0.5)),
        "highest": float(max(sure)),
        "query_ms": float(1000.0 * np.median(seconds)),
    }
    print(row)
    write_record(RESULT, "strangers", [row])


if __name__ == "__main__":
    main()

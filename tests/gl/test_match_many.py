"""Queries matched by workers: the answers are those of one process."""

import numpy as np
import pytest
from scenes import NORTH_M, WEST_M, fractal, write_dem

from skyline import MatchConfig, Matcher, Narrowing, build_places, read_dem
from skyline.build.cluster import runner_of
from skyline.match.matcher import FULL
from skyline.match.queries import Query, match_many
from skyline.photo.trace import write_trace
from skyline_bench.queries.synthetic import QueryConfig, make_queries

AREA = (WEST_M + 800.0, NORTH_M - 2400.0, WEST_M + 2400.0, NORTH_M - 800.0)
SHARP = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.003, 0.003), smooth_share=0.0)


@pytest.fixture(scope="module")
def searched(tmp_path_factory):
    """A store of more than 6,000 places, two traces, and where one of them is."""
    folder = tmp_path_factory.mktemp("searched")
    dem = write_dem(folder / "dem.tif", fractal(110, 110, relief_m=700.0, seed=11))
    terrain = read_dem([dem])
    build_places(terrain, folder / "store.h5", 40.0)
    traces = [folder / "0.csv", folder / "1.csv"]
    queries = make_queries(terrain, AREA, 2, 3, SHARP)
    for path, query in zip(traces, queries, strict=True):
        write_trace(query.skyline, path)
    first = queries[0].truth
    lon, lat = terrain.frame.to_lonlat(first.easting_m, first.northing_m)
    return folder / "store.h5", traces, (float(lon), float(lat), 0.15)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("refine", "count"), [(False, 2), (True, 1)], ids=["wide", "narrowed and refined"]
)
def test_two_workers_find_what_one_process_finds(searched, dask_cluster, refine, count):
    store, traces, near = searched
    # Few places are refined: each process does it with all its effort.
    narrowing = Narrowing(near, heading_deg=(180.0, 179.0)) if refine else Narrowing()
    config = MatchConfig(min_confidence=0.0, refine=refine)
    queries = [Query(str(path), fov_deg=60.0, narrowing=narrowing) for path in traces[:count]]
    with Matcher(store, config=config) as matcher:
        wanted = [matcher.match(one.read(), narrowing=narrowing) for one in queries]
    with runner_of(dask_cluster.scheduler_address) as runner:
        found = list(match_many(runner, (str(store), None, FULL, config), queries))
    for one, other in zip(found, wanted, strict=True):
        assert one.candidates
        # Equal floats, not near ones.
        assert one.candidates == other.candidates
        np.testing.assert_array_equal(one.query.row_px, other.query.row_px)

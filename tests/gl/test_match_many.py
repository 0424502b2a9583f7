"""Queries matched by workers, a store screened in parts: the answers are those of one process."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import NORTH_M, WEST_M, fractal, write_dem

from skyline import MatchConfig, Matcher, Narrowing, build_places, read_dem
from skyline.build.cluster import runner_of
from skyline.match import queries
from skyline.match.matchers import FULL
from skyline.match.queries import Query, match_many
from skyline.photo.trace import write_trace
from skyline.store import open_store
from skyline_bench.queries.synthetic import QueryConfig, make_queries

SPACING_M = 40.0
AREA = (WEST_M + 800.0, NORTH_M - 2400.0, WEST_M + 2400.0, NORTH_M - 800.0)
SHARP = QueryConfig(max_tilt_deg=3.0, noise_deg=(0.03, 0.03), smooth_share=0.0)
BOLD = MatchConfig(min_confidence=0.0)
READING = Query("", fov_deg=60.0)
SOUTH = Narrowing(heading_deg=(180.0, 120.0))


@pytest.fixture(scope="module")
def terrain(tmp_path_factory):
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, fractal(110, 110, relief_m=700.0, seed=11))])


@pytest.fixture(scope="module")
def store(tmp_path_factory, terrain):
    """A store of more than 6,000 places: several blocks."""
    path = tmp_path_factory.mktemp("store") / "store.h5"
    build_places(terrain, path, SPACING_M)
    return path


@pytest.fixture(scope="module")
def traces(tmp_path_factory, terrain):
    folder = tmp_path_factory.mktemp("traces")
    paths = []
    for index, query in enumerate(make_queries(terrain, AREA, 2, seed=3, config=SHARP)):
        paths.append(folder / f"{index}.csv")
        write_trace(query.skyline, paths[-1])
    return paths


@pytest.fixture
def small_parts(monkeypatch):
    """Screen a block at a time."""
    monkeypatch.setattr(queries, "_PART_BLOCKS", 1)


def queries_of(paths, narrowing=None):
    return [replace(READING, path=str(path), narrowing=narrowing or Narrowing()) for path in paths]


class Counted:
    """A runner that counts the jobs it is given."""

    def __init__(self, runner):
        self._runner = runner
        self.names = []

    def __call__(self, work, items, names):
        self.names += names
        return self._runner(work, items, names)


def alone(store, paths, narrowing=None, config=BOLD):
    with Matcher(store, config=config) as matcher:
        some = queries_of(paths, narrowing)
        return [matcher.match(one.read(), narrowing=one.narrowing) for one in some]


def asked(store, config=BOLD):
    return str(store), None, FULL, config


@pytest.mark.slow
@pytest.mark.parametrize(
    ("narrowing", "refine", "count"),
    [(None, False, 2), (SOUTH, False, 2), (SOUTH, True, 1)],
    ids=["wide", "narrowed", "refined"],
)
def test_two_workers_find_what_one_process_finds(
    store, traces, dask_cluster, small_parts, narrowing, refine, count
):
    config, traces = replace(BOLD, refine=refine), traces[:count]
    wanted = alone(store, traces, narrowing, config)
    with open_store(store) as opened:
        blocks = len(list(opened.places().blocks()))
    assert blocks > 4
    with runner_of(dask_cluster.scheduler_address) as runner:
        counted = Counted(runner)
        found = list(match_many(counted, asked(store, config), queries_of(traces, narrowing)))
    assert len(counted.names) == len(traces) * (blocks + 1)
    for one, other in zip(found, wanted, strict=True):
        assert one.candidates
        # Equal floats, not near ones.
        assert one.candidates == other.candidates
        np.testing.assert_array_equal(one.query.row_px, other.query.row_px)

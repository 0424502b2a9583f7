"""Shards of a search in other processes."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from place_scenes import AZIMUTH_DEG, curve, places_of, rays
from store_rows import PLACES_HEADER

from skyline.match.distant_shards import distant_shards, opening_of
from skyline.match.joined_shards import JoinedShards
from skyline.match.retrieval import Retriever
from skyline.match.shard import LocalShard
from skyline.store.layout import columns_of
from skyline.store.read import open_store
from skyline.store.write import write_store


class HereRunner:
    """Asks this process, by bytes as a cluster does."""

    def __init__(self, workers):
        self.workers = workers
        self.asked = []

    def ask(self, work, opening, item, worker):
        self.asked.append(worker)
        work, opening, item = pickle.loads(pickle.dumps((work, opening, item)))
        return pickle.loads(pickle.dumps(work(opening.open(), item, None)))


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """A store of 3000 places, of 40 skylines."""
    path = tmp_path_factory.mktemp("spread") / "store.h5"
    places = places_of(np.stack([curve(seed % 40, AZIMUTH_DEG) for seed in range(3000)]))
    places = replace(places, easting_m=500_000.0 + places.easting_m)
    write_store(path, PLACES_HEADER, columns_of(PLACES_HEADER, places))
    return path


def test_workers_find_what_one_process_finds_to_the_bit(store):
    """Three parts, of 1024, 1024 and 952 places."""
    runner = HereRunner(2)
    (shards,) = distant_shards(runner, opening_of([store]), [3000])
    assert [len(shard) for shard in shards] == [1024, 1024, 952]
    spread = list(Retriever(JoinedShards([shards], at_once=3)).shortlists(rays(3, 77.0), 20))
    with open_store(store) as file:
        whole = list(
            Retriever(JoinedShards([[LocalShard(file.places())]])).shortlists(rays(3, 77.0), 20)
        )
    assert len(spread) == len(whole) == 2
    for one, other in zip(spread, whole, strict=True):
        for name, column in one.columns().items():
            np.testing.assert_array_equal(column, getattr(other, name))
    assert set(runner.asked) == {0, 1, 2}


def test_areas_are_cut_where_they_begin():
    """Two workers of two parts each, of 6 blocks: a part has two blocks."""
    west, east = distant_shards(HereRunner(2), opening_of([]), [1500, 4000])
    assert [len(shard) for shard in west] == [1500]
    assert [len(shard) for shard in east] == [2048, 1952]

"""Several stores that are searched as the one store of a merge."""

import os
from dataclasses import fields, replace

import numpy as np
import pytest
from store_rows import (
    PLACES_HEADER,
    VIEWS_HEADER,
    assert_holds,
    chunk_of,
    flip,
    numbered_places,
    write_rows,
)

from skyline.errors import StoreError, StoreMismatchError
from skyline.store.layout import columns_of
from skyline.store.merge import merge_stores, open_joined
from skyline.store.places import Places
from skyline.store.read import open_store
from skyline.store.write import write_store


def write_some(path, number, tolerance_m=25.0):
    """Write a store of the places of some numbers."""
    places = numbered_places(0, 3000)[number]
    places = replace(places, tolerance_m=np.full(len(number), tolerance_m, np.float32))
    write_store(path, PLACES_HEADER, columns_of(PLACES_HEADER, places))
    return path


def assert_same(one, other):
    for field in fields(Places):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


@pytest.fixture
def stores(tmp_path):
    """Two stores that lie in each other and overlap; the second is the denser one."""
    even = write_some(tmp_path / "even.h5", np.arange(0, 3000, 2))
    dense = write_some(tmp_path / "dense.h5", np.r_[1:1000:2, 1000:1400, 1401:3000:2], 12.5)
    return [even, dense]


def test_joined_places_are_those_of_a_merge_block_by_block(stores, tmp_path):
    merge_stores(stores, tmp_path / "merged.h5")
    with open_joined(stores) as joined, open_store(tmp_path / "merged.h5") as merged:
        assert joined.header == merged.header
        assert joined.digest == merged.digest
        some, whole = joined.places(), merged.places()
    assert len(some) == len(whole) == 3000
    for one, other in zip(some.blocks(), whole.blocks(), strict=True):
        assert_same(one, other)
    rows = np.array([2999, 0, 1201, 1201, 7])
    assert_same(some.take(rows), whole.take(rows))
    np.testing.assert_array_equal(some.phases(rows), whole.phases(rows))
    assert len(some.take(rows[:0])) == 0


def test_of_a_place_in_both_stores_the_denser_plan_counts(stores):
    with open_joined(stores) as joined:
        tolerance_m = joined.places().take(np.arange(1000, 1400)).tolerance_m
    assert (tolerance_m == 12.5).all()


def test_the_order_of_the_stores_changes_nothing(stores):
    with open_joined(stores) as one, open_joined(stores[::-1]) as other:
        every = np.arange(3000)
        assert_same(one.places().take(every), other.places().take(every))


def test_nothing_is_written_to_search_stores_of_places(stores, tmp_path, monkeypatch):
    folder = tmp_path / "temporary"
    monkeypatch.setattr("tempfile.tempdir", str(folder))  # It does not exist.
    with open_joined(stores) as joined:
        assert len(joined.places()) == 3000


def test_stores_of_renderings_are_merged(tmp_path):
    ends = ((0, 70), (50, 130))
    paths = [write_rows(tmp_path / f"{a}.h5", a, b, VIEWS_HEADER) for a, b in ends]
    with open_joined(paths) as joined:
        assert_holds(joined, np.arange(130))


def test_stores_of_other_models_are_not_joined(stores, tmp_path):
    other = replace(PLACES_HEADER, dem_digest="b2" * 32)
    write_rows(tmp_path / "other.h5", 0, 5, other)
    with (
        pytest.raises(StoreMismatchError, match="cannot be joined"),
        open_joined([*stores, tmp_path / "other.h5"]),
    ):
        pass


def test_a_damaged_place_of_one_store_is_named_with_its_store(stores):
    flip(stores[1], chunk_of(stores[1], "places/rise", 1) + 12)
    with open_joined(stores) as joined:
        places = joined.places()
    with pytest.raises(StoreError, match=r"dense\.h5 is damaged"):
        places.take(np.arange(3000))


def test_a_store_that_is_cut_short_while_it_is_searched_is_named(stores):
    with open_joined(stores) as joined:
        places = joined.places()
    blocks = places.blocks()
    next(blocks)
    os.truncate(stores[1], stores[1].stat().st_size // 2)
    with pytest.raises(StoreError, match=r"dense\.h5 is truncated"):
        next(blocks)

"""Queries in three groups by how far their skyline is."""

import numpy as np
import pytest

from skyline.errors import InputError
from skyline_bench.trials.trials import distance_groups


def test_terciles_hold_every_query_once():
    distance = np.random.default_rng(0).permutation(10) * 100.0
    close, medium, far, every = distance_groups(distance)
    assert [group.name for group in (close, medium, far, every)] == [
        "close", "medium", "far", "all",
    ]  # fmt: skip
    assert [len(group.queries) for group in (close, medium, far)] == [4, 3, 3]
    assert sorted(close.queries + medium.queries + far.queries) == list(range(10))
    assert every.queries == tuple(range(10))
    assert (close.from_m, close.to_m) == (0.0, 300.0)
    assert (medium.from_m, medium.to_m) == (400.0, 600.0)
    assert (far.from_m, far.to_m) == (700.0, 900.0)
    assert (every.from_m, every.to_m) == (0.0, 900.0)
    for group in (close, medium, far):
        assert all(group.from_m <= distance[i] <= group.to_m for i in group.queries)


def test_a_query_without_a_skyline_is_close_and_not_dropped():
    close, _, far, every = distance_groups([500.0, np.nan, 100.0, 900.0, 700.0, 300.0])
    assert close.queries == (1, 2)
    assert (close.from_m, close.to_m) == (100.0, 100.0)
    assert far.queries == (3, 4)
    assert len(every.queries) == 6
    nothing = distance_groups([np.nan] * 3)
    assert [len(group.queries) for group in nothing] == [1, 1, 1, 3]
    assert np.isnan(nothing[0].from_m)


def test_a_group_needs_a_query():
    with pytest.raises(InputError, match="at least 3"):
        distance_groups([1.0, 2.0])

"""What stands before the mountains."""

import numpy as np
import pytest

from skyline_bench.queries.occluders import random_occluders, random_runs

WIDTH = 500


@pytest.mark.parametrize(("share", "count"), [(0.0, 3), (0.1, 2), (0.35, 5), (0.9, 4)])
def test_runs_hold_the_share_and_do_not_overlap(share, count):
    for seed in range(20):
        runs = random_runs(np.random.default_rng(seed), WIDTH, share, count)
        hidden = np.zeros(WIDTH, dtype=int)
        for start, stop in runs:
            hidden[start:stop] += 1
        assert len(runs) == (count if share else 0)
        assert hidden.max() <= 1
        assert hidden.sum() == round(share * WIDTH)


def test_runs_lie_anywhere():
    starts = [random_runs(np.random.default_rng(seed), WIDTH, 0.1, 1)[0][0] for seed in range(200)]
    assert min(starts) < 20
    assert max(starts) > 430


@pytest.mark.parametrize("share", [0.0, 0.2, 0.4])
def test_occluders_rise_above_the_skyline(share):
    skyline = 300.0 + 20.0 * np.sin(np.arange(WIDTH) / 30.0)
    kinds = set()
    for seed in range(20):
        occluders = random_occluders(np.random.default_rng(seed), skyline, share)
        kinds |= {occluder.kind for occluder in occluders}
        covered = np.zeros(WIDTH, dtype=int)
        for occluder in occluders:
            columns = slice(*occluder.columns)
            covered[columns] += 1
            assert (occluder.row_px < skyline[columns]).all()
        assert covered.max(initial=0) <= 1
        assert covered.sum() == round(share * WIDTH)
    assert kinds == ({"tree", "building", "person"} if share else set())


def test_occluders_stand_where_no_skyline_is_in_the_picture():
    skyline = np.full(WIDTH, np.nan)
    skyline[:100] = 40.0
    occluders = random_occluders(np.random.default_rng(0), skyline, 0.4)
    assert all((occluder.row_px < 40.0).all() for occluder in occluders)

"""Posteriors of the photos of one walk."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from scenes import FRAME

from skyline import InputError
from skyline.geodesy.cell_grid import CellGrid
from skyline.match.posterior import Posterior
from skyline.match.walk import check_times, joined

GRID = CellGrid(west_m=0.0, north_m=1000.0, cell_m=10.0, rows=100, cols=100)


def posterior(cells):
    """Return a posterior with a share of the probability in some cells, and none elsewhere."""
    probability = np.zeros(GRID.shape, dtype=np.float32)
    for cell, share in cells.items():
        probability[cell] = share
    return Posterior(probability, GRID, FRAME)


EVEN = Posterior(np.full(GRID.shape, 1e-4, dtype=np.float32), GRID, FRAME)


def test_a_photo_that_tells_nothing_lies_in_the_disc_that_can_be_walked():
    sure, spread = joined([posterior({(50, 50): 1.0}), EVEN], [200.0])
    assert sure.probability[50, 50] == pytest.approx(1.0)
    # Of pi 200 m squared, a cell of 100 m2 holds 1 / 1257.
    assert spread.probability[50, 50] == pytest.approx(1 / 1257, rel=0.01)
    assert spread.probability[50, 69] == pytest.approx(1 / 1257, rel=0.01)
    assert spread.probability[50, 72] == spread.probability[65, 65] == 0.0
    assert spread.area_km2(0.95) == pytest.approx(0.95 * np.pi * 0.04, rel=0.02)


def test_a_doubtful_photo_was_taken_where_the_next_one_can_be_reached():
    doubtful = posterior({(10, 10): 0.7, (90, 90): 0.3})
    found, _ = joined([doubtful, posterior({(85, 90): 1.0})], [100.0])
    # 50 m away; the other place is 1.1 km away.
    assert found.probability[90, 90] == pytest.approx(1.0)


def test_a_photo_is_told_by_those_before_and_those_after_it():
    first, last = posterior({(50, 20): 1.0}), posterior({(50, 80): 1.0})
    _, middle, _ = joined([first, EVEN, last], [400.0, 400.0])
    # Two discs of 400 m, 600 m apart: the lens is 2 r^2 acos(d / 2 r) - d / 2 sqrt(4 r^2 - d^2).
    lens_m2 = 2 * 400**2 * np.arccos(0.75) - 300 * np.sqrt(4 * 400**2 - 600**2)
    assert middle.probability[50, 50] == pytest.approx(100 / lens_m2, rel=0.02)
    assert middle.probability[50, 20] == 0.0


def test_posteriors_of_a_walk_are_those_of_all_its_places():
    rng = np.random.default_rng(4)
    grid = replace(GRID, rows=6, cols=6)
    alone = [
        Posterior(cells / cells.sum(), grid, FRAME)
        for cells in rng.random((3, 6, 6), dtype=np.float32)
    ]
    found = joined(alone, [20.0, 25.0])
    place = np.argwhere(np.ones((6, 6)))
    apart = np.linalg.norm(place[:, np.newaxis] - place, axis=2)

    def near(radius):
        """Parts of cells inside a disc, as far as their middles tell."""
        return np.clip(radius - apart + 0.5, 0.0, 1.0)

    one, two, three = (own.probability.ravel().astype(float) for own in alone)
    every = np.einsum("i,j,k,ij,jk->ijk", one, two, three, near(2.0), near(2.5))
    for number, own in enumerate(found):
        expected = every.sum(axis=tuple({0, 1, 2} - {number})) / every.sum()
        np.testing.assert_allclose(own.probability.ravel(), expected, rtol=0.1)


def test_a_wide_disc_is_spread_on_a_coarser_grid():
    corner = posterior({(0, 0): 1.0})
    _, spread = joined([corner, EVEN], [960.0])
    row, col = np.mgrid[:100, :100] * GRID.cell_m
    away_m = np.hypot(row, col)
    np.testing.assert_allclose(
        spread.probability[away_m < 900.0], 4 * 100 / (np.pi * 960.0**2), rtol=0.06
    )
    assert spread.probability[away_m > 1020.0].max() == 0.0


def test_a_walk_that_nobody_can_have_gone_is_told():
    far = [posterior({(10, 10): 1.0}), posterior({(90, 90): 1.0})]
    with pytest.raises(InputError, match="check their times"):
        joined(far, [500.0])


def test_times_with_and_without_a_zone_cannot_be_compared():
    at = datetime(2026, 7, 14, 15, 4)
    check_times([at, at])
    with pytest.raises(InputError, match="a time is '2026-07-14'; expected a datetime"):
        check_times([at, "2026-07-14"])
    with pytest.raises(InputError, match="give all alike"):
        check_times([at, at.replace(tzinfo=UTC)])

"""The tree of slabs bounds the terrain that rays meet, closely."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyline.terrain.mesh import EMPTY, LEAF_STRIPS, SLABS, level_count, slab_levels


def vertices_met(heights, start, slope, first, last):
    """Greatest sample at the ends of the edges a ray crosses from line ``first`` to ``last``.

    The ray passes column ``start`` at line 0.
    """
    greatest = EMPTY
    for line in range(first, last):
        here, there = sorted((start + slope * line, start + slope * (line + 1)))
        low, high = int(np.floor(here)), int(np.ceil(there))
        span = heights[line : line + 2, max(low, 0) : max(high + 1, 0)]
        greatest = max(greatest, span.max(initial=EMPTY))
    return greatest


SIZE = st.integers(2, 40)


@given(st.integers(0, 1000), SIZE, SIZE, st.sampled_from([0.4, 1.0, 2.5]),
       st.floats(-0.2, 1.2), st.floats(-1.0, 1.0))  # fmt: skip
def test_no_ray_meets_more_than_its_bound(seed, lines, columns, steepest, place, turn):
    heights = np.random.default_rng(seed).uniform(0, 100, (lines, columns)).astype(np.float32)
    slopes = np.linspace(-steepest, steepest, 9)
    slope = turn * steepest
    index = min(int((turn + 1.0) / 2.0 * 8), 7)
    start = place * columns
    slab = LEAF_STRIPS
    for maxima, first_block in slab_levels(heights, slopes, level_count(max(lines, columns) - 1)):
        for band in range(maxima.shape[1]):
            origin = band * SLABS * slab
            block = int(np.floor((start + slope * origin) / slab)) + first_block
            for child in range(SLABS):
                first = origin + child * slab
                last = min(first + slab, lines - 1)
                met = vertices_met(heights, start, slope, first, last)
                if met > EMPTY:
                    assert maxima[index, band, block, child] >= met
        slab *= SLABS


@pytest.mark.parametrize("slope", [-1.0, 1.0])
def test_a_ray_that_enters_at_the_end_of_a_band_is_bounded(slope):
    """Of the rays that come in from the side, it begins farthest off the map."""
    heights = np.zeros((129, 65), dtype=np.float32)
    heights[:, [0, -1]] = 50.0, 70.0
    slab = LEAF_STRIPS
    for maxima, first_block in slab_levels(heights, np.array([-1.0, 0.0, 1.0]), level_count(128)):
        strips = SLABS * slab
        start = 0.25 - strips if slope > 0.0 else 63.75 + strips
        block = int(np.floor(start / slab)) + first_block
        assert 0 <= block < maxima.shape[2]
        assert maxima[int(slope > 0.0), 0, block, -1] >= (50.0 if slope > 0.0 else 70.0)
        slab = strips

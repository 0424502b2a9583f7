"""The tree of slabs bounds the terrain that a ray meets."""

import numpy as np
import pytest

from skyline.terrain.slab_tree import LEAF_STRIPS, SLABS, level_count, slab_levels


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

"""The tree of slabs bounds the terrain that a ray meets."""

import numpy as np
import pytest

from skyline.terrain.slab_tree import (
    LEAF_STRIPS,
    SLABS,
    blocks_before,
    fill_levels,
    fill_mark_levels,
    level_count,
    level_shapes,
)


def levels_of(codes, slopes):
    """Return the levels of the tree of some codes."""
    count = level_count(max(codes.shape) - 1)
    levels = [
        np.empty((*shape, SLABS), codes.dtype)
        for shape in level_shapes(*codes.shape, slopes, count)
    ]
    fill_levels(codes, slopes, levels)
    return levels


@pytest.mark.parametrize("slope", [-1.0, 1.0])
def test_a_ray_that_enters_at_the_end_of_a_band_is_bounded(slope):
    """Of the rays that come in from the side, it begins farthest off the map."""
    codes = np.zeros((129, 65), dtype=np.uint16)
    codes[:, [0, -1]] = 50, 70
    slab = LEAF_STRIPS
    slopes = np.array([-1.0, 0.0, 1.0])
    first_block = blocks_before(slopes)
    for maxima in levels_of(codes, slopes):
        strips = SLABS * slab
        start = 0.25 - strips if slope > 0.0 else 63.75 + strips
        block = int(np.floor(start / slab)) + first_block
        assert 0 <= block < maxima.shape[2]
        assert maxima[int(slope > 0.0), 0, block, -1] >= (50 if slope > 0.0 else 70)
        slab = strips


@pytest.mark.parametrize(("lines", "columns"), [(1, 1), (2, 9), (40, 17), (131, 66)])
def test_a_slab_has_the_greatest_code_that_its_rays_sweep(lines, columns):
    """The finest level agrees with the columns that rays of a bin cross, one slab at a time."""
    codes = np.random.default_rng(7).integers(1, 1000, (lines, columns), dtype=np.uint16)
    slopes = np.array([-0.5, 0.25])
    maxima = levels_of(codes, slopes)[0]
    first_block = blocks_before(slopes)
    for slab in range(max(-(-(lines - 1) // LEAF_STRIPS), 1)):
        band, child = divmod(slab, SLABS)
        strip = codes[LEAF_STRIPS * slab : LEAF_STRIPS * (slab + 1) + 1]
        for block in range(maxima.shape[2]):
            # A ray starts within the block at the band's edge, and drifts by its slope.
            start = LEAF_STRIPS * (block - first_block)
            low = start - 0.5 * LEAF_STRIPS * (child + 1)
            high = start + LEAF_STRIPS + 0.25 * LEAF_STRIPS * (child + 1)
            first = max(int(np.floor(low - 0.03)), 0)
            past = max(int(np.ceil(high + 0.03)) + 1, 0)
            swept = strip[:, first:past]
            assert maxima[0, band, block, child] == swept.max(initial=0)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (3, 2), (17, 40), (130, 65), (300, 517)])
@pytest.mark.parametrize("slopes", [(-1.0, 0.0, 8), (0.0, 0.7, 8), (-3.2, 3.2, 16)])
@pytest.mark.parametrize("share", [0.0, 0.002, 0.3])
def test_the_tree_of_marks_is_that_of_their_codes(shape, slopes, share):
    marks = np.random.default_rng(11).random(shape) < share
    bins = np.linspace(slopes[0], slopes[1], slopes[2] + 1)
    expected = levels_of(marks.astype(np.uint16), bins)
    found = [np.zeros(level.shape[:3], np.uint8) for level in expected]
    fill_mark_levels(marks, bins, found)
    for level, wanted in zip(found, expected, strict=True):
        bits = np.unpackbits(level[..., np.newaxis], axis=-1, bitorder="little")
        np.testing.assert_array_equal(bits, wanted)

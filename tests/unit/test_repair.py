"""Spikes are removed, small voids are filled, and nothing else changes."""

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from skyline.errors import InputError
from skyline.terrain.repair import RepairRules, fill_voids, remove_spikes, repair

SPACING_M = 30.0


@pytest.fixture(params=[1 << 22, 60], ids=["one strip", "many strips"])
def rules(request):
    return RepairRules(strip_samples=request.param)


@pytest.mark.parametrize("spacing_m", [9.0, 30.0])
def test_ridges_of_27_degrees_are_too_steep_in_feet(spacing_m):
    """They rise by half of the distance, and in feet by 1.64 times the distance."""
    across = np.abs(np.arange(600) % 120 - 60.0)
    heights = np.tile(1000.0 + 0.5 * spacing_m * across, (600, 1)).astype(np.float32)
    repair(heights.copy(), "metres", spacing_m)
    with pytest.raises(InputError):
        repair(heights / np.float32(0.3048), "feet", spacing_m)


def rugged(rows=40, cols=50):
    row, col = np.mgrid[0:rows, 0:cols].astype(np.float32)
    return 1500.0 + 300.0 * np.sin(row / 5.0) * np.cos(col / 7.0) + 8.0 * row


def despiked(heights, rules, spacing_m=SPACING_M):
    cleaned = heights.copy()
    count = remove_spikes(cleaned, spacing_m, rules)
    assert count == np.count_nonzero(np.isnan(cleaned)) - np.count_nonzero(np.isnan(heights))
    return cleaned


@pytest.mark.parametrize("height_m", [32767.0, -32767.0, 1e30, 700.0, -700.0])
@pytest.mark.parametrize("place", [(20, 25), (0, 25), (39, 49), (0, 0), (1, 10)])
def test_a_spike_is_removed_and_nothing_else(height_m, place, rules):
    heights = rugged()
    heights[place] += height_m
    assert np.argwhere(np.isnan(despiked(heights, rules))).tolist() == [list(place)]


@pytest.mark.parametrize(
    "clump", [[(0, 0), (0, 1)], [(0, 0), (1, 1)], [(0, 0), (0, 1), (1, 0), (1, 1)]]
)
@pytest.mark.parametrize("even", [True, False])
def test_clumps_of_spikes_are_removed(clump, even, rules):
    heights = rugged()
    places = [(17 + r, 22 + c) for r, c in clump]
    for number, place in enumerate(places):
        heights[place] += 900.0 if even else 900.0 + 400.0 * number
    assert [tuple(p) for p in np.argwhere(np.isnan(despiked(heights, rules)))] == places


def test_a_pinnacle_among_ledges_is_ground(rules):
    """A pinnacle in a ring of ledges, each 50 m above the one before, high above the sea."""
    heights = np.full((9, 9), 3000.0, dtype=np.float32)
    ring = [(3, 3), (3, 4), (3, 5), (4, 5), (5, 5), (5, 4), (5, 3), (4, 3)]
    for number, place in enumerate(ring):
        heights[place] += 50.0 * number
    heights[4, 4] += 500.0
    np.testing.assert_array_equal(despiked(heights, rules), heights)


def cone(slope):
    row, col = np.mgrid[-15:16, -15:16]
    return (4000.0 - slope * SPACING_M * np.hypot(row, col)).astype(np.float32)


def block(where, height_m):
    heights = np.zeros((30, 30), dtype=np.float32)
    heights[where] = height_m
    return heights


def arete():
    """A wall of one sample, 500 m over its feet on either side, with both ends inside the map."""
    return block(np.s_[15, 5:25], 500.0)


CLIFF, MESA = block(np.s_[:, 15:], 3000.0), block(np.s_[10:13, 10:13], 1000.0)


@pytest.mark.parametrize(
    "terrain", [cone(1.0), cone(2.4), CLIFF, CLIFF.T.copy(), arete(), MESA, -arete()]
)
def test_real_shapes_stay(terrain, rules):
    np.testing.assert_array_equal(despiked(terrain, rules), terrain)


@pytest.mark.parametrize(
    ("path", "spacing_m", "expected"),
    [
        # Pits of 674 and 259 m, one sample each, on gentle slopes of the real tile.
        ("davos/davos_srtm1_30m.tif", 31.0, [(228, 723), (1931, 967)]),
        # Two samples 300 to 1100 m below their surroundings at the edge of a void.
        ("everest/mt_everest_90m.tif", 92.0, [(5, 135), (5, 136)]),
        ("tirol/avaAlr.tif", 5.0, []),
        ("sierra/sierra_ansel_adams_30m_albers.tif", 30.0, []),
    ],
)
def test_real_terrain_stays(shared_data, path, spacing_m, expected):
    rules = RepairRules(strip_samples=1 << 18)
    with rasterio.open(shared_data / path) as dataset:
        heights = dataset.read(1, masked=True).astype(np.float32).filled(np.nan)
    cleaned = despiked(heights, rules, spacing_m)
    changed = np.isnan(cleaned) & ~np.isnan(heights)
    assert [tuple(place) for place in np.argwhere(changed)] == expected
    # All planted spikes are found, and no others.
    planted = np.zeros(heights.shape, dtype=bool)
    planted[25:-25:60, 25:-25:60] = True
    planted &= ~ndimage.binary_dilation(np.isnan(cleaned), np.ones((3, 3)))
    heights[planted] += 2500.0
    changed = np.isnan(despiked(heights, rules, spacing_m)) & ~np.isnan(heights)
    assert np.count_nonzero(planted) > 20
    np.testing.assert_array_equal(changed, planted | (np.isnan(cleaned) & ~np.isnan(heights)))


@pytest.mark.parametrize("strip_samples", [1 << 22, 60])
@given(void=hnp.arrays(np.bool_, st.tuples(*[st.integers(1, 12)] * 2)), limit=st.integers(0, 12))
def test_voids_are_filled_by_size(void, limit, strip_samples):
    heights = np.random.default_rng(1).uniform(0, 100, void.shape).astype(np.float32)
    heights[void] = np.nan
    before = heights.copy()
    filled = fill_voids(heights, RepairRules(max_void_samples=limit, strip_samples=strip_samples))
    label, _ = ndimage.label(void)
    small = void & (np.bincount(label.ravel())[label] <= limit) & (not void.all())
    np.testing.assert_array_equal(np.isnan(heights), void & ~small)
    np.testing.assert_array_equal(heights[~void], before[~void])
    assert filled == np.count_nonzero(small)
    if filled:
        assert np.nanmin(before) - 1e-3 <= heights[small].min()
        assert heights[small].max() <= np.nanmax(before) + 1e-3


def test_filling_is_the_mean_of_neighbours(rules):
    void = np.zeros((20, 20), dtype=bool)
    void[5:10, 4:12] = True
    void[9:14, 8:10] = True
    rough = np.random.default_rng(2).uniform(0, 900, void.shape).astype(np.float32)
    rough[void] = np.nan
    fill_voids(rough, rules)
    cross = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]]) / 4.0
    mean = ndimage.convolve(rough.astype(np.float64), cross)
    np.testing.assert_allclose(rough[void], mean[void], atol=1e-3)


def test_samples_that_no_file_covers_are_neither_filled_nor_a_rim(rules):
    heights = np.full((9, 9), 10.0, dtype=np.float32)
    heights[:, 6:] = np.inf
    heights[4, 5] = np.nan
    heights[0, 7] = np.nan  # a void with nothing known beside it
    assert fill_voids(heights, rules) == 1
    assert heights[4, 5] == pytest.approx(10.0)
    assert np.isnan(heights[0, 7])
    assert np.count_nonzero(np.isposinf(heights)) == 26

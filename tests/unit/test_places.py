"""Places: the skylines that their bytes are decoded to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from place_scenes import places_of

from skyline.store.places import BINS, DISTANCE_BINS, RISES, decode_rises, encode_rises

NOISE = st.floats(-0.25, 0.25, width=32)


@given(arrays.arrays(np.float32, (4, BINS), elements=NOISE), st.floats(-1.0, 2.0))
@settings(max_examples=25)
def test_a_tangent_is_within_half_a_step_of_its_rise(noise, level):
    y = (noise * np.float32(0.5) + np.float32(level)).astype(np.float32)
    first, rise = encode_rises(y)
    back = decode_rises(first, rise)
    # Steps grow with the rise they are of; no rise here is beyond the greatest.
    taken = np.abs(RISES[rise.view(np.uint8)])
    half = 0.5 * (0.036 * taken + 0.00022) * 1.02
    assert (np.abs(back - y) <= half + 1e-5).all()


def test_a_cliff_is_made_up_for():
    y = np.zeros((1, BINS), dtype=np.float32)
    y[:, 100:] = 3.0
    back = decode_rises(*encode_rises(y))
    assert np.abs(back[0, :100]).max() < 1e-3
    assert np.abs(back[0, 107:] - 3.0).max() < 1e-3


@pytest.mark.parametrize(("start", "stop"), [(0, 3), (100, 140), (BINS - 2, BINS), (0, BINS)])
def test_gaps_stay_gaps_and_change_nothing_else(start, stop):
    y = np.sin(np.arange(BINS) / 17.0)[np.newaxis].astype(np.float32) * 0.1
    y[:, start:stop] = np.nan
    back = decode_rises(*encode_rises(y))
    np.testing.assert_array_equal(np.isnan(back), np.isnan(y))
    if np.isfinite(y).any():
        assert np.nanmax(np.abs(back - y)) < 0.002


def test_a_distance_is_the_nearest_of_its_bins_to_a_fortieth():
    generator = np.random.default_rng(0)
    metres = np.exp(generator.uniform(np.log(2.0), np.log(3e5), (5, BINS)))
    metres[:, 30:36] = np.nan
    places = places_of(np.where(np.isnan(metres), np.nan, 0.1), metres)
    nearest = np.fmin.reduce(metres.reshape(5, DISTANCE_BINS, -1), axis=2)
    back = places.distance_m()
    np.testing.assert_array_equal(np.isnan(back), np.isnan(nearest))
    known = np.isfinite(nearest)
    np.testing.assert_allclose(back[known], nearest[known], rtol=0.0255)

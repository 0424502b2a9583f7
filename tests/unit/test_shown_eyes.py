"""The eyes of a store of places."""

import numpy as np
import pytest
from place_scenes import AZIMUTH_DEG, Blocks, curve, places_of

from skyline.match import scene


@pytest.mark.parametrize("size", [1, 3, 7, 23, 100])
@pytest.mark.parametrize("shown", [1, 4, 10, 23, 1000])
def test_every_nth_eye_is_shown_whatever_the_blocks(monkeypatch, size, shown):
    places = places_of(np.tile(curve(1, AZIMUTH_DEG), (23, 1)))
    monkeypatch.setattr(scene, "_SHOWN_EYES", shown)
    eyes = scene._spaced(Blocks(places, size))
    step = max(1, 23 // shown)
    np.testing.assert_array_equal(eyes.easting_m, places.easting_m[::step])
    np.testing.assert_array_equal(eyes.northing_m, places.northing_m[::step])
    np.testing.assert_array_equal(eyes.eye_elevation_m, places.eye_elevation_m[::step])


def test_no_places_show_no_eyes():
    none = places_of(curve(1, AZIMUTH_DEG)[np.newaxis])[:0]
    assert len(scene._spaced(Blocks(none, 5))) == 0

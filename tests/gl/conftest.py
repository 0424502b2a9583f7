"""Every OpenGL test must leave no OpenGL error behind."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.terrain.viewpoints import stand_on


@pytest.fixture(autouse=True)
def every_test(no_gl_error):
    """Fail a test during which OpenGL recorded an error."""


@pytest.fixture(scope="module")
def rough():
    """A rough field with holes, and twelve eyes on it."""
    heights = fractal(90, 70, relief_m=700.0, seed=3)
    heights[20:26, 30:41] = np.nan
    heights[60, 10:50] = np.nan
    heights[85:, :8] = np.nan
    field = field_of(heights, 30.0)
    place = np.random.default_rng(5)
    row, col = place.uniform(2, 80, 40), place.uniform(10, 66, 40)
    easting, northing = field.to_map(row, col)
    there = np.flatnonzero(~np.isnan(field.height_at(easting_m=easting, northing_m=northing)))[:12]
    return field, stand_on(field, easting_m=easting[there], northing_m=northing[there])

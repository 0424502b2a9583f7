"""Every OpenGL test must leave no OpenGL error behind."""

import numpy as np
import pytest
from scenes import SPACING_M, field_of, fractal, scattered, write_dem

from skyline import read_dem
from skyline.render.context import held_context


@pytest.fixture(autouse=True)
def every_test(no_gl_error):
    """Fail a test during which OpenGL recorded an error."""


@pytest.fixture(scope="session")
def is_hardware():
    """Whether a GPU renders; seen on an NVIDIA H100, driver 580."""
    with held_context() as context:
        return not context.software


@pytest.fixture(scope="module")
def rough():
    """A rough field with holes, and twelve eyes on it."""
    heights = fractal(90, 70, relief_m=700.0, seed=3)
    heights[20:26, 30:41] = np.nan
    heights[60, 10:50] = np.nan
    heights[85:, :8] = np.nan
    field = field_of(heights, 30.0)
    return field, scattered(field, 12, 5, (300.0, -2400.0, 1980.0, -60.0))


@pytest.fixture(scope="package")
def uneven():
    """Three fields, each rougher than the one before, and eight eyes on each."""
    fields = [field_of(fractal(120, 120, 200.0 * (1 + seed), seed)) for seed in range(3)]
    return [(field, scattered(field, 8, seed)) for seed, field in enumerate(fields)]


@pytest.fixture(scope="package")
def terrain(tmp_path_factory):
    """Hills within a ring of mountains, so that no skyline lies on the data's border."""
    heights = fractal(280, 280, relief_m=1200.0, seed=11, exponent=2.2)
    across = SPACING_M * (np.arange(280) - 139.5)
    ring_m = np.hypot(across, across[:, np.newaxis]) - 3300.0
    heights = heights + 900.0 * np.exp(-((ring_m / 500.0) ** 2))
    path = tmp_path_factory.mktemp("dem") / "dem.tif"
    return read_dem([write_dem(path, heights.astype(np.float32))])

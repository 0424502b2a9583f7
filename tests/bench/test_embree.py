"""The Embree peer answers for the same surface and the same physics as the oracle."""

import builtins

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.skylines import FLAG_HOLE
from skyline.terrain.viewpoints import stand_on
from skyline_bench.peers.embree import EmbreePeer, is_installed
from skyline_bench.truth import oracle

needs_embree = pytest.mark.skipif(not is_installed(), reason="embreex is not installed")

BALL = Curvature(radius_m=200_000.0, refraction_k=0.13)
"""So small a planet that leaving out its curvature, or its shear, costs hundreds of pixels."""

WIDTH = 65

ROUNDING_TAN = 4e-5
"""Eyes are float32, so they move by up to 6e-5 m here, and the nearest skylines are at 5 m."""


def random_viewpoints(field, count, seed=1, eye_height_m=2.0):
    generator = np.random.default_rng(seed)
    west, south, east, north = field.bounds_m
    easting, northing = generator.uniform(west, east, 99), generator.uniform(south, north, 99)
    standing = ~np.isnan(field.height_at(easting_m=easting, northing_m=northing))
    return stand_on(
        field,
        easting_m=easting[standing][:count],
        northing_m=northing[standing][:count],
        eye_height_m=eye_height_m,
    )


def error_tan(field, viewpoints, depth, curvature):
    views = EmbreePeer(field, WIDTH, curvature).render(viewpoints, depth)
    truth = oracle.skyline(field, viewpoints, WIDTH, curvature)
    np.testing.assert_array_equal(views.heading, truth.heading)
    np.testing.assert_array_equal(np.isnan(views.elevation_tan), np.isnan(truth.elevation_tan))
    return np.nan_to_num(np.abs(views.elevation_tan - truth.elevation_tan))


@needs_embree
@pytest.mark.parametrize("depth", [6, 10, 16])
def test_error_is_half_the_last_bracket(depth):
    field = field_of(fractal(70, 90, 900.0, seed=2), 30.0, 25.0, west_m=6e5, north_m=5e6)
    found = error_tan(field, random_viewpoints(field, 12), depth, BALL)
    assert found.max() <= 2.0**-depth + ROUNDING_TAN
    assert found.max() > 2.0**-depth / 2.0


@needs_embree
def test_columns_clear_of_holes_are_exact():
    # Over a hole a low ray may slip under the terrain behind, so that nothing can be bisected.
    heights = fractal(60, 60, 300.0, seed=9)
    heights[20:35, 10:40] = np.nan
    field = field_of(heights)
    viewpoints = random_viewpoints(field, 6)
    views = EmbreePeer(field, WIDTH).render(viewpoints, 14)
    truth = oracle.skyline(field, viewpoints, WIDTH)
    clear = (truth.flags & FLAG_HOLE) == 0
    assert 0.3 < clear.mean() < 0.9
    error = np.abs(views.elevation_tan - truth.elevation_tan)[clear]
    assert error.max() <= 2.0**-14 + ROUNDING_TAN


def test_without_embree_the_extra_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **named):
        if name.startswith("embreex"):
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"skyline-bench\[peers\]"):
        EmbreePeer(field_of(fractal(10, 10)))

"""The Embree peer answers for the same surface and the same physics as the oracle."""

import builtins

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.skylines import FLAG_HOLE, FLAG_NO_DATA
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
def test_walls_beyond_the_field_of_view_and_dips_are_found():
    heights = fractal(50, 50, 30.0, seed=6).astype(np.float64)
    heights[:24] += 900.0
    field = field_of(heights, 10.0)
    for northing, eye_height, lowest, highest in [
        (-262.0, 2.0, 0.1, 27.0),
        (-200.0, 800.0, -6.0, -4.0),
    ]:
        viewpoints = stand_on(
            field, easting_m=[250.0], northing_m=[northing], eye_height_m=eye_height
        )
        truth = oracle.skyline(field, viewpoints, WIDTH).elevation_tan
        assert truth.min() < lowest
        assert truth.max() > highest
        found = error_tan(field, viewpoints, 16, Curvature())
        assert found.max() <= 2.0**-16 + ROUNDING_TAN


@needs_embree
def test_where_there_is_no_data_there_is_no_value():
    field = field_of(fractal(60, 60, 300.0, seed=9))
    on_the_border = stand_on(field, easting_m=[905.0], northing_m=[0.0])
    views = EmbreePeer(field, WIDTH).render(on_the_border, 14)
    truth = oracle.skyline(field, on_the_border, WIDTH)
    north, south = 0, 2
    assert np.isnan(truth.elevation_tan[north]).all()
    assert np.isnan(views.elevation_tan[north]).all()
    assert (views.flags[north] == FLAG_NO_DATA).all()
    error = np.abs(views.elevation_tan - truth.elevation_tan)[south]
    assert error.max() <= 2.0**-14 + ROUNDING_TAN


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


@needs_embree
def test_bad_depths_are_refused():
    field = field_of(fractal(10, 10))
    none = stand_on(field, easting_m=[90.0], northing_m=[-90.0])[:0]
    assert len(EmbreePeer(field, WIDTH).render(none, 8)) == 0
    with pytest.raises(InputError, match="depth is 0"):
        EmbreePeer(field, WIDTH).render(none, 0)


def test_without_embree_the_extra_is_named(monkeypatch):
    real = builtins.__import__

    def without(name, *rest, **named):
        if name.startswith("embreex"):
            raise ImportError(name)
        return real(name, *rest, **named)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"skyline-bench\[peers\]"):
        EmbreePeer(field_of(fractal(10, 10)))

"""The horizon rasterizer against the oracle, on every path through its code."""

import math
from unittest.mock import Mock

import moderngl
import numpy as np
import pytest
from scenes import at_m, field_of

from skyline.errors import ContextError, InputError
from skyline.geodesy.earth import Curvature
from skyline.render.context import held_context
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED, Views, columns_u
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.truth import oracle

EXACT_PX = 0.001
"""Rounding of float32 on these scenes; the worst seen is 2e-4."""


def render(field, eyes, width=160):
    with HorizonRenderer(field, RenderConfig(width)) as renderer:
        return renderer.render(eyes)


def test_equals_the_oracle_flags_and_depths_too(rough, is_hardware):
    field, eyes = rough
    truth, views = oracle.skyline(field, eyes, 160), render(field, eyes)
    off = {"rtol": 0.0, "atol": EXACT_PX * 2.0 / 640.0}
    np.testing.assert_allclose(views.v, truth.v, **off)
    np.testing.assert_array_equal(views.flags, truth.flags)
    assert (views.flags & FLAG_HOLE).any()
    assert (views.flags & FLAG_TRUNCATED).any()
    # A GPU may divide with an error of 2.5 units in the last place, which counts where a ray grazes
    # an edge: 5e-5 in one column of 7,680.
    rtol = 1e-4 if is_hardware else 1e-5
    np.testing.assert_allclose(views.depth_m, truth.depth_m, rtol=rtol)


def test_a_field_loaded_before_is_not_loaded_again(rough):
    field, eyes = rough
    with HorizonRenderer(field, RenderConfig(160)) as renderer:
        renderer.load()
        with held_context() as context:
            loaded = [one for (of, _), one in context.shared.items() if of == id(field)]
            views = renderer.render(eyes)
            again = [one for (of, _), one in context.shared.items() if of == id(field)]
    assert len(loaded) == 1
    assert again == loaded
    np.testing.assert_array_equal(views.v, render(field, eyes).v)


def test_single_headings(rough):
    field, eyes = rough
    headings = np.arange(len(eyes)) * 3 % 4
    with HorizonRenderer(field, RenderConfig(160)) as renderer:
        some, every = renderer.render(eyes, headings), renderer.render(eyes)
    wanted = every[4 * np.arange(len(eyes)) + headings]
    for name in Views.__slots__:
        assert getattr(some, name).tobytes() == getattr(wanted, name).tobytes(), name


def test_equals_the_oracle_however_steep_the_slopes(uneven):
    for field, eyes in uneven:
        truth = oracle.skyline(field, eyes, 320)
        views = render(field, eyes, 320)
        error_px = np.abs(truth.v - views.v) * 160.0
        assert error_px.max() <= EXACT_PX


@pytest.mark.parametrize("reach", [0.1, 0.5, 1.5])
def test_a_sea_has_its_horizon_wherever_the_model_ends(reach):
    # A tower of 300 m on an island, and a sea that ends before the horizon or goes on past it.
    curvature, eye_m = Curvature(), 300.0
    horizon_m = math.sqrt(eye_m / curvature.drop_per_m2)
    heights = np.zeros((101, 101))
    heights[:50, 50] = 400.0
    field = field_of(heights, reach * horizon_m / 50.0)
    place = at_m(field.to_map(np.array([50.0]), np.array([50.0])))
    eye = Viewpoints(**place, eye_elevation_m=np.array([eye_m]))
    views = render(field, eye)
    dip_deg = np.degrees(np.arctan(-2.0 * math.sqrt(eye_m * curvature.drop_per_m2)))
    at_sea = views.elevation_deg()[2]
    # Flat triangles sag by half a spacing's drop between samples.
    np.testing.assert_allclose(at_sea, dip_deg, atol=1e-3 if reach < 1.0 else 2e-3)
    away_m = np.hypot(1.0, columns_u(views.width)) * views.depth_m[2]
    np.testing.assert_allclose(away_m, horizon_m, rtol=1e-5 if reach < 1.0 else 0.05)
    assert ((views.flags[2] == FLAG_TRUNCATED) == (reach < 1.0)).all()
    assert views.elevation_deg()[0].max() > 0.0
    flat = RenderConfig(160, Curvature(enabled=False))
    with HorizonRenderer(field, flat) as renderer:
        # A flat Earth ends where the model does.
        np.testing.assert_allclose(renderer.render(eye).depth_m[2], reach * horizon_m, rtol=1e-5)


def test_samples_much_longer_than_wide_are_refused():
    with pytest.raises(InputError, match="resample the DEM"):
        HorizonRenderer(field_of(np.zeros((3, 3)), 1.0, 100.0), RenderConfig())


def test_a_gpu_without_memory_is_one_line(rough, monkeypatch):
    field, eyes = rough
    full = Mock(side_effect=moderngl.Error("cannot create buffer"))
    config = RenderConfig(320)
    with HorizonRenderer(field, config) as renderer, monkeypatch.context() as patched:
        patched.setattr(moderngl.Context, "buffer", full)
        with pytest.raises(ContextError, match=r"no room for skylines .* choose a smaller width"):
            renderer.render(eyes)

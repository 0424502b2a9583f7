"""The horizon rasterizer against the oracle, by every way it can go."""

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import ContextError, InputError
from skyline.geodesy import Curvature
from skyline.render import horizon, windows
from skyline.render.depth import QUANTIZATION_PX, DepthRenderer
from skyline.render.horizon import HorizonRenderer
from skyline.render.march import ComputeMarcher, FragmentMarcher
from skyline.terrain.viewpoints import stand_on
from skyline.views import FLAG_HOLE, FLAG_TRUNCATED, Views
from skyline_bench.truth import oracle

EXACT_PX = 0.001
"""Rounding of float32 on these scenes; the worst seen is 2e-4."""


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
    there = np.flatnonzero(~np.isnan(field.height_at(easting, northing)))[:12]
    return field, stand_on(field, easting[there], northing[there])


def render(field, eyes, width=160, **options):
    with HorizonRenderer(field, width, **options) as renderer:
        return renderer.render(eyes)


def error_px(views, truth, width=640):
    assert (np.isnan(views.elevation_tan) == np.isnan(truth.elevation_tan)).all()
    return np.nanmax(np.abs(views.elevation_tan - truth.elevation_tan), initial=0.0) * width / 2.0


def assert_same(first, second):
    for name in Views.__slots__:
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes(), name


def test_equals_the_oracle_flags_and_depths_too(rough):
    field, eyes = rough
    truth, views = oracle.skyline(field, eyes, 160), render(field, eyes)
    assert error_px(views, truth) < EXACT_PX
    np.testing.assert_array_equal(views.flags, truth.flags)
    assert (views.flags & FLAG_HOLE).any()
    assert (views.flags & FLAG_TRUNCATED).any()
    np.testing.assert_allclose(views.depth_m, truth.depth_m, rtol=1e-5)


def test_fragment_and_compute_shaders_agree(rough, monkeypatch):
    field, eyes = rough
    edges = [0.0, 300.0, 900.0, 5000.0]
    with_compute = render(field, eyes, shell_edges_m=edges, reach_m=50.0)
    monkeypatch.setattr(horizon, "ComputeMarcher", FragmentMarcher)
    without = render(field, eyes, shell_edges_m=edges, reach_m=50.0)
    assert error_px(without, with_compute) < EXACT_PX
    np.testing.assert_array_equal(without.flags, with_compute.flags)
    np.testing.assert_allclose(
        without.shells.elevation_tan, with_compute.shells.elevation_tan, atol=1e-5
    )


def test_windows_of_a_large_field_give_the_same_skylines(rough, monkeypatch):
    field, eyes = rough
    edges = [0.0, 300.0, 900.0, 5000.0]
    whole = render(field, eyes, shell_edges_m=edges)
    monkeypatch.setattr(windows, "MAX_FIELD_CELLS", 30)
    monkeypatch.setattr(windows, "MAX_WINDOW_CELLS", 23)
    monkeypatch.setattr(horizon, "_RESIDENT_SAMPLES", 2000)
    cut = render(field, eyes, shell_edges_m=edges)
    assert_same(cut, whole)
    assert cut.shells.elevation_tan.tobytes() == whole.shells.elevation_tan.tobytes()


def test_windows_that_cannot_rise_are_not_loaded(monkeypatch):
    monkeypatch.setattr(windows, "MAX_FIELD_CELLS", 30)
    monkeypatch.setattr(windows, "MAX_WINDOW_CELLS", 20)
    heights = np.zeros((81, 81), dtype=np.float32)
    heights[2:19, [2, 18]] = heights[[2, 18], 2:19] = 500.0
    field = field_of(heights, 30.0)
    with HorizonRenderer(field, 64) as renderer:
        renderer.render(stand_on(field, 300.0, -300.0))
        assert [(window.row, window.col) for window in renderer._resident] == [(0, 0)]
        renderer.render(stand_on(field, 1200.0, -1200.0))
        assert len(renderer._resident) > 10


def test_many_columns_a_lane_or_few(rough, monkeypatch):
    field, eyes = rough
    alone = [render(field, eyes[index : index + 1], 640) for index in range(3)]
    together = render(field, eyes, 640)
    monkeypatch.setattr(ComputeMarcher, "_run", lambda self, eyes: 7)
    odd = render(field, eyes, 640)
    assert_same(odd, together)
    for index, views in enumerate(alone):
        assert_same(views, together[4 * index : 4 * index + 4])


def test_single_headings(rough):
    field, eyes = rough
    headings = np.arange(len(eyes)) * 3 % 4
    with HorizonRenderer(field, 160) as renderer:
        some, every = renderer.render(eyes, headings), renderer.render(eyes)
    assert_same(some, every[4 * np.arange(len(eyes)) + headings])


@pytest.mark.parametrize("tolerance_px", [0.1, 1.0, 5.0])
def test_falls_short_by_no_more_than_the_tolerance(tolerance_px):
    for seed in range(6):
        field = field_of(fractal(120, 120, relief_m=200.0 * (1 + seed), seed=seed), 30.0)
        place = np.random.default_rng(seed)
        eyes = stand_on(field, place.uniform(100, 3400, 8), place.uniform(-3400, -100, 8))
        truth = oracle.skyline(field, eyes, 320)
        views = render(field, eyes, 320, tolerance_px=tolerance_px)
        short = (truth.elevation_tan - views.elevation_tan) * 160.0
        assert short.min() > -EXACT_PX
        assert short.max() <= tolerance_px + EXACT_PX


def test_shells_envelope_is_the_skyline(rough):
    field, eyes = rough
    views = render(field, eyes, shell_edges_m=[0.0, 100.0, 400.0, 1000.0, 1e5])
    envelope = np.fmax.reduce(views.shells.elevation_tan, axis=1)
    np.testing.assert_array_equal(envelope, views.elevation_tan)
    within = views.shells.depth_m
    for shell, (low, high) in enumerate([(0, 100), (100, 400), (400, 1000), (1000, 1e5)]):
        depth = within[:, shell]
        assert ((depth >= low) & (depth < high))[np.isfinite(depth)].all()


def test_shells_of_walls_behind_one_another():
    """Three walls across the view: each shell sees its own, hidden or not."""
    heights = np.zeros((41, 81), dtype=np.float32)
    for col, height in ((20, 60.0), (40, 50.0), (60, 200.0)):
        heights[:, col] = height
    field = field_of(heights, 30.0)
    eyes = stand_on(field, 150.0, -600.0, 0.0)
    edges = [300.0, 600.0, 1200.0, 1800.0]
    views = render(field, eyes, 65, curvature=Curvature(enabled=False), shell_edges_m=edges)
    east = views.shells.elevation_tan[1, :, 32]
    np.testing.assert_allclose(east, [60 / 450, 50 / 1050, 200 / 1650], rtol=1e-6)
    np.testing.assert_allclose(views.shells.depth_m[1, :, 32], [450, 1050, 1650], rtol=1e-6)


def test_the_ground_underfoot_is_in_no_shell():
    """An eye beside a cell's diagonal meets terrain at once, where a tangent has no bound."""
    field = field_of(np.zeros((41, 41), dtype=np.float32), 90.0)
    west, _, _, north = field.bounds_m
    along_m = 90.0 * (20.0 + np.random.default_rng(0).random(20))
    eyes = stand_on(field, west + along_m + 1e-9, north - along_m)
    views = render(field, eyes, 65, shell_edges_m=[0.0, 20.0, 1e5])
    near, depth_m = views.shells.elevation_tan[:, 0], views.shells.depth_m[:, 0]
    seen = np.isfinite(near)
    assert seen.any()
    # 0.1 m ahead, an eye 2 m high looks down by a tangent of 20; but for float32.
    assert depth_m[seen].min() >= 0.1 * (1.0 - 1e-6)
    assert np.abs(near[seen]).max() <= 20.0 * (1.0 + 1e-6)
    assert np.isfinite(views.shells.elevation_tan[:, 1]).all()


def test_reach_leaves_out_what_stays_hidden_and_nothing_else(rough):
    field, eyes = rough
    edges = np.array([0.0, 100.0, 300.0, 600.0, 1200.0, 5000.0])
    everything = render(field, eyes, shell_edges_m=edges).shells
    views = render(field, eyes, shell_edges_m=edges, reach_m=40.0)
    sky, sky_depth = views.elevation_tan[:, None], views.depth_m[:, None]
    parallax = 1.0 / everything.depth_m + 1.0 / sky_depth
    floor = sky - 0.5 * 40.0 * (1.0 + np.abs(sky)) * parallax
    kept = np.isfinite(views.shells.elevation_tan)
    clear = np.abs(everything.elevation_tan - floor) > 1e-5
    np.testing.assert_array_equal(kept[clear], (everything.elevation_tan > floor)[clear])
    np.testing.assert_array_equal(views.shells.elevation_tan[kept], everything.elevation_tan[kept])
    assert 0.2 < kept.mean() < 0.9


def test_depth_path_agrees_to_its_quantization(rough):
    field, eyes = rough
    with DepthRenderer(field, 160) as renderer:
        quantized = renderer.render(eyes)
    exact = render(field, eyes)
    plain = (exact.flags == 0) & (quantized.flags == 0)
    difference = (quantized.elevation_tan - exact.elevation_tan)[plain] * 80.0
    assert plain.mean() > 0.5
    assert np.abs(difference).max() < QUANTIZATION_PX + EXACT_PX


def test_no_viewpoints_give_no_views(rough):
    field, eyes = rough
    none = render(field, eyes[:0], shell_edges_m=[0.0, 10.0, 20.0])
    assert len(none) == 0
    assert none.elevation_tan.shape == (0, 160)
    assert none.shells.elevation_tan.shape == (0, 2, 160)


def test_out_of_memory_halves_the_batch(rough, monkeypatch, caplog):
    field, eyes = rough
    begin = ComputeMarcher.begin

    def full(self, rows):
        if rows > 8:
            raise horizon.moderngl.Error("cannot create buffer")
        begin(self, rows)

    whole = render(field, eyes)
    monkeypatch.setattr(ComputeMarcher, "begin", full)
    monkeypatch.setattr(FragmentMarcher, "begin", full)
    assert_same(render(field, eyes), whole)
    assert "out of GPU memory" in caplog.text
    monkeypatch.setattr(ComputeMarcher, "begin", lambda self, rows: full(self, 9))
    with pytest.raises(ContextError, match="cannot hold one view"):
        render(field, eyes)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"tolerance_px": -0.1}, "tolerance is -0.1"),
        ({"tolerance_px": np.nan}, "tolerance is nan"),
        ({"width": 0}, "width is 0"),
        ({"shell_edges_m": [0.0, 10.0, 10.0]}, "increasing"),
        ({"shell_edges_m": [5.0]}, "two or more"),
        ({"shell_edges_m": [-5.0, 5.0]}, "at least 0"),
        ({"shell_edges_m": [0.0, 5.0], "reach_m": 0.0}, "reach is 0"),
    ],
)
def test_bad_input_is_refused(rough, options, said):
    with pytest.raises(InputError, match=said):
        HorizonRenderer(rough[0], **options)


def test_bad_headings_and_spacings(rough):
    field, eyes = rough
    with HorizonRenderer(field, 16) as renderer, pytest.raises(InputError, match="one of 0, 1"):
        renderer.render(eyes, [4] * len(eyes))
    with pytest.raises(InputError, match="resample the DEM"):
        HorizonRenderer(field_of(np.zeros((3, 3)), 1.0, 100.0))

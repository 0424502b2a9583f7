"""Horizons against the oracle, in order of azimuth, on every path through their code."""

import numpy as np
import pytest
from scenes import at_m, field_of

from skyline.geodesy.earth import Curvature
from skyline.render.field_windows import GpuLimits, Window, WindowTextures
from skyline.render.horizon import PanoramaRenderer
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED, quadrant_azimuths_rad
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

BINS = 240
EXACT = 0.001 * 2.0 / 640.0
"""Rounding of float32 in tangents on these scenes: a thousandth of a pixel."""


def render(field, eyes, bins=BINS, first_rad=None, limits=None):
    with PanoramaRenderer(field, bins, limits=limits) as renderer:
        return renderer.render(eyes, first_rad)


def true_horizons(field, eyes, bins=BINS):
    """Return tangents of elevation, distances and flags (N, B) of the oracle."""
    off_axis = quadrant_azimuths_rad(bins)
    views = oracle.skyline_at(field, eyes, np.tan(off_axis), Curvature())
    cosine = np.cos(off_axis)
    return tuple(
        np.roll(values.reshape(len(eyes), bins), -bins // 8, axis=1)
        for values in (views.v * cosine, views.depth_m / cosine, views.flags)
    )


def assert_same(first, second):
    for name in ("elevation_tan", "distance_m", "flags"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes(), name


def test_equals_the_oracle_flags_and_distances_too(rough):
    field, eyes = rough
    tan, distance_m, flags = true_horizons(field, eyes)
    horizons = render(field, eyes)
    assert horizons.elevation_tan.shape == (len(eyes), BINS)
    np.testing.assert_allclose(horizons.elevation_tan, tan, rtol=0.0, atol=EXACT)
    np.testing.assert_array_equal(horizons.flags, flags)
    assert (horizons.flags & FLAG_HOLE).any()
    assert (horizons.flags & FLAG_TRUNCATED).any()
    np.testing.assert_allclose(horizons.distance_m, distance_m, rtol=1e-5)
    for name in ("easting_m", "northing_m", "eye_elevation_m"):
        np.testing.assert_array_equal(getattr(horizons, name), getattr(eyes, name))


def test_equals_the_oracle_however_steep_the_slopes(uneven):
    for field, eyes in uneven:
        tan, *_ = true_horizons(field, eyes, 480)
        horizons = render(field, eyes, 480)
        np.testing.assert_allclose(horizons.elevation_tan, tan, rtol=0.0, atol=EXACT)


def test_neither_the_batch_nor_its_order_matters(rough):
    field, eyes = rough
    together = render(field, eyes, 720)
    assert_same(render(field, eyes[::-1], 720)[::-1], together)
    for index in range(3):
        assert_same(render(field, eyes[index : index + 1], 720), together[index : index + 1])
    # A view of 180 columns takes 12 bytes a column: seven views at once.
    seven = GpuLimits(result_bytes=7 * 180 * 12)
    assert_same(render(field, eyes, 720, limits=seven), together)


@pytest.mark.parametrize("first_rad", [None, np.linspace(-8.0, 8.0, 12)], ids=["north", "turned"])
def test_windows_of_a_large_field_give_the_same_horizons(rough, first_rad):
    field, eyes = rough
    few = GpuLimits(field_cells=30, window_cells=23, resident_samples=2000)
    assert len(Window.all_of(field, few)) == 4 * 3
    whole = render(field, eyes, first_rad=first_rad)
    found = render(field, eyes, first_rad=first_rad, limits=few)
    np.testing.assert_array_equal(found.elevation_tan, whole.elevation_tan)
    np.testing.assert_array_equal(found.distance_m, whole.distance_m)
    np.testing.assert_array_equal(found.flags | FLAG_HOLE, whole.flags | FLAG_HOLE)
    # Holes are not looked for in windows that are too low to be seen.
    in_whole = (whole.flags & FLAG_HOLE).astype(bool)
    assert (found.flags & FLAG_HOLE)[in_whole].any()
    assert not (found.flags & FLAG_HOLE)[~in_whole].any()


def test_an_eye_sees_the_same_through_windows_in_any_batch(rough):
    field, eyes = rough
    few = GpuLimits(field_cells=30, window_cells=23)
    together = render(field, eyes, limits=few)
    for index in range(len(eyes)):
        alone = render(field, eyes[index : index + 1], limits=few)
        assert_same(alone, together[index : index + 1])


def test_terrain_behind_a_near_rim_is_not_loaded(monkeypatch):
    """Seven by seven windows of 20 cells: 500 m all over, and a rim of 1,000 m round the middle."""
    heights = np.full((141, 141), 500.0, dtype=np.float32)
    heights[50:91, 50:91] = 1000.0
    heights[60:81, 60:81] = 0.0
    field = field_of(heights, 30.0)
    loaded = []
    shared = WindowTextures.shared
    monkeypatch.setattr(
        WindowTextures, "shared", lambda *given: (loaded.append(given[-1]), shared(*given))[1]
    )
    tiles = GpuLimits(field_cells=20, window_cells=20)
    with PanoramaRenderer(field, BINS, limits=tiles) as renderer:
        horizons = renderer.render(stand_on(field, **at_m(field.to_map(70, 70))))
    assert (horizons.elevation_tan > 2.0).all()
    assert len(loaded) == 9
    assert all(40 <= window.row <= 80 and 40 <= window.col <= 80 for window in loaded)


@pytest.mark.slow
def test_the_largest_window_sees_its_holes():
    # Four trees of marks, one over the other, would be higher than many a GPU's textures.
    cells = GpuLimits().field_cells
    away = np.hypot(*np.ogrid[-cells // 2 : cells // 2 + 1, -cells // 2 : cells // 2 + 1])
    heights = (0.5 * away).astype(np.float32)
    heights[(away > 300.0) & (away < 310.0)] = np.nan
    field = field_of(heights, 30.0)
    assert len(Window.all_of(field, GpuLimits())) == 1
    with PanoramaRenderer(field, BINS) as renderer:
        horizons = renderer.render(stand_on(field, **at_m(field.to_map(cells / 2, cells / 2))))
    assert (horizons.flags & FLAG_HOLE == FLAG_HOLE).all()

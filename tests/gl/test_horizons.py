"""Horizons against the oracle, in order of azimuth, on every path through their code."""

import numpy as np
import pytest
from scenes import at_m, field_of

from skyline.geodesy import Curvature
from skyline.render import march, windows
from skyline.render.horizon import PanoramaRenderer
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED, quadrant_azimuths_rad
from skyline.terrain.eyes import stand_on
from skyline_bench.truth import oracle

BINS = 240
EXACT = 0.001 * 2.0 / 640.0
"""Rounding of float32 in tangents on these scenes: a thousandth of a pixel."""


def render(field, eyes, bins=BINS, tolerance_deg=0.0, first_rad=None):
    with PanoramaRenderer(field, bins, tolerance_deg=tolerance_deg) as renderer:
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


@pytest.mark.parametrize("tolerance_deg", [0.01, 1.0])
def test_falls_short_by_no_more_than_the_tolerance(uneven, tolerance_deg):
    for field, eyes in uneven:
        tan, *_ = true_horizons(field, eyes, 480)
        horizons = render(field, eyes, 480, tolerance_deg)
        short = np.degrees(np.arctan(tan) - np.arctan(horizons.elevation_tan))
        assert short.min() >= -np.degrees(EXACT)
        assert short.max() <= tolerance_deg + np.degrees(EXACT)


def test_neither_the_batch_nor_its_order_matters(rough, monkeypatch):
    field, eyes = rough
    together = render(field, eyes, 720, 0.05)
    assert_same(render(field, eyes[::-1], 720, 0.05)[::-1], together)
    for index in range(3):
        assert_same(render(field, eyes[index : index + 1], 720, 0.05), together[index : index + 1])
    with PanoramaRenderer(field, 720, tolerance_deg=0.05) as renderer:
        renderer._max_views = 7
        assert_same(renderer.render(eyes), together)


@pytest.mark.parametrize("first_rad", [None, np.linspace(-8.0, 8.0, 12)], ids=["north", "turned"])
def test_windows_of_a_large_field_give_the_same_horizons(rough, monkeypatch, first_rad):
    field, eyes = rough
    whole = render(field, eyes, first_rad=first_rad)
    monkeypatch.setattr(windows, "MAX_FIELD_CELLS", 30)
    monkeypatch.setattr(windows, "MAX_WINDOW_CELLS", 23)
    monkeypatch.setattr(march, "_RESIDENT_SAMPLES", 2000)
    assert_same(render(field, eyes, first_rad=first_rad), whole)


@pytest.mark.slow
def test_the_largest_window_sees_its_holes():
    # Four trees of marks, one over the other, would be higher than many a GPU's textures.
    cells = windows.MAX_FIELD_CELLS
    away = np.hypot(*np.ogrid[-cells // 2 : cells // 2 + 1, -cells // 2 : cells // 2 + 1])
    heights = (0.5 * away).astype(np.float32)
    heights[(away > 300.0) & (away < 310.0)] = np.nan
    field = field_of(heights, 30.0)
    assert len(windows.Window.all_of(field)) == 1
    with PanoramaRenderer(field, BINS) as renderer:
        horizons = renderer.render(stand_on(field, **at_m(field.to_map(cells / 2, cells / 2))))
    assert (horizons.flags & FLAG_HOLE == FLAG_HOLE).all()

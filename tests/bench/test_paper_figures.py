"""The paper's figures on small terrains: what is chosen to be drawn, and that it is drawn."""

import io

import numpy as np
import pytest
from PIL import Image
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.pipeline import PlaceConfig, RenderConfig
from skyline_bench.figures.small_png import SMALL_BYTES, encode_small_png
from skyline_bench.figures.stores import (
    draw_viewpoints,
    draw_worked_query,
    fits_landscape,
    work_query,
)
from skyline_bench.figures.views import draw_pairs, figure_1, figure_2, figure_4
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.stores.reference import place_store, uniform_store

pytestmark = pytest.mark.usefixtures("no_gl_error")

AREA_M = (600.0, 600.0, 2900.0, 2900.0)


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(120, 120, relief_m=500.0, seed=6), 30.0, north_m=3600.0)


@pytest.fixture(scope="module")
def pairs(terrain):
    return draw_pairs(terrain, AREA_M, 30.0, 25, seed=4)


def drawn(figure):
    """Return a figure's pixels, if it is as small as is asked of it."""
    data = encode_small_png(figure)
    assert len(data) <= SMALL_BYTES
    picture = np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)
    assert picture.std() > 15.0
    return picture


def like(picture, rgb, within=60):
    return np.abs(picture - np.array(rgb)).sum(axis=-1) < within


def test_pairs_are_as_far_apart_as_asked_and_inside(pairs):
    east, north = (
        getattr(pairs.one, name) - getattr(pairs.other, name)
        for name in ("easting_m", "northing_m")
    )
    np.testing.assert_allclose(np.hypot(east, north), 30.0, atol=1e-6)
    assert len(pairs.one) == 4 * 25
    np.testing.assert_array_equal(pairs.one.heading, pairs.other.heading)
    assert pairs.one.easting_m.min() >= AREA_M[0]
    assert pairs.one.northing_m.max() <= AREA_M[3]


def test_the_most_different_pair_is_drawn(terrain, pairs):
    figure, caption = figure_1(terrain, pairs)
    worst = np.nanmax(pairs.distance_px())
    assert f"{worst:.0f} px" in caption
    picture = drawn(figure)
    for colour in ((0, 114, 178), (213, 94, 0)):
        assert like(picture, colour).sum() > 200


def test_a_pair_out_of_the_image_is_not_chosen(terrain, pairs):
    distance = pairs.distance_px()
    high = (np.abs(pairs.one.elevation_tan) >= 0.95).any(axis=1)
    assert np.isnan(distance[high]).all()


def test_a_depth_image_and_its_skyline_are_drawn(terrain, pairs):
    figure, caption = figure_2(terrain, pairs.one)
    assert "first pixel" in caption
    picture = drawn(figure)
    assert like(picture, (227, 236, 246), 20).sum() > 2000


def test_the_affine_map_brings_skylines_together(terrain):
    figure, caption = figure_4(draw_pairs(terrain, AREA_M, 100.0, 25, seed=4))
    plain, affine = (
        float(axis.get_title().split("distance ")[1].split()[0]) for axis in figure.axes
    )
    assert affine < 0.5 * plain
    assert f"{plain:.1f} px from one another" in caption
    picture = drawn(figure)
    assert like(picture, (0, 158, 115)).sum() > 200


def test_an_area_of_holes_is_refused(terrain):
    heights = np.full((20, 20), np.nan, dtype=np.float32)
    heights[0] = 0.0
    with pytest.raises(InputError, match="no two places"):
        draw_pairs(field_of(heights, 30.0), (100.0, -500.0, 500.0, -300.0), 30.0, 5)


@pytest.fixture(scope="module")
def store(terrain, tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    return uniform_store(terrain, folder, 500.0, None, RenderConfig(width=320))


def test_viewpoints_are_drawn_for_each_heading(terrain, store):
    figure, caption = draw_viewpoints(terrain, AREA_M, store)
    assert len(figure.axes) == 4
    each = store.renderings // 4
    assert f"{each}, {each}, {each}, {each} of {store.renderings}" in caption
    for axis in figure.axes:
        assert axis.get_xlim() == (AREA_M[0], AREA_M[2])
        assert axis.get_ylim() == (AREA_M[1], AREA_M[3])
    drawn(figure)


@pytest.mark.slow
def test_a_query_is_worked_from_its_photograph(terrain, tmp_path):
    store = place_store(terrain, tmp_path, 300.0, None, PlaceConfig())
    config = QueryConfig(width_px=360, height_px=540, render_width=1280)
    query = next(one for one in make_queries(terrain, AREA_M, 12, 2, config) if fits_landscape(one))
    worked = work_query(terrain, store, query, 0)
    assert worked.photo.shape == (240, 360, 3)
    # The photograph is the middle of the query's picture, so is the skyline found in it.
    shift = (540 - 240) / 2
    both = worked.found.trusted & np.isfinite(query.row_px)
    assert both.sum() > 200
    off = np.abs(worked.found.row_px + shift - query.row_px)[both]
    assert np.median(off) < 1.5
    figure, caption = draw_worked_query(terrain, AREA_M, worked)
    assert "m and" in caption
    picture = drawn(figure)
    assert like(picture, (209, 16, 61)).sum() > 20
    assert like(picture, (0, 114, 178)).sum() > 20

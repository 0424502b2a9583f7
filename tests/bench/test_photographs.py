"""Drawn photographs: the skyline in them, and what stands in front."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.photo.read import extract_photo
from skyline.render.depth import DepthRenderer
from skyline_bench.queries.made_photos import Scenery, draw_photo
from skyline_bench.queries.synthetic import QueryConfig, make_queries

pytestmark = pytest.mark.usefixtures("no_gl_error")

CONFIG = QueryConfig(fov_deg=(50.0, 70.0), width_px=480, height_px=320, azimuths=5120)
AREA = (2000.0, -3000.0, 3000.0, -2000.0)
CLEAR = Scenery(clouds=0.0)


@pytest.fixture(scope="module")
def terrain():
    return field_of(fractal(170, 170, 400.0, seed=9))


@pytest.fixture(scope="module")
def renderer(terrain):
    with DepthRenderer(terrain, 1024) as made:
        yield made


@pytest.fixture(scope="module")
def queries(terrain):
    return make_queries(terrain, AREA, 3, seed=1, config=CONFIG)


def test_sky_and_ground_meet_at_the_true_skyline(renderer, queries):
    for query in queries:
        picture = draw_photo(renderer, query, 5, CLEAR).astype(float)
        column = np.flatnonzero((query.row_px > 6.0) & (query.row_px < 310.0))
        assert len(column) > 200
        above = picture[np.floor(query.row_px[column] - 3.0).astype(int), column]
        below = picture[np.ceil(query.row_px[column] + 3.0).astype(int), column]
        # The sky is bluish and bright, forest is neither.
        assert ((above[:, 2] > 150.0).mean(), (below[:, 2] < 120.0).mean()) > (0.99, 0.99)


def test_the_extraction_finds_the_true_skyline(renderer, queries, tmp_path):
    for query in queries:
        picture = draw_photo(renderer, query, 5, CLEAR)
        Image.fromarray(picture).save(tmp_path / "photo.jpg", quality=90)
        _, found = extract_photo(tmp_path / "photo.jpg")
        error_px = np.abs(found.row_px - query.row_px)
        assert np.isfinite(error_px).mean() > 0.6
        assert np.nanmedian(error_px) < 0.4


def test_occluders_stand_in_front_of_sky_and_ground(renderer, terrain):
    hidden = replace(CONFIG, occluded_share=(0.4, 0.4))
    (query,) = make_queries(terrain, AREA, 1, seed=2, config=hidden)
    picture = draw_photo(renderer, query, 5, CLEAR).astype(float)
    bare = draw_photo(renderer, replace(query, occluders=()), 5, CLEAR).astype(float)
    changed = np.abs(picture - bare).max(axis=2) > 40.0
    covered = np.zeros(changed.shape, dtype=bool)
    rows = np.arange(320)[:, np.newaxis]
    for occluder in query.occluders:
        covered[:, slice(*occluder.columns)] = rows > occluder.row_px
    sky = rows < query.row_px
    assert changed[covered & sky].mean() > 0.9
    # Noise and the lens touch a pixel or two beside them, no more.
    assert changed[~covered].mean() < 0.02


def test_seeds_and_scenery_decide(renderer, queries):
    first, again, other = (draw_photo(renderer, queries[0], seed, CLEAR) for seed in (1, 1, 2))
    assert first.tobytes() == again.tobytes() != other.tobytes()
    brightness = {
        name: draw_photo(renderer, queries[0], 1, scenery).astype(float)[200:].mean()
        for name, scenery in {
            "forest": CLEAR,
            "haze": replace(CLEAR, visibility_m=100.0),
            "snow": replace(CLEAR, snow_line_m=-1000.0),
        }.items()
    }
    assert brightness["forest"] + 30.0 < min(brightness["haze"], brightness["snow"])


@pytest.mark.parametrize("wrong", [{"visibility_m": 0.0}, {"clouds": 1.5}])
def test_bad_weather_is_refused(wrong):
    with pytest.raises(InputError, match="expected"):
        Scenery(**wrong)

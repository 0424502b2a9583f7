"""The extractor on drawn photos with known skylines, on hopeless ones, and on a real one."""

from dataclasses import astuple
from math import radians, tan

import numpy as np
import pytest
from photo_scenes import KINDS, compose, expose, ground, make_scene, ridge, sky, texture

from skyline.errors import InputError
from skyline.photo.borders import Content, content_of
from skyline.photo.cheapest_path import Steps, cheapest_path
from skyline.photo.extract import crests_of, extract_skyline
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline
from skyline.photo.skyline import PhotoSkyline

# A border known to the whole pixel only errs uniformly by -0.5 to 0.5 px.
WHOLE_PIXEL_MEDIAN = 0.25
WHOLE_PIXEL_P90 = 0.45

# Share of the visible columns that must be trusted: nearly all where the border is plain; where
# haze leaves a fifth of the contrast, the border to pale sky drowns in the noise in places.
TRUSTED = {"haze": 0.5, "snow_white_sky": 0.75}
PLAIN_TRUSTED = 0.9

# Faint borders sink into the noise of 2 levels before they can be placed to half a pixel.
FAINT_P90 = {"haze": 0.6, "snow_white_sky": 1.0}

# Share of trusted columns that may be off by more than 3 px: thin snow over rock may be taken for
# sky. Snow is 8 L* brighter than white sky, rock 50 darker than snow: there more may be.
GROSS = {"snow": 0.06, "snow_white_sky": 0.06}
PLAIN_GROSS = 0.02


@pytest.mark.parametrize("kind", KINDS)
def test_skyline_of_drawn_photos(kind):
    scenes = [make_scene(kind, seed, 720, 480) for seed in (100, 101)]
    skylines = [extract_skyline(scene.image) for scene in scenes]
    error_px = np.concatenate(
        [np.abs(q.row_px - s.row_px)[q.trusted] for q, s in zip(skylines, scenes, strict=True)]
    )
    visible = np.concatenate([s.visible for s in scenes])
    trusted = np.concatenate([q.trusted for q in skylines])
    median, p90 = np.percentile(error_px, [50, 90])
    assert median < WHOLE_PIXEL_MEDIAN
    assert p90 < FAINT_P90.get(kind, WHOLE_PIXEL_P90)
    assert np.mean(error_px > 3.0) < GROSS.get(kind, PLAIN_GROSS)
    assert np.mean(trusted[visible]) > TRUSTED.get(kind, PLAIN_TRUSTED)
    # Things before the mountains are masked, but for their rims.
    assert np.sum(trusted & ~visible) <= 0.015 * trusted.size


def test_ground_up_to_the_top_edge_is_masked():
    scene = make_scene("clear", 106)
    raised = scene.row_px - np.interp(np.arange(960), [0, 600, 780, 960], [0, 0, 400, 400])
    rng = np.random.default_rng(1)
    picture = compose(sky(960, 640), ground(rng, 960, 640), raised)
    skyline = extract_skyline(expose(rng, picture, 2.0))
    assert not skyline.trusted[raised < -5.0].any()
    inside = skyline.trusted & (raised > 0.0)
    assert inside.sum() > 0.8 * (raised > 0.0).sum()
    assert np.median(np.abs(skyline.row_px - raised)[inside]) < WHOLE_PIXEL_MEDIAN


LIGHT = {
    "sunset": ((60, 60, 110), (240, 150, 70), (25, 22, 25)),
    "orange sky over bright ground": ((200, 120, 80), (250, 180, 90), (110, 90, 70)),
    "fog": ((150, 150, 150), (170, 170, 170), (120, 120, 120)),
    "dark clouds over snow": ((70, 75, 85), (100, 105, 110), (235, 238, 240)),
    "night": ((5, 8, 20), (15, 18, 35), (3, 3, 4)),
}


@pytest.mark.parametrize("light", LIGHT)
def test_sky_of_any_light(light):
    zenith, horizon, colour = LIGHT[light]
    rng = np.random.default_rng(1)
    row_px = ridge(rng, 480, 320)
    picture = compose(sky(480, 320, zenith, horizon), ground(rng, 480, 320, colour), row_px)
    skyline = extract_skyline(expose(rng, picture, 2.0))
    error_px = np.abs(skyline.row_px - row_px)[skyline.trusted]
    assert skyline.trusted.mean() > PLAIN_TRUSTED
    # By night the border is fainter than the noise of one pixel.
    assert np.median(error_px) < WHOLE_PIXEL_MEDIAN * (2.0 if light == "night" else 1.0)
    assert np.mean(error_px > 3.0) < 0.05


def test_crests_are_distinct_and_likeliest_first():
    share = np.zeros((200, 4), np.float32)
    share[59, 0], share[60, 0], share[120, 0] = 0.15, 0.25, 0.5
    share[99:102, 1] = 0.05  # A weak one, of 15 %
    share[50, 2] = 0.05
    share[[20, 60, 100, 140], 3] = 0.3, 0.26, 0.24, 0.2
    nan = np.nan
    expected = [[120, 100, nan, 20], [60, nan, nan, 60], [nan, nan, nan, 100]]
    np.testing.assert_array_equal(crests_of(share), expected)


def test_a_skyline_shows_the_crest_that_is_not_its_skyline():
    crests = np.full((3, 4), np.nan)
    crests[:2] = [[50, 50, 80, np.nan], [80, np.nan, 50, np.nan]]
    row_px, sure = np.array([50.4, 50, 50, np.nan]), np.array([1, 1, 1, 0.0])
    skyline = PhotoSkyline(row_px, sure, 4, 100, crests=crests)
    np.testing.assert_array_equal(skyline.other_crest_px(), [80, np.nan, 80, np.nan])


def test_mirrored_photo_gives_the_mirrored_skyline():
    image = make_scene("layers", 103, 480, 320).image
    skyline, mirrored = extract_skyline(image), extract_skyline(image[:, ::-1].copy())
    both = skyline.trusted & mirrored.trusted[::-1]
    assert both.mean() > 0.95
    assert np.percentile(np.abs(skyline.row_px - mirrored.row_px[::-1])[both], 95) < 0.5


@pytest.mark.parametrize(("width", "height"), [(2400, 400), (400, 900)])
def test_other_shapes(width, height):
    scene = make_scene("clear", 104, width, height)
    skyline = extract_skyline(scene.image)
    error_px = np.abs(skyline.row_px - scene.row_px)[skyline.trusted]
    assert skyline.trusted.mean() > PLAIN_TRUSTED
    assert np.median(error_px) < WHOLE_PIXEL_MEDIAN


RNG, SHAPE = np.random.default_rng(5), (320, 480)
NOISE = 2.0 * RNG.standard_normal((*SHAPE, 3))
HOPELESS = {
    "uniform": np.full((*SHAPE, 3), 128.0),
    "white": np.full((*SHAPE, 3), 255.0),
    "blue sky": sky(480, 320) + NOISE,
    "clouds": sky(480, 320) + 25.0 * texture(RNG, SHAPE, 20.0)[:, :, np.newaxis] + NOISE,
    "noise": 128.0 + 60.0 * RNG.standard_normal((*SHAPE, 3)),
    "ground": 100.0 + 30.0 * texture(RNG, SHAPE, 1.5)[:, :, np.newaxis] + NOISE,
}


@pytest.mark.parametrize("kind", HOPELESS)
def test_a_photo_without_a_skyline_is_refused(kind):
    with pytest.raises(InputError):
        extract_skyline(np.clip(HOPELESS[kind], 0, 255).astype(np.uint8))


@pytest.mark.parametrize("shape", [(1, 1, 3), (480, 31, 3), (40, 4000, 3)])
def test_unusable_arrays(shape):
    with pytest.raises(InputError):
        extract_skyline(np.zeros(shape, np.uint8))


def test_borders_are_found_but_overcast_sky_is_not_one():
    scene = make_scene("clear", 105, 480, 320)
    assert content_of(scene.image) == Content(320, 480, 0, 320, 0, 480)
    framed = np.zeros((400, 500, 3), np.uint8)
    framed[20:340, 10:490] = scene.image
    assert astuple(content_of(framed)) == pytest.approx((400, 500, 20, 340, 10, 490), abs=3)
    overcast = scene.image.copy()
    overcast[np.arange(320)[:, np.newaxis] < scene.row_px] = 255
    assert content_of(overcast) == Content(320, 480, 0, 320, 0, 480)


def test_path_is_the_cheapest_of_all():
    # Against every path there is, on a grid small enough to list them.
    rng = np.random.default_rng(2)
    steps = Steps(reach=1, row_price=0.2, jump_price=0.5)
    for _ in range(20):
        cost = rng.uniform(0.0, 1.0, (4, 5)).astype(np.float32)
        every = np.stack(np.meshgrid(*[np.arange(4)] * 5, indexing="ij"), axis=-1).reshape(-1, 5)
        step = np.abs(np.diff(every, axis=1))
        price = np.where(step <= 1, np.minimum(0.2 * step, 0.5), 0.5)
        total = cost[every, np.arange(5)].sum(axis=1) + price.sum(axis=1)
        np.testing.assert_array_equal(cheapest_path(cost, steps), every[np.argmin(total)])


# Columns and rows of the ridge: the extractor's own, checked by eye on enlarged overlays.
RIDGE = {100: 1112, 1250: 1182, 3370: 941, 4890: 1132, 5100: 1155}


def test_hintereisferner_webcam(shared_data):
    path = shared_data / "rofental" / "hintereisferner_webcam.jpg"
    photo = read_photo(path, fov_deg=78.7)
    skyline = find_skyline(photo)
    assert photo.rgb.shape == (3456, 5184, 3)
    assert skyline.trusted.mean() > 0.8
    for column, row in RIDGE.items():
        assert skyline.row_px[column] == pytest.approx(row, abs=10)
    # The tops of the clouds on the ridge, columns 776 to 898 and 4180 to 4450, are traced in part:
    # a known error.
    # Nothing of the captions and the logo in the upper corners, rows 0 to 140.
    assert np.nanmin(skyline.row_px) > 800
    # Weisskugel is the highest summit in the photo, at azimuth 272.7; the camera's is 275.96.
    u, v = skyline.image_plane()
    assert u[np.argmax(v)] == pytest.approx(tan(radians(272.7 - 275.96)), abs=tan(radians(0.5)))

"""Skylines in the haze above the one that was found first."""

from dataclasses import replace

import numpy as np
import pytest
from photo_scenes import ground, ridge, sky

from skyline.photo.haze import farther_skylines
from skyline.photo.photo import read_photo
from skyline.photo.read import find_skyline

WIDTH_PX, HEIGHT_PX = 1200, 800


def hazy(levels):
    """A far ridge some levels darker than the sky, over a near one: picture, far rows."""
    rng = np.random.default_rng(1)
    far = ridge(rng, WIDTH_PX, HEIGHT_PX, 0.06) - 60.0
    near = ridge(rng, WIDTH_PX, HEIGHT_PX, 0.10) + 70.0
    rows = np.arange(HEIGHT_PX)[:, np.newaxis]
    above = sky(WIDTH_PX, HEIGHT_PX)
    haze = above - levels * np.array([1.2, 1.0, 0.7])
    picture = np.where((rows > far)[..., np.newaxis], haze, above)
    picture = np.where((rows > near)[..., np.newaxis], ground(rng, WIDTH_PX, HEIGHT_PX), picture)
    picture += rng.normal(0.0, 1.2, picture.shape)
    return np.clip(picture, 0.0, 255.0).astype(np.uint8), far


def right_share(skyline, row_px):
    """The share of all columns whose row is trusted and right."""
    return np.mean(skyline.trusted & (np.abs(skyline.row_px - row_px) < 3.0))


@pytest.fixture(scope="module")
def first():
    picture, far = hazy(levels=6.0)
    return find_skyline(read_photo(picture, 60.0)), far


def test_a_ridge_in_haze_is_found_above_the_ridge_in_front_of_it(first):
    skyline, far = first
    assert right_share(skyline, far) < 0.3
    (farther,) = farther_skylines(skyline)
    assert right_share(farther, far) > 0.8
    assert np.mean(np.abs(farther.row_px - far)[farther.trusted] < 3.0) > 0.95
    assert (farther.width_px, farther.fov_deg) == (WIDTH_PX, 60.0)


def test_nothing_is_found_above_a_skyline_that_is_the_farthest():
    picture, far = hazy(levels=20.0)
    skyline = find_skyline(read_photo(picture, 60.0))
    assert right_share(skyline, far) > 0.95
    assert list(farther_skylines(skyline)) == []


def test_what_a_person_has_drawn_is_the_skyline(first):
    skyline, _ = first
    assert list(farther_skylines(replace(skyline, is_drawn=True))) == []
    assert list(farther_skylines(replace(skyline, picture=None))) == []

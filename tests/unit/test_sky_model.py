"""A sky model of the user's own: its contract, through a stand-in and, if installed, for real."""

import numpy as np
import pytest
from photo_scenes import BlueSky, make_scene

from skyline.photo.user_sky_model import model_skyline


@pytest.mark.parametrize("form", ["probability", "flat", "two", "logits", "two logits"])
def test_every_form_of_output_gives_the_skyline(form):
    scene = make_scene("clear", 3, 640, 480)
    skyline = model_skyline(scene.image, BlueSky(form=form))
    error_px = np.abs(skyline.row_px - scene.row_px)[skyline.trusted]
    assert skyline.trusted.mean() > 0.95
    assert np.median(error_px) < 0.5
    assert ((skyline.trust > 0.0) == skyline.trusted).all()


def test_photo_is_brought_to_the_size_the_model_takes():
    scene = make_scene("clear", 3, 640, 480)
    fixed = BlueSky((240, 320))
    skyline = model_skyline(scene.image, fixed)
    assert fixed.seen == (1, 3, 240, 320)
    assert np.median(np.abs(skyline.row_px - scene.row_px)[skyline.trusted]) < 1.0
    free = BlueSky()
    model_skyline(make_scene("clear", 3, 2100, 700).image, free)
    assert free.seen == (1, 3, 352, 1024)

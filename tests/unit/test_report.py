"""Pictures are there, not blank, and show what they are told to."""

import cv2
import numpy as np
from scenes import field_of, fractal

from skyline.report.plan_pictures import save_depth_images
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

FIELD = field_of(fractal(120, 120, seed=1), west_m=0.0, north_m=3600.0)


def picture(path):
    pixels = cv2.imread(str(path))
    assert pixels is not None
    assert pixels.std() > 20.0
    return pixels.astype(int)


def crimson(pixels):
    blue, green, red = np.moveaxis(pixels, -1, 0)
    return (red > 190) & (green < 60) & (blue < 90)


def test_depth_images_are_not_blank(tmp_path):
    views = oracle.skyline(FIELD, stand_on(FIELD, easting_m=1800.0, northing_m=1800.0), 64)
    images = np.full((4, 64, 64), np.inf, dtype=np.float32)
    images[:, 40:] = 100.0
    save_depth_images(images, views, tmp_path / "depth.png")
    assert crimson(picture(tmp_path / "depth.png")).sum() > 50
    save_depth_images(np.full_like(images, np.inf), views, tmp_path / "sky.png")
    assert (tmp_path / "sky.png").exists()

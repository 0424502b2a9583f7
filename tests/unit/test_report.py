"""Pictures are there, not blank, and show what they are told to."""

import cv2
import numpy as np
from scenes import field_of, fractal

from skyline.planning.uniform import uniform_grid
from skyline.report import Found, save_depth_images, save_map
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


def test_map_shows_true_and_found_positions(tmp_path):
    grid = uniform_grid(FIELD, 600.0)
    save_map(FIELD, grid, [], tmp_path / "bare.png")
    found = [Found("one", (1000.0, 1000.0), (2500.0, 2400.0), 30.0, 60.0), Found("two", None, None)]
    save_map(FIELD, grid, found, tmp_path / "new" / "map.png")
    assert crimson(picture(tmp_path / "new" / "map.png")).sum() > 100
    assert crimson(picture(tmp_path / "bare.png")).sum() == 0


def test_depth_images_are_not_blank(tmp_path):
    views = oracle.skyline(FIELD, stand_on(FIELD, 1800.0, 1800.0), 64)
    images = np.full((4, 64, 64), np.inf, dtype=np.float32)
    images[:, 40:] = 100.0
    save_depth_images(images, views, tmp_path / "depth.png")
    assert crimson(picture(tmp_path / "depth.png")).sum() > 50
    save_depth_images(np.full_like(images, np.inf), views, tmp_path / "sky.png")
    assert (tmp_path / "sky.png").exists()

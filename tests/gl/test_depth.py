"""The paper's rasterizer against the oracle: within half a pixel wherever it can see."""

import numpy as np
import pytest
from scenes import field_from, field_of, fractal, scattered

from skyline.geodesy.earth import Curvature
from skyline.render.depth import QUANTIZATION_PX, DepthRenderer
from skyline.render.horizon import RenderConfig
from skyline.report.paper_pictures import save_depth_pictures
from skyline.skylines import FLAG_HOLE, FLAG_NO_DATA, FLAG_OUT_OF_IMAGE
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

FLAT = Curvature(enabled=False)


def error_px(views, truth):
    # Behind a hole the surface has no foot: a sliver of it may fall between pixel centres.
    seen = ((views.flags | truth.flags) & (FLAG_OUT_OF_IMAGE | FLAG_NO_DATA | FLAG_HOLE)) == 0
    error = (views.v - truth.v) * views.width / 2.0
    return error[seen]


@pytest.mark.parametrize("width", [161, 640])
@pytest.mark.parametrize("holes", [False, True])
def test_skylines_lie_within_half_a_pixel_of_the_oracle(width, holes):
    heights = fractal(150, 170, seed=width)
    if holes:
        heights[40:55, 60:90] = np.nan
        heights[:30, :40] = np.nan
    field = field_of(heights, 30.0, 25.0, west_m=5e5, north_m=5.2e6)
    viewpoints = scattered(field, 6, seed=1)
    truth = oracle.skyline(field, viewpoints, width)
    with DepthRenderer(field, width) as renderer:
        views = renderer.render(viewpoints)
    error = error_px(views, truth)
    assert np.abs(error).max() <= QUANTIZATION_PX
    assert error.size > 0.4 * views.flags.size
    # Uniform in half a pixel either way: 1 / sqrt(12), give or take what few views allow.
    assert np.sqrt(np.mean(error**2)) < 0.33


def test_out_of_image_exactly_where_the_oracle_leaves_it():
    heights = np.zeros((81, 81), dtype=np.float32)
    heights[:30] = 900.0
    field = field_of(heights, 10.0, north_m=400.0, west_m=-400.0)
    viewpoints = stand_on(field, easting_m=[1.0, 3.0], northing_m=[-40.0, 60.0], eye_height_m=2.0)
    truth = oracle.skyline(field, viewpoints, 64, FLAT)
    with DepthRenderer(field, 64, FLAT) as renderer:
        views = renderer.render(viewpoints)
    steep = truth.v >= 1.0 - 1.0 / 64.0
    np.testing.assert_array_equal((views.flags & FLAG_OUT_OF_IMAGE) != 0, steep)
    assert steep.any()
    assert not steep.all()


@pytest.mark.parametrize("eye_height_m", [0.01, 1500.0])
def test_depth_of_a_plane_is_good_to_a_ten_thousandth(eye_height_m, is_hardware):
    """Inverse depth in 32-bit floats keeps its digits from the feet to the horizon.

    A GPU snaps vertices to 1/256 px before it interpolates, so that a pixel may get the depth of
    half as much below it.
    """
    field = field_from(lambda e, n: 0.0 * e + 0.0 * n, 401, 250.0)
    viewpoints = stand_on(field, easting_m=[17.0], northing_m=[-35.0], eye_height_m=eye_height_m)
    with DepthRenderer(field, 320, FLAT) as renderer:
        images = renderer.depth_images(viewpoints, 0)
    v = (319.0 - 2.0 * np.arange(320)) / 320.0
    with np.errstate(divide="ignore"):
        expected = np.where(v < 0.0, -eye_height_m / v, np.inf)
    expected = np.broadcast_to(expected[:, np.newaxis], images[0].shape)
    snapped_px = 2.0**-9 if is_hardware else 0.0
    bound = 1e-4 + snapped_px / np.abs(160.0 * v)[:, np.newaxis] * np.ones(320)
    for image in images:
        seen = np.isfinite(image)
        assert seen.any()
        assert (np.abs(image[seen] / expected[seen] - 1.0) < bound[seen]).all()
        # What is missing is beyond the border, or the sky.
        assert (expected[~seen] > 49_000.0).all()


def test_pictures_tell_their_progress(tmp_path):
    field = field_from(lambda e, n: 0.0 * e + 0.0 * n, 21, 10.0)
    eyes = stand_on(field, easting_m=[0.0, 5.0], northing_m=[0.0, 0.0], eye_height_m=2.0)
    reports = []
    save_depth_pictures(
        field, eyes, tmp_path, RenderConfig(16), progress=lambda *done: reports.append(done)
    )
    assert reports == [(1, 2), (2, 2)]

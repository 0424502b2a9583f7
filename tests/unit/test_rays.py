"""Rays of a photo under another field of view."""

from dataclasses import replace

import numpy as np
import pytest
from ray_scenes import equally_trusted

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.match.rays import Rays
from skyline.photo.skyline import PhotoSkyline


def test_a_field_of_view_is_searched_about_the_one_given():
    u = np.array([-0.5, 0.5])
    rays = equally_trusted(u, u**2, 60.0)
    about = rays.about(1.5)
    assert about.fov_bounds_deg == pytest.approx((54.0, 66.0))
    # The deviation of log(tan(fov / 2)), by differences.
    wider, narrower = (np.log(np.tan(np.radians(fov / 2.0))) for fov in (60.001, 59.999))
    assert about.lens.sd == pytest.approx(1.5 * (wider - narrower) / 0.002, rel=1e-5)
    wide = replace(rays, fov_deg=170.0).about(85.0)
    assert 0.0 < wide.fov_bounds_deg[0] < 170.0 < wide.fov_bounds_deg[1] < 180.0


def test_a_photo_that_may_be_cropped_is_searched_down_to_half_its_field_of_view():
    rays = equally_trusted(np.array([-0.5, 0.5]), np.zeros(2), 60.0).about(1.5, crop_share=0.2)
    assert rays.fov_bounds_deg == pytest.approx((30.0, 66.0))
    assert rays.lens.crop_share == 0.2


@pytest.mark.parametrize(
    ("fov_deg", "projection", "sd"),
    [
        (60.0, "perspective", 0.01),
        (90.0, "perspective", 0.05),
        (None, "perspective", 0.01),
        (90.0, "cylindrical", 0.0),
        (360.0 / np.pi, "fisheye", 0.06),  # Half of it is a radian
    ],
)
def test_lenses_and_fisheyes_may_distort_and_panoramas_do_not(fov_deg, projection, sd):
    row_px = np.full(64, 20.0)
    skyline = PhotoSkyline(row_px, np.ones(64), 64, 48, fov_deg, Projection(projection))
    assert Rays.of(skyline, 0.025, finds_fov=True).distortion_sd == pytest.approx(sd)


def test_a_fisheye_of_unknown_field_of_view_is_refused():
    row_px = np.full(64, 20.0)
    skyline = PhotoSkyline(row_px, np.ones(64), 64, 48, None, Projection.FISHEYE)
    with pytest.raises(InputError, match="--fov-deg"):
        Rays.of(skyline, 0.025, finds_fov=True)


def test_fields_of_view_of_a_fisheye_are_searched_up_to_half_a_turn():
    u = np.radians([-80.0, 80.0])
    rays = Rays(u=u, v=u**2, weight=np.ones(2), fov_deg=160.0, projection=Projection.FISHEYE)
    assert rays.about(8.0).fov_bounds_deg == (128.0, 180.0)


def test_a_panorama_s_scale_is_its_field_of_view_s():
    u = np.radians([-110.0, 110.0])
    around = Rays(
        u=u,
        v=np.array([0.1, 0.2]),
        weight=np.ones(2),
        fov_deg=220.0,
        projection=Projection.CYLINDRICAL,
    )
    np.testing.assert_allclose(around.fov_at(around.log_scale(242.0)), 242.0)
    assert around.about(2.2).lens.sd == pytest.approx(0.01)
    assert around.about(100.0).fov_bounds_deg == (110.0, 360.0)


@pytest.mark.parametrize("projection", [Projection.CYLINDRICAL, Projection.EQUIRECTANGULAR])
def test_rays_of_another_field_of_view_are_those_of_its_photo(projection):
    skyline = PhotoSkyline(np.linspace(40.0, 60.0, 64), np.ones(64), 64, 100, 200.0, projection)
    rays = Rays.of(skyline, 0.025, finds_fov=True).with_fov(230.0)
    np.testing.assert_allclose((rays.u, rays.v), skyline.with_fov(230.0).image_plane())

"""The geometry of cameras: inverses, plain trigonometry, and derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from skyline.camera.camera import Camera
from skyline.camera.image_points import ImagePoints
from skyline.camera.levelling import level, near_level_changes, project
from skyline.camera.projection import Projection
from skyline.camera.warps import distorted, undistorted
from skyline.photo.skyline import PhotoSkyline

LENS, CYLINDER, SPHERE = Projection.PERSPECTIVE, Projection.CYLINDRICAL, Projection.EQUIRECTANGULAR
FISHEYE = Projection.FISHEYE
U = np.linspace(-0.5, 0.5, 7)
V = 0.2 * np.cos(3.0 * U) - 0.05


def points(projection):
    return ImagePoints(u=U, v=V, fov_deg=60.0, projection=projection)


@pytest.mark.parametrize("projection", [CYLINDER, SPHERE])
@pytest.mark.parametrize("fov_deg", [40.0, 160.0, 360.0])
def test_rays_of_a_panorama_point_where_it_looks(projection, fov_deg):
    width = 320
    azimuth = (np.arange(width) + 0.5) / width * fov_deg - fov_deg / 2.0
    elevation = 8.0 + 6.0 * np.sin(np.radians(7.0 * azimuth))
    # Rows at which a panorama shows these, worked out the other way round.
    up = np.radians(elevation)
    up = np.tan(up) if projection is CYLINDER else up
    row_px = 59.5 - width / np.radians(fov_deg) * up
    photo = PhotoSkyline(row_px, np.ones(width), width, 120, fov_deg, projection)
    u, v = photo.image_plane()
    assert_allclose(np.degrees(u), azimuth, atol=1e-9)
    assert_allclose(np.degrees(np.arctan(v)), elevation, atol=1e-9)


@pytest.mark.parametrize("projection", Projection)
@pytest.mark.parametrize("fov_deg", [5.0, 60.0, 150.0, 179.0])
def test_places_are_where_rays_come_from(projection, fov_deg):
    across, above = np.linspace(-1.0, 1.0, 41), np.linspace(-0.6, 0.6, 41)
    rays = projection.rays(across, above, fov_deg)
    back = projection.places(*rays, fov_deg)
    assert_allclose(back, (across, above), atol=1e-12)


@pytest.mark.parametrize("projection", Projection)
def test_the_side_of_an_image_is_half_a_field_of_view_away(projection):
    across, _ = projection.rays(np.ones(1), np.zeros(1), 70.0)
    assert across[0] == pytest.approx(projection.half_width(70.0))
    assert projection.fov_deg(across[0]) == pytest.approx(70.0)


@given(distortion=st.floats(-0.25, 0.25))
def test_the_distortion_of_a_lens_is_undone(distortion):
    places = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-0.4, 0.4, 5)))
    back = distorted(*undistorted(*places, distortion), distortion)
    assert_allclose(back, places, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("projection", Projection)
@given(share=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)))
def test_levelled_rays_project_back(projection, share):
    wide, most_deg = (3.1, 20.0) if projection.is_panorama else (1.5, (60.0, 180.0))
    u, v = np.meshgrid(np.linspace(-wide, wide, 9), np.linspace(-0.3, 0.3, 5))
    turned_deg = np.multiply(share, most_deg)
    levelled = level(u, v, *turned_deg, projection)
    back = project(*levelled, *turned_deg, projection)
    assert_allclose(back, (u, v), rtol=0.0, atol=1e-10)


def test_a_pitch_raises_the_middle_and_a_roll_turns_it_clockwise():
    # The axis itself rises by the pitch; a ray 45 degrees to the right of a camera that is rolled
    # by a quarter turn clockwise looks straight down by as much.
    azimuth, tangent = level(np.zeros(1), np.zeros(1), 10.0, 0.0)
    assert (azimuth[0], np.degrees(np.arctan(tangent[0]))) == pytest.approx((0.0, 10.0))
    azimuth, tangent = level(np.ones(1), np.zeros(1), 0.0, 90.0)
    assert (azimuth[0], tangent[0]) == pytest.approx((0.0, -1.0))


@pytest.mark.parametrize(
    ("row_deg", "pitch_deg", "expected_deg"),
    [(75.0, 10.0, (0.0, 85.0)), (82.0, 10.0, (180.0, 88.0)), (-89.0, -10.0, (180.0, -81.0))],
)
def test_a_sphere_raised_past_the_zenith_looks_back(row_deg, pitch_deg, expected_deg):
    azimuth, tangent = level(np.zeros(1), np.tan(np.radians([row_deg])), pitch_deg, 0.0, SPHERE)
    found_deg = np.degrees([np.abs(azimuth[0]), np.arctan(tangent[0])])
    assert_allclose(found_deg, expected_deg, atol=1e-9)


def test_no_row_of_a_raised_sphere_looks_below_its_lowest():
    _, below = project(np.zeros(1), np.tan(np.radians([-85.0])), 10.0, 0.0, SPHERE)
    assert np.isnan(below[0])


@pytest.mark.parametrize("projection", Projection)
def test_points_of_another_scale_are_levelled_as_rays_of_its_field_of_view(projection):
    image = points(projection)
    no_warp = np.zeros((1, 4 if image.is_panorama else 0))
    state = np.array([0.1]), np.array([-0.2]), np.array([np.log(1.2)])
    azimuth, tangent, *_ = image.levelled_with_changes(*state, no_warp)
    expected = level(*image.scaled(np.array(1.2)), np.degrees(0.1), np.degrees(-0.2), projection)
    assert_allclose((azimuth[0], tangent[0]), expected, atol=1e-12)
    quick = image.levelled(*(one[:, np.newaxis] for one in state), 0.0)
    assert_allclose(np.stack(quick)[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("projection", Projection)
def test_the_field_of_view_of_a_scale_is_the_one_of_its_scale(projection):
    image = points(projection)
    assert_allclose(image.fov_at(image.log_scale(np.array([48.0, 71.0]))), [48.0, 71.0])


@pytest.mark.parametrize(
    ("projection", "warp"),
    [
        (LENS, []),
        (LENS, [0.08]),
        (LENS, [-0.2]),
        (CYLINDER, [0.02, -0.03, 0.01, 0.02]),
        (SPHERE, [0.02, -0.03, 0.01, 0.02]),
    ],
)
@pytest.mark.parametrize("attitude", [(0.0, 0.0, 0.0), (0.12, -0.2, 0.1), (-0.3, 0.4, -0.2)])
def test_every_derivative_of_a_direction_agrees_with_differences(projection, warp, attitude):
    image, state = points(projection), np.array([*attitude, *warp])

    def directions(moved):
        state = moved[:, np.newaxis]
        return image.levelled_with_changes(*state[:3], moved[np.newaxis, 3:])

    changes = np.stack(directions(state)[2:])[:, 0]
    # Central differences of h = 1e-5 err by h^2 / 6 times the third derivative, of order 10 here.
    h = 1e-5
    for k, step in enumerate(h * np.eye(len(state))):
        after, before = (
            np.stack(directions(state + step)[:2]),
            np.stack(directions(state - step)[:2]),
        )
        assert_allclose(changes[..., k], (after - before)[:, 0] / (2.0 * h), atol=1e-8)


@pytest.mark.parametrize("projection", [LENS, CYLINDER, FISHEYE])
def test_quick_derivatives_are_exact_at_the_horizon_and_near_it_to_first_order(projection):
    # A lens rises with its scale even at the horizon's height; other derivatives are of a pitch
    # and a roll that the elevations 0.02 change by 0.02^2 at most, about a level camera.
    image = replace(points(projection), v=np.full_like(U, 0.02))
    no_warp = np.zeros((1, 4 if image.is_panorama else 0))
    azimuth, tangent, turn, rise = image.levelled_with_changes(*np.zeros((3, 1)), no_warp)
    slope = np.full_like(azimuth, 0.3)
    expected = (rise - slope[..., np.newaxis] * turn)[0, :, :3].T
    quick = near_level_changes(azimuth, tangent, slope, projection)
    found = np.stack(quick)[:, 0]
    # A fisheye's is to first order everywhere.
    assert_allclose(found[2], expected[2], atol=0.02**2 if projection is FISHEYE else 1e-12)
    assert_allclose(found[:2], expected[:2], atol=0.02 * (0.3 + 0.02) * 1.1)


def fisheye(**given):
    """Return a level fisheye of half a turn, 180 px square: 1 degree a pixel."""
    size = {"width_px": 180, "height_px": 180, "fov_deg": 180.0}
    held = {"grid_heading_deg": 90.0, "pitch_deg": 0.0, "roll_deg": 0.0}
    return Camera(projection=FISHEYE, **{**size, **held, **given})


def test_a_fisheye_looks_as_many_degrees_aside_as_a_pixel_is_off_its_middle():
    azimuth_deg, tangent = fisheye().directions(np.array([149.5, 89.5]), np.array([89.5, 44.5]))
    assert_allclose(azimuth_deg, (150.0, 90.0))
    assert_allclose(np.degrees(np.arctan(tangent)), (0.0, 45.0), atol=1e-9)


def test_a_fisheye_s_corners_look_behind_the_camera():
    # 80 degrees across and 80 up are 113 degrees off the axis, half way between right and up.
    off = np.radians(np.hypot(80.0, 80.0))
    side = np.sin(off) * np.sqrt(0.5)
    azimuth_deg, tangent = fisheye().directions(169.5, 9.5)
    assert azimuth_deg == pytest.approx(90.0 + np.degrees(np.arctan2(side, np.cos(off))))
    assert azimuth_deg > 180.0
    assert tangent == pytest.approx(side / np.hypot(side, np.cos(off)))


def test_a_pitch_turns_a_fisheye_s_rays_about_the_camera():
    _, tangent = fisheye(pitch_deg=20.0).directions(89.5, 59.5)
    assert np.degrees(np.arctan(tangent)) == pytest.approx(50.0)


def test_what_is_right_behind_a_fisheye_is_not_on_its_picture():
    assert np.isnan(fisheye().pixels(270.0, 0.0)).all()


def test_a_fisheye_s_distortion_keeps_its_field_of_view():
    # The middle and the side stay, and half way out 0.5 becomes 0.5 + 0.1 (0.125 - 0.5).
    r = np.array([0.0, 0.5, 1.0])
    across, above = undistorted(r, 0.0 * r, 0.1, FISHEYE)
    assert_allclose(across, r + 0.1 * (r**3 - r))
    assert_allclose(distorted(across, above, 0.1, FISHEYE)[0], r, atol=1e-9)


@pytest.mark.parametrize(
    ("projection", "distortion", "wander"),
    [
        (LENS, 0.05, ()),
        (FISHEYE, 0.05, ()),
        (CYLINDER, 0.0, (0.01, 0.02, -0.01, 0.0)),
        (SPHERE, 0.0, ()),
    ],
)
def test_the_directions_of_pixels_lead_back_to_them(projection, distortion, wander):
    camera = Camera(
        projection=projection, width_px=400, height_px=300, fov_deg=70.0, grid_heading_deg=350.0,
        pitch_deg=4.0, roll_deg=-3.0, distortion=distortion, wander=wander,
    )  # fmt: skip
    row_px, column_px = np.mgrid[0:300:23, 0:400:31].astype(float)
    back = camera.pixels(*camera.directions(column_px, row_px))
    assert_allclose(back, (column_px, row_px), atol=1e-6)


def test_the_middle_of_a_picture_looks_along_the_axis():
    camera = Camera(
        projection=LENS, width_px=401, height_px=301, fov_deg=70.0, grid_heading_deg=350.0,
        pitch_deg=4.0, roll_deg=-3.0,
    )  # fmt: skip
    azimuth_deg, tangent = camera.directions(200, 150)
    assert azimuth_deg == pytest.approx(350.0)
    assert np.degrees(np.arctan(tangent)) == pytest.approx(4.0)

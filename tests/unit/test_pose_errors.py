"""Errors of directions against drawn cameras, and the errors of poses that a person wrote."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at

from skyline.camera.projection import Projection
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.pose_errors import ASSUMED, Bearings

WIDTH_PX, HEIGHT_PX = 1200, 800
PHOTO = PhotoSkyline(np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX), WIDTH_PX, HEIGHT_PX)
DRAWS = 20_000


def pinhole(angles_rad, half_width, distortion, across, above):
    """Return azimuths and tangents (D,) of a place in half widths, of drawn lenses.

    ``angles_rad`` (3, D) are heading, pitch and roll, each a turn of the ray about one axis.
    """
    heading, pitch, roll = angles_rad
    stretch = half_width * (1.0 + distortion * (across**2 + above**2))
    x, y = across * stretch, above * stretch
    right, y = x * np.cos(roll) + y * np.sin(roll), y * np.cos(roll) - x * np.sin(roll)
    up, ahead = y * np.cos(pitch) + np.sin(pitch), np.cos(pitch) - y * np.sin(pitch)
    return heading + np.arctan2(right, ahead), up / np.hypot(right, ahead)


def test_the_covariance_of_a_direction_is_that_of_drawn_poses():
    pose = candidate_at(0.0, 0.0, 40.0, 7.0, -4.0, 60.0)
    pose = replace(pose, distortion=0.03)
    rng = np.random.default_rng(5)
    # Each unknown pulls at the others.
    root = np.diag([10.0, 10.0, 5.0, *[2e-3] * 3, 4e-3, 4e-3]) @ rng.normal(0.0, 1.0, (8, 8))
    off = root @ rng.standard_normal((8, DRAWS))
    pixel = np.array([[1000.0, 150.0]]).T + rng.normal(0.0, 2.0, (2, DRAWS))
    first = np.radians([[pose.grid_heading_deg], [pose.pitch_deg], [pose.roll_deg]])
    drawn = np.array(
        pinhole(
            first + off[3:6],
            np.tan(np.radians(30.0)) * np.exp(off[6]),
            pose.distortion + off[7],
            (pixel[0] - (WIDTH_PX - 1) / 2.0) / (WIDTH_PX / 2.0),
            ((HEIGHT_PX - 1) / 2.0 - pixel[1]) / (WIDTH_PX / 2.0),
        )
    )
    seen = Bearings.of(pose.camera(PHOTO), [1000.0], [150.0], 8)
    by_pixel = 2.0 * seen.by_pixel[0]
    linear = seen.by_pose[0] @ root @ root.T @ seen.by_pose[0].T + by_pixel @ by_pixel.T
    # The standard error of a variance is 1 % of it with so many draws.
    sampled = np.cov(drawn)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    np.testing.assert_allclose(linear / scale, sampled / scale, atol=0.03)
    middle = drawn.mean(axis=1) - [seen.grid_azimuth_rad[0], seen.elevation_tan[0]]
    np.testing.assert_allclose(middle / np.sqrt(np.diag(sampled)), 0.0, atol=0.03)


def test_a_pose_that_a_person_wrote_has_assumed_errors():
    pose = candidate_at(0.0, 0.0, 40.0, 7.0, -4.0, 60.0)
    sd = np.sqrt(np.diag(pose.covariance_or_assumed(PHOTO)))
    np.testing.assert_allclose(sd[:3], [10.0, 10.0, 7.0])
    np.testing.assert_allclose(np.degrees(sd[3:6]), 0.5)
    # 2 % of 60 degrees are 1.2 degrees.
    assert np.degrees(2.0 * np.arctan(np.tan(np.radians(30.0)) * np.exp(-sd[6]))) == pytest.approx(
        58.8
    )
    assert "heading 0.5, pitch 0.5 and roll 0.5 degrees" in pose.assumed(PHOTO)


def test_a_pitch_of_zero_was_not_measured():
    pose = candidate_at(0.0, 0.0, 40.0)
    sd_deg = np.degrees(np.sqrt(np.diag(pose.covariance_or_assumed(PHOTO))[3:6]))
    np.testing.assert_allclose(sd_deg, [0.5, ASSUMED.level_pitch_sd_deg, ASSUMED.level_roll_sd_deg])


def test_a_full_turn_is_exact():
    photo = replace(PHOTO, projection=Projection.CYLINDRICAL)
    pose = candidate_at(0.0, 0.0, fov_deg=360.0)
    assert pose.covariance_or_assumed(photo)[6, 6] == 0.0
    assert "field of view 0 %" in pose.assumed(photo)


def test_a_known_covariance_is_not_assumed():
    known = tuple(map(tuple, np.diag(np.arange(1.0, 9.0)).tolist()))
    pose = replace(candidate_at(0.0, 0.0), covariance=known)
    np.testing.assert_array_equal(pose.covariance_or_assumed(PHOTO), known)
    assert pose.assumed(PHOTO) == ""

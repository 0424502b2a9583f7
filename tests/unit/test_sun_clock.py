"""The time and the heading that the sun and shadows tell, with their errors."""

from dataclasses import replace
from datetime import UTC, date, datetime, timedelta
from functools import cache

import numpy as np
import pytest
from scenes import candidate_at, field_from, perturbed

from skyline.angles import wrapped_deg
from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.ground.ground_view import GroundErrors
from skyline.photo.skyline import PhotoSkyline
from skyline.sky.sun import Body, Sky
from skyline.sky.sun_clock import body_pointing, heading_at, shadow_pointing, times_at
from skyline.view.viewer import Viewer

pytest.importorskip("ephem")

FLAT = Curvature(enabled=False)
PLAIN = field_from(lambda east, north: 500.0 + 0.0 * east * north, 201, 30.0)
WIDTH_PX, HEIGHT_PX = 1000, 800
PHOTO = PhotoSkyline(
    np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX), WIDTH_PX, HEIGHT_PX,
    projection=Projection.PERSPECTIVE,
)  # fmt: skip
DAY = date(2026, 3, 1)
MORNING = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
SURE_PX = 0.1
FIRM = np.diag(np.square([5.0, 5.0, 2.0, *np.radians([0.1, 0.05, 0.05]), 3e-3, 3e-3]))


def camera_at(pitch_deg=0.0, heading_deg=120.0, covariance=FIRM):
    pose = candidate_at(
        0.0, 0.0, heading_deg, pitch_deg=pitch_deg, fov_deg=60.0, eye_elevation_m=600.0,
        frame=PLAIN.frame,
    )  # fmt: skip
    return replace(pose, covariance=tuple(map(tuple, covariance.tolist())))


def sky_of(pose):
    return Sky(pose.lon, pose.lat, pose.eye_elevation_m)


def pixel_of(pose, azimuth_deg, elevation_deg):
    """Return the pixel of a true azimuth and an elevation."""
    azimuth_deg -= pose.convergence_deg
    tangent = np.tan(np.radians(elevation_deg))
    return tuple(float(at) for at in pose.camera(PHOTO).pixels(azimuth_deg, tangent))


def test_the_sun_in_a_photo_tells_the_time():
    pose = camera_at(pitch_deg=10.0)
    sun = sky_of(pose).look(Body.SUN, MORNING)
    pointing = body_pointing(
        pose, PHOTO, pixel_of(pose, sun.azimuth_deg, sun.elevation_deg), SURE_PX
    )
    (found,) = times_at(pointing, sky_of(pose), Body.SUN, DAY, pose.lon)
    assert abs(found.time - MORNING) < timedelta(seconds=2)
    assert found.off_sds < 0.1


def test_an_error_of_the_heading_is_an_error_of_the_time():
    sds = [0.0, 0.0, 0.0, *np.radians([0.5, 5.0, 0.0]), 0.0]
    pose = camera_at(pitch_deg=10.0, covariance=np.diag(np.square(sds)))
    sun, later = (sky_of(pose).look(Body.SUN, MORNING + timedelta(minutes=m)) for m in (0, 10))
    pixel = pixel_of(pose, sun.azimuth_deg, sun.elevation_deg)
    pointing = body_pointing(pose, PHOTO, pixel, SURE_PX)
    # A pitch that nobody knows leaves the azimuth alone, and the sun's azimuth grows evenly.
    expected_s = 600.0 * 0.5 / (later.azimuth_deg - sun.azimuth_deg)
    found = times_at(pointing, sky_of(pose), Body.SUN, DAY, pose.lon)[0]
    assert found.sd_s == pytest.approx(expected_s, rel=0.3)


def test_times_and_headings_err_as_they_say_where_poses_are_drawn():
    rng = np.random.default_rng(8)
    # A camera that is aside is turned, and one that is zoomed is bent.
    root = np.sqrt(FIRM) @ rng.normal(0.0, 0.4, (8, 8))
    pose = camera_at(pitch_deg=10.0, covariance=root @ root.T)
    sky = sky_of(pose)
    sun = sky.look(Body.SUN, MORNING)

    class Kept:
        look = staticmethod(cache(sky.look))

    off_s, sd_s, off_sds, pose_sds = [], [], [], []
    for _ in range(100):
        true = perturbed(pose, root @ rng.standard_normal(8))
        pixel = pixel_of(true, sun.azimuth_deg, sun.elevation_deg) + rng.normal(0.0, 1.0, 2)
        pointing = body_pointing(pose, PHOTO, tuple(pixel))
        found = times_at(pointing, Kept, Body.SUN, DAY, pose.lon)[0]
        off_s.append((found.time - MORNING).total_seconds())
        sd_s.append(found.sd_s)
        held = heading_at(pose, pointing, Kept, Body.SUN, MORNING)
        off_sds.append(wrapped_deg(held.heading_deg - true.heading_deg) / held.sd_deg)
        pose_sds.append(held.off_sds)
    for errors in (np.divide(off_s, sd_s), off_sds, pose_sds):
        assert 0.90 <= np.mean(np.abs(errors) <= 2.0) <= 0.99


def test_the_sun_at_a_known_time_tells_the_heading():
    pose = camera_at(pitch_deg=10.0)
    sun = sky_of(pose).look(Body.SUN, MORNING)
    # The camera looked 2 degrees farther to the right than the pose says.
    pixel = pixel_of(pose, sun.azimuth_deg - 2.0, sun.elevation_deg)
    pointing = body_pointing(pose, PHOTO, pixel, SURE_PX)
    found = heading_at(pose, pointing, sky_of(pose), Body.SUN, MORNING)
    assert found.heading_deg == pytest.approx(pose.heading_deg + 2.0, abs=0.01)
    assert found.above_deg == pytest.approx(0.0, abs=0.01)
    with pytest.raises(InputError, match="below the horizon at 2026-03-01 22:00 UTC"):
        heading_at(pose, pointing, sky_of(pose), Body.SUN, datetime(2026, 3, 1, 22, tzinfo=UTC))


def test_a_sun_that_stood_higher_than_its_pixel_tells_no_heading():
    pose = camera_at(pitch_deg=10.0)
    sun = sky_of(pose).look(Body.SUN, MORNING)
    pixel = pixel_of(pose, sun.azimuth_deg, sun.elevation_deg)
    pointing = body_pointing(pose, PHOTO, pixel, SURE_PX)
    with pytest.raises(InputError, match="whatever the heading; check the time"):
        heading_at(pose, pointing, sky_of(pose), Body.SUN, MORNING + timedelta(hours=1))


def view_of(pose):
    return Viewer(PLAIN, curvature=FLAT).ground_view(pose, PHOTO)


def shadow_pixels(pose, sun, top_m, true=None):
    """Return tip, foot and top of a post on the plain, 200 m ahead, 100 m below the camera.

    The camera truly was in another pose.
    """
    true = true or pose
    ahead = np.radians(pose.grid_heading_deg)
    foot = 200.0 * np.array([np.sin(ahead), np.cos(ahead)])
    away = np.radians(sun.azimuth_deg - pose.convergence_deg + 180.0)
    length_m = top_m / np.tan(np.radians(sun.elevation_deg))
    tip = foot + length_m * np.array([np.sin(away), np.cos(away)])
    ends = [(*tip, 500.0), (*foot, 500.0), (*foot, 500.0 + top_m)]
    pixels = []
    for end in ends:
        east_m, north_m, up_m = np.subtract(
            end, (true.easting_m, true.northing_m, true.eye_elevation_m)
        )
        azimuth_deg = np.degrees(np.arctan2(east_m, north_m)) + pose.convergence_deg
        up_deg = np.degrees(np.arctan(up_m / np.hypot(east_m, north_m)))
        pixels.append(pixel_of(true, azimuth_deg, up_deg))
    return pixels


@pytest.mark.parametrize("count", [2, 3])
def test_a_shadow_tells_the_time_and_its_error(count):
    pose = camera_at(pitch_deg=-25.0)
    sun = sky_of(pose).look(Body.SUN, MORNING)
    shadow = shadow_pixels(pose, sun, 20.0)[:count]
    pointing = shadow_pointing(view_of(pose), pose, shadow)
    assert pointing.azimuth_deg == pytest.approx(sun.azimuth_deg, abs=0.05)
    assert np.isnan(pointing.elevation_deg) == (count == 2)
    found = times_at(pointing, sky_of(pose), Body.SUN, DAY, pose.lon)[0]
    assert abs(found.time - MORNING) < timedelta(minutes=1)
    assert 30.0 < found.sd_s < 600.0


def test_a_shadow_s_direction_errs_as_it_says_where_poses_are_drawn():
    rng = np.random.default_rng(3)
    root = np.sqrt(FIRM) @ rng.normal(0.0, 0.4, (8, 8))
    pose = camera_at(pitch_deg=-25.0, covariance=root @ root.T)
    sun = sky_of(pose).look(Body.SUN, MORNING)
    view = view_of(pose)
    off_sds = []
    for _ in range(100):
        true = perturbed(pose, root @ rng.standard_normal(8))
        pixels = shadow_pixels(pose, sun, 20.0, true) + rng.normal(0.0, 1.0, (3, 2))
        found = shadow_pointing(view, pose, pixels.tolist(), GroundErrors(height_sd_m=0.0))
        off_sds.append(found.off_deg(sun)[0] / np.sqrt(np.diag(found.covariance)))
    within = np.mean(np.abs(off_sds) <= 2.0, axis=0)
    assert ((within >= 0.90) & (within <= 0.99)).all()


def test_a_shadow_across_a_flat_view_tells_nothing():
    pose = camera_at(pitch_deg=-25.0)
    with pytest.raises(InputError, match="its direction"):
        shadow_pointing(view_of(pose), pose, [(500.0, 300.0), (501.0, 300.0)])


def test_a_body_that_does_not_rise_or_passes_elsewhere_is_said():
    pose = camera_at(pitch_deg=10.0)
    pointing = body_pointing(pose, PHOTO, (500.0, 400.0), SURE_PX)
    with pytest.raises(InputError, match="stays below the horizon on 2026-12-21"):
        times_at(pointing, Sky(20.0, 75.0, 0.0), Body.SUN, date(2026, 12, 21), 20.0)
    with pytest.raises(InputError, match="does not stand there on 2026-06-21: it is nearest at"):
        times_at(pointing, sky_of(pose), Body.SUN, date(2026, 6, 21), pose.lon)

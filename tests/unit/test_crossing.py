"""Rays that cross, with their errors, and rays that do not."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at, perturbed

from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.ground.crossing import Ray, cross
from skyline.photo.skyline import PhotoSkyline

CURVED = Curvature()
SMOKE = np.array([0.0, 4000.0, 1800.0])
SD_DEG = 0.1
WIDTH_PX, HEIGHT_PX = 4000, 3000
PHOTO = PhotoSkyline(np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX), WIDTH_PX, HEIGHT_PX)
ANGLES = np.diag([1e-6] * 3 + [np.radians(SD_DEG) ** 2] * 2 + [0.0] * 3)
SURE_PX = 0.01


def direction_of(pose, place):
    """Return grid azimuth and elevation tangent of a place, seen by a pose's camera."""
    east, north, up = place - (pose.easting_m, pose.northing_m, pose.eye_elevation_m)
    away = np.hypot(east, north)
    return np.degrees(np.arctan2(east, north)), (up - float(CURVED.drop_m(away))) / away


def looking_at(place, east_m, north_m, eye_m=1000.0, covariance=ANGLES, **angles):
    """Return the pose of a camera, 60 degrees wide, with a place in its middle."""
    pose = candidate_at(east_m, north_m, 0.0, eye_elevation_m=eye_m)
    heading_deg, tangent = direction_of(pose, place)
    angles = {"pitch_deg": float(np.degrees(np.arctan(tangent)))} | angles
    pose = candidate_at(east_m, north_m, heading_deg, **angles, eye_elevation_m=eye_m)
    return replace(pose, covariance=tuple(map(tuple, covariance.tolist())))


def ray_of(pose, place, true=None):
    """Return the ray through the pixel that shows a place, to a camera that truly was elsewhere."""
    pixel = (true or pose).camera(PHOTO).pixels(*direction_of(true or pose, place))
    return Ray(pose=pose, photo=PHOTO, pixel=tuple(map(float, pixel)))


def ray_from(east_m, north_m, off_deg=(0.0, 0.0), place=SMOKE):
    """Return a ray towards a place, off by degrees of azimuth and elevation."""
    pose = looking_at(place, east_m, north_m)
    off = {
        "heading_deg": pose.heading_deg + off_deg[0],
        "pitch_deg": pose.pitch_deg + off_deg[1],
    }
    return ray_of(replace(pose, **off), place, pose)


def place_of(found):
    return np.array([found.easting_m, found.northing_m, found.elevation_m])


def test_rays_cross_where_the_smoke_stands():
    found = cross([ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0)], CURVED, SURE_PX)
    np.testing.assert_allclose(place_of(found), SMOKE, atol=0.01)
    assert found.meets
    # Both look across by 45 degrees: 0.1 degrees are 9.9 m over 5.7 km, and two rays halve the
    # variance along either axis: each of them has half of it there.
    sd_m = np.sqrt(np.diag(found.covariance_m2))
    np.testing.assert_allclose(sd_m[:2], np.radians(SD_DEG) * np.hypot(4000.0, 4000.0), rtol=0.02)


def test_a_third_ray_makes_the_place_surer():
    two = [ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0)]
    three = [*two, ray_from(0.0, 0.0)]
    before, after = (np.diag(cross(rays, CURVED, SURE_PX).covariance_m2) for rays in (two, three))
    assert (after < before).all()


def test_rays_that_pass_each_other_are_said_to_miss():
    rays = [ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0, off_deg=(0.0, 1.0))]
    found = cross(rays, CURVED, SURE_PX)
    assert not found.meets
    # Half of the misfit of 10 standard errors is left to each ray: 2 times 5 squared.
    assert found.chi_square == pytest.approx(50.0, rel=0.1)


def test_rays_without_a_crossing_are_refused():
    far = SMOKE + np.array([0.0, 3e6, 0.0])
    with pytest.raises(InputError, match="parallel within their errors"):
        cross([ray_from(-400.0, 0.0, place=far), ray_from(400.0, 0.0, place=far)], CURVED)
    with pytest.raises(InputError, match="cross behind camera"):
        cross([ray_from(-4000.0, 0.0, off_deg=(-120.0, 0.0)), ray_from(4000.0, 0.0)], CURVED)
    with pytest.raises(InputError, match="expected two photos or more"):
        cross([ray_from(0.0, 0.0)], CURVED)


def test_a_pixel_outside_its_photo_is_refused():
    outside = replace(ray_from(4000.0, 0.0), pixel=(4000.0, 1500.0))
    with pytest.raises(InputError, match="pixel 4000,1500 is outside the photo of 4000 x 3000"):
        cross([ray_from(-4000.0, 0.0), outside], CURVED)


def drawn_root(rng, across):
    """Return a root (8, 8) of a covariance: a camera that is aside is turned back, as by a fit.

    ``across`` (2,) points to the camera's right.
    """
    root = np.diag([*rng.uniform(5.0, 40.0, 2), 7.0, *[8e-4] * 3, 3e-3, 5e-3])
    turn = rng.uniform(0.0, np.pi)
    root[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]] @ root[:2, :2]
    skyline_m = rng.uniform(2000.0, 8000.0)
    root[3, :2] = -across @ root[:2, :2] / skyline_m
    root[4, 2] = -root[2, 2] / skyline_m
    return root


def test_crossings_err_as_they_say_where_poses_are_drawn():
    rng = np.random.default_rng(11)
    off_sds, squares, meets = [], [], []
    for _ in range(200):
        base_m = 1000.0 * 20.0 ** rng.uniform()
        place = np.array([*rng.uniform([-1.0, 0.3], [1.0, 1.5]) * base_m, rng.uniform(500, 3000)])
        rays = []
        for east_m in (-base_m / 2.0, base_m / 2.0):
            pose = looking_at(
                place, east_m, 0.0, rng.uniform(800, 2500), roll_deg=rng.uniform(-3, 3)
            )
            turn_deg, tilt_deg = rng.uniform([-15.0, -8.0], [15.0, 8.0])
            heading = np.radians(pose.grid_heading_deg + turn_deg)
            root = drawn_root(rng, np.array([np.cos(heading), -np.sin(heading)]))
            pose = replace(
                pose,
                heading_deg=pose.heading_deg + turn_deg,
                pitch_deg=pose.pitch_deg + tilt_deg,
                covariance=tuple(map(tuple, (root @ root.T).tolist())),
            )
            ray = ray_of(pose, place, perturbed(pose, root @ rng.standard_normal(8)))
            rays.append(replace(ray, pixel=tuple(ray.pixel + rng.normal(0.0, 1.0, 2))))
        found = cross(rays, CURVED)
        off_m = place_of(found) - place
        off_sds.append(off_m / np.sqrt(np.diag(found.covariance_m2)))
        squares.append(off_m @ np.linalg.solve(found.covariance_m2, off_m))
        meets.append(found.meets)
    within = np.mean(np.abs(off_sds) <= 2.0, axis=0)
    assert ((within >= 0.90) & (within <= 0.98)).all()
    # 95 % quantile of chi square with three degrees of freedom.
    assert 0.90 <= np.mean(np.array(squares) <= 7.815) <= 0.98
    assert np.mean(meets) >= 0.97


def test_a_place_that_is_unsure_with_the_heading_is_surer_than_each_alone():
    across = np.array([1.0, 0.0])
    coupled = np.diag([900.0, 1e-6, 1e-6, 30.0**2 / 4000.0**2, 1e-8, 0.0, 0.0, 0.0])
    coupled[0, 3] = coupled[3, 0] = -30.0 * 30.0 / 4000.0
    apart = np.diag(np.diag(coupled))
    sds = []
    for covariance in (coupled, apart):
        # Both look to the north: 30 m east are 30 m of the smoke, turned back over 4 km.
        poses = [looking_at(SMOKE, east_m, 0.0, covariance=covariance) for east_m in (-400, 400)]
        found = cross([ray_of(pose, SMOKE) for pose in poses], CURVED, SURE_PX)
        sds.append(np.sqrt(across @ found.covariance_m2[:2, :2] @ across))
    assert sds[0] < 0.2 * sds[1]

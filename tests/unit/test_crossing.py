"""Rays that cross, with their errors, and rays that do not."""

import numpy as np
import pytest
from scenes import candidate_at

from skyline.crossing import Ray, cross
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.sun_clock import Pointing

CURVED = Curvature()
SMOKE = np.array([0.0, 4000.0, 1800.0])
SD_DEG = 0.1


def ray_from(east_m, north_m, eye_m=1000.0, off_deg=(0.0, 0.0), place=SMOKE):
    """Return a ray towards a place, off by degrees of azimuth and elevation."""
    pose = candidate_at(east_m, north_m, 0.0, eye_elevation_m=eye_m)
    east, north, up = place - (east_m, north_m, eye_m)
    away = np.hypot(east, north)
    azimuth_deg = np.degrees(np.arctan2(east, north)) + pose.convergence_deg + off_deg[0]
    up_deg = np.degrees(np.arctan((up - float(CURVED.drop_m(away))) / away)) + off_deg[1]
    pointing = Pointing(float(azimuth_deg), float(up_deg), np.eye(2) / SD_DEG**2)
    return Ray(pose=pose, pointing=pointing, position_sd_m=0.001, height_sd_m=0.001)


def place_of(found):
    return np.array([found.easting_m, found.northing_m, found.elevation_m])


def test_rays_cross_where_the_smoke_stands():
    found = cross([ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0)], CURVED)
    np.testing.assert_allclose(place_of(found), SMOKE, atol=0.01)
    assert found.meets
    # Both look across by 45 degrees: 0.1 degrees are 9.9 m over 5.7 km, and two rays halve the
    # variance along either axis: each of them has half of it there.
    sd_m = np.sqrt(np.diag(found.covariance_m2))
    np.testing.assert_allclose(sd_m[:2], np.radians(SD_DEG) * np.hypot(4000.0, 4000.0), rtol=0.02)


def test_a_third_ray_makes_the_place_surer():
    two = [ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0)]
    three = [*two, ray_from(0.0, 0.0)]
    before, after = (np.diag(cross(rays, CURVED).covariance_m2) for rays in (two, three))
    assert (after < before).all()


def test_rays_that_pass_each_other_are_said_to_miss():
    rays = [ray_from(-4000.0, 0.0), ray_from(4000.0, 0.0, off_deg=(0.0, 1.0))]
    found = cross(rays, CURVED)
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

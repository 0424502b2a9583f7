"""Priors of a photo's pose: noted positions, and how high eyes stand."""

from dataclasses import replace

import numpy as np
import pytest
from place_scenes import places_of
from ray_scenes import hills, panorama_of, poses, rays_of, seen
from scenes import FRAME
from scipy.integrate import quad

from skyline.match.curves import Curves
from skyline.match.eye_prior import EyeHeightPrior, KnownGround, Standing
from skyline.match.narrowing import Narrowing
from skyline.match.position_prior import PositionPrior
from skyline.match.prior import Prior
from skyline.match.solver import FINE, Solver
from skyline.photo.noted_place import NotedPlace

NOTED = PositionPrior(1000.0, 2000.0, 25.0)
THERE = np.array([1000.0 + 2000.0j])
NORTH = SEA = np.zeros(1)


def density(distance_m, prior=NOTED):
    """Return the density per square metre, relative to a uniform one over 1e9 square metres."""
    return float(np.exp(-prior.cost(THERE + distance_m, SEA, NORTH)[0])) / 1e9


def test_its_probabilities_sum_to_one():
    ring = quad(lambda r: 2.0 * np.pi * r * (density(r) - 0.05 / 1e9), 0.0, np.inf, limit=200)[0]
    assert ring == pytest.approx(0.95, abs=1e-6)


def test_its_compass_is_a_weak_hint():
    looking = replace(NOTED, grid_heading_deg=350.0)
    said = looking.cost(np.repeat(THERE, 3), np.zeros(3), np.radians([350.0, 10.0, 170.0]))
    assert said[0] < said[1] < said[2]
    assert said[2] - said[0] < 4.0
    turns = np.radians(np.linspace(0.0, 360.0, 3601)[:-1])
    cost = looking.cost(np.repeat(THERE, 3600), np.zeros(3600), turns)
    more = np.exp(NOTED.cost(THERE, SEA, NORTH) - cost)
    assert more.mean() == pytest.approx(1.0, abs=1e-3)


def test_its_pull_is_the_slope_of_the_cost():
    heavy = replace(NOTED, elevation_m=50.0, elevation_scale_m=15.0)
    for off_m, eye_m in ((1.0, 2.0), (30.0, 45.0), (300.0, 90.0)):
        place, eye = THERE + off_m, SEA + eye_m
        precision, offset_m = heavy.pull(place, eye)
        pull = (precision * offset_m)[0]
        east = [heavy.cost(place + step, eye, NORTH)[0] for step in (-0.01, 0.01)]
        up = [heavy.cost(place, eye + step, NORTH)[0] for step in (-0.01, 0.01)]
        assert pull[0] == pytest.approx(np.diff(east)[0] / 0.02, rel=1e-4)
        assert pull[1] == 0.0
        assert pull[2] == pytest.approx(np.diff(up)[0] / 0.02, rel=1e-4)
    assert NOTED.pull(THERE, SEA)[0][0, 2] == 0.0


@pytest.mark.parametrize("place_priors", [(NOTED,), ()])
def test_a_step_is_pulled_to_the_noted_place(place_priors):
    rays = rays_of(*seen(hills, 350.0), 60.0)
    solver = Solver(rays, FINE, EyeHeightPrior(2.0, 5.0), 5.0, place_priors)
    eye = THERE + 60.0, SEA, np.zeros((1, 2)), np.full(1, 2.0)
    curves = Curves.of(*panorama_of(hills, distance_m=1e6), *eye)
    fit = solver.settle(curves, solver.start(poses(grid_heading_deg=350.0)))
    east = solver.improve(curves, fit, np.full(1, 1e4)).state[0, 0]
    # Terrain so far away does not constrain the place.
    assert (east < -50.0) == bool(place_priors)


def test_no_eye_is_lower_than_a_camera_is_held():
    assert EyeHeightPrior(2.0, 5.0).range_m == (0.3, 102.0)
    assert EyeHeightPrior(0.0, 0.0).range_m == (0.0, 0.0)


def test_a_circle_swapped_is_named_if_it_meets_the_places_though_its_middle_does_not():
    """The places lie at 46.8; a degree of latitude is 111 km."""
    places = places_of(np.zeros((2, 360)), spacing_m=100.0)
    near, far = (
        Prior.of(Narrowing(near=(46.8 + north_deg, 9.8, 2.0)), FRAME).swap_hint(places)
        for north_deg in (0.01, 0.02)
    )
    assert near == "; longitude and latitude seem to be swapped: give 9.8,46.81"
    assert far == ""


def standings(noted, relief_m=0.0, takeoff_relief_m=10.0):
    """Return the heights at which an eye may stand over ground at 1000 m, likeliest first."""
    found = Standing.of_noted(noted, KnownGround(1000.0, relief_m, takeoff_relief_m, 5.0))
    assert found[0].eye == EyeHeightPrior(2.0, 5.0)
    assert all(one.eye.usual_m > 17.0 for one in found[1:])
    found.sort(key=lambda one: one.cost)
    return [one.eye.usual_m for one in found]


def noted_at(elevation_m=None, takeoff_m=None, accuracy_m=None):
    return NotedPlace(elevation_m=elevation_m, takeoff_height_m=takeoff_m, accuracy_m=accuracy_m)


@pytest.mark.parametrize(
    ("noted", "heights_m"),
    [
        (noted_at(), [2.0]),
        # As high as a person, within the errors of the model, and below the ground.
        (noted_at(1002.0), [2.0]),
        (noted_at(1015.0), [2.0]),
        (noted_at(940.0), [2.0]),
        # Most altitudes are wrong by less than 50 m, and hardly any by 400 m.
        (noted_at(1050.0), [2.0, 50.0]),
        (noted_at(1400.0), [400.0, 2.0]),
        (noted_at(1150.0, accuracy_m=5.0), [150.0, 2.0]),
        # A drone flies. Its own two heights agree, or the altitude is off by the weather.
        (noted_at(1120.0, 120.0), [120.0, 2.0]),
        (noted_at(1220.0, 120.0), [120.0, 220.0, 2.0]),
        (noted_at(None, 60.0), [60.0, 2.0]),
    ],
)
def test_an_eye_stands_on_the_ground_or_as_high_as_a_photo_notes(noted, heights_m):
    assert standings(noted) == heights_m


def test_a_drone_below_its_take_off_is_as_high_as_its_altitude_says():
    assert standings(noted_at(1090.0, -40.0), takeoff_relief_m=60.0) == [90.0, 2.0]


def test_standings_share_one_probability():
    """Of 1,000 photos with an altitude 50 m above the ground, by hand."""
    ground, aloft = Standing.of_noted(noted_at(1050.0), KnownGround(1000.0, 0.0, 10.0, 5.0))
    scale_m = np.hypot(30.0 / np.sqrt(2.0), 15.0)
    on_ground = 0.95 / (np.pi * 5.0) * (1.0 + (48.0 / scale_m) ** 2) ** -1.5
    in_flight = 0.05 * 2.0 / (np.pi * 100.0) / (1.0 + 0.5**2)
    assert aloft.cost - ground.cost == pytest.approx(np.log(on_ground / in_flight))
    assert (aloft.elevation_m, aloft.elevation_scale_m) == (1050.0, pytest.approx(scale_m))
    # On a slope, where the ground is not quite known, an altitude above it says less.
    slope, over_it = Standing.of_noted(noted_at(1050.0), KnownGround(1000.0, 30.0, 10.0, 5.0))
    assert over_it.cost - slope.cost > aloft.cost - ground.cost + 0.4


def test_a_narrowing_holds_plain_numbers_however_they_are_given():
    given = Narrowing(near=np.float32([9.5, 46.5, 2.0]), heading_deg=[140, np.int64(10)])
    assert given == Narrowing(near=(9.5, 46.5, 2.0), heading_deg=(140.0, 10.0))
    assert hash(given) == hash(replace(given))

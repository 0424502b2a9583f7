"""The place that a photo notes as a prior: its density and its pull."""

from dataclasses import replace

import numpy as np
import pytest
from query_scenes import hills, panorama_of, poses, rays_of, seen
from scipy.integrate import quad

from skyline import InputError
from skyline.match.matcher import named_skyline, paths_of
from skyline.match.prior import EyeHeightPrior, Narrowing, PlacePrior
from skyline.match.solver import FINE, Curves, Solver

NOTED = PlacePrior(1000.0, 2000.0, 25.0)
THERE = np.array([1000.0 + 2000.0j])
NORTH = SEA = np.zeros(1)


def density(distance_m, prior=NOTED):
    """Return the density per square metre, relative to a uniform one over 1e9 square metres."""
    return float(np.exp(-prior.cost(THERE + distance_m, SEA, NORTH)[0])) / 1e9


def test_its_probabilities_sum_to_one():
    ring = quad(lambda r: 2.0 * np.pi * r * (density(r) - 0.05 / 1e9), 0.0, np.inf, limit=200)[0]
    assert ring == pytest.approx(0.95, abs=1e-6)


def test_its_compass_is_a_weak_hint():
    looking = replace(NOTED, heading_deg=350.0)
    said = looking.cost(np.repeat(THERE, 3), np.zeros(3), np.radians([350.0, 10.0, 170.0]))
    assert said[0] < said[1] < said[2]
    assert said[2] - said[0] < 4.0
    turns = np.radians(np.linspace(0.0, 360.0, 3601)[:-1])
    cost = looking.cost(np.repeat(THERE, 3600), np.zeros(3600), turns)
    more = np.exp(NOTED.cost(THERE, SEA, NORTH) - cost)
    assert more.mean() == pytest.approx(1.0, abs=1e-3)


def test_its_pull_is_the_slope_of_the_cost():
    heavy = replace(NOTED, elevation_m=50.0, elevation_sd_m=15.0)
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


@pytest.mark.parametrize("prior", [NOTED, None])
def test_a_step_is_pulled_to_the_noted_place(prior):
    query = rays_of(*seen(hills, 350.0), 60.0)
    solver = Solver(query, FINE, EyeHeightPrior(2.0, 5.0), 5.0, prior)
    eye = THERE + 60.0, SEA, np.zeros((1, 2)), np.full(1, 2.0)
    curves = Curves.of(*panorama_of(hills, distance_m=1e6), *eye)
    fit = solver.settle(curves, solver.start(poses(heading_deg=350.0)))
    east = solver.improve(curves, fit, np.full(1, 1e4)).state[0, 0]
    # Terrain so far away does not constrain the place.
    assert (east < -50.0) == (prior is not None)


@pytest.mark.parametrize(
    ("field", "given"),
    [
        ("near", (9.8, 46.8)), ("near", "123"), ("near", (None, 46.8, 2.0)),
        ("bounds_deg", (9.8, 46.9, 9.9, 46.7)), ("bounds_deg", "9,46,10,47"),
        ("heading_deg", 140.0), ("heading_deg", ("N", "10")), ("elevation_m", 900.0),
        ("eye_height_m", "low"), ("eye_height_m", -1.0),
    ],
)  # fmt: skip
def test_a_narrowing_of_other_than_its_numbers_is_refused(field, given):
    with pytest.raises(InputError, match="expected"):
        Narrowing(**{field: given})


def test_a_narrowing_holds_plain_numbers_however_they_are_given():
    given = Narrowing(near=np.float32([9.5, 46.5, 2.0]), heading_deg=["140", np.int64(10)])
    assert given == Narrowing(near=(9.5, 46.5, 2.0), heading_deg=(140.0, 10.0))
    assert hash(given) == hash(replace(given))


@pytest.mark.parametrize(
    ("refused", "said"),
    [
        (lambda: named_skyline(["photo.jpg"]), "of type list; expected one path"),
        (lambda: named_skyline("photo.jpg", "wide"), "expected a number of degrees"),
        (lambda: paths_of(b"store.h5"), "expected the path of a store"),
    ],
)
def test_arguments_of_another_type_are_refused(refused, said):
    with pytest.raises(InputError, match=said):
        refused()

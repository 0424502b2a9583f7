"""Distinct poses among hypotheses, and candidates in degrees and from true north."""

import dataclasses

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from query_scenes import poses
from scenes import candidate_at

from skyline.geodesy import Frame

MIDDLES = {
    "EPSG:32632": (11.8, 46.8),
    "EPSG:2056": (9.8, 46.8),
    "EPSG:3413": (25.0, 78.0),
    "EPSG:2193": (168.7, -44.6),
}
FRAMES = {name: Frame.from_crs(name) for name in MIDDLES}


@given(
    name=st.sampled_from(sorted(FRAMES)),
    east_m=st.floats(-2e4, 2e4),
    north_m=st.floats(-2e4, 2e4),
    grid_heading_deg=st.floats(0.0, 360.0, exclude_max=True),
)
def test_places_and_headings_go_to_degrees_and_back(name, east_m, north_m, grid_heading_deg):
    frame = FRAMES[name]
    easting_m, northing_m = np.add(frame.from_lonlat(*MIDDLES[name]), [east_m, north_m])
    found = candidate_at(easting_m, northing_m, grid_heading_deg, frame=frame)
    assert 0.0 <= found.heading_deg < 360.0
    back = frame.from_lonlat(found.lon, found.lat)
    np.testing.assert_allclose(back, [easting_m, northing_m], atol=1e-4)
    turn = (found.grid_heading_deg - grid_heading_deg + 180.0) % 360.0 - 180.0
    assert abs(turn) < 1e-9
    # A step along the grid heading goes the true way that the candidate says it looks.
    along = np.radians(grid_heading_deg)
    step = easting_m + 10.0 * np.sin(along), northing_m + 10.0 * np.cos(along)
    lon, lat = frame.to_lonlat(*step)
    east = (lon - found.lon) * np.cos(np.radians(found.lat))
    # On the sphere; the ellipsoid's radii differ by less than a hundredth.
    went = np.degrees(np.arctan2(east, lat - found.lat))
    assert abs((went - found.heading_deg + 180.0) % 360.0 - 180.0) < 0.5


@given(sd_m=st.floats(0.1, 500.0), seed=st.integers(0, 100))
def test_68_of_100_draws_about_a_pose_lie_within_its_radius(sd_m, seed):
    covariance_m2 = ((sd_m**2, 0.0), (0.0, sd_m**2))
    found = dataclasses.replace(candidate_at(0.0, 0.0, 0.0), covariance_m2=covariance_m2)
    drawn = np.random.default_rng(seed).normal(0.0, sd_m, (20_000, 2))
    within = np.hypot(*drawn.T) <= found.radius_m
    # Five standard deviations of such a share.
    assert within.mean() == pytest.approx(0.68, abs=5.0 * np.sqrt(0.68 * 0.32 / 20_000))


def test_the_best_pose_of_a_place_and_a_way_of_looking_stands_for_it():
    east_m = [0.0, 10.0, 500.0, 505.0]
    some = poses(4, easting_m=east_m, heading_deg=[0, 90, 0, 0], score=[2.0, 1.0, 3.0, 3.0])
    assert some.suppress_non_maxima(9, separation_m=100.0).tolist() == [1, 2]
    turned = poses(3, heading_deg=[359.0, 2.0, 90.0], score=[1.0, 2.0, 3.0])
    assert turned.suppress_non_maxima(9, separation_m=100.0, turn_deg=10.0).tolist() == [0, 2]
    lost = poses(3, easting_m=[0.0, 500.0, 900.0], score=[np.inf, 1.0, 2.0])
    assert lost.suppress_non_maxima(1, separation_m=1.0).tolist() == [1]
    assert lost.suppress_non_maxima(5, separation_m=1.0).tolist() == [1, 2]


def test_a_pose_has_rivals_at_other_places_and_in_other_directions():
    east_m = [0.0, 50.0, 900.0]
    some = poses(3, easting_m=east_m, heading_deg=[350.0, 100.0, 5.0], score=[1.0, 4.0, 9.0])
    assert some.rival_margin(200.0).tolist() == [8.0, 5.0, -8.0]
    assert some.rival_margin(200.0, turn_deg=30.0).tolist() == [3.0, -3.0, -8.0]
    assert np.isinf(some[:1].rival_margin(200.0)).all()

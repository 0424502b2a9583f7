"""Retrieval: poses found back among places."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from place_scenes import AZIMUTH_DEG, curve, places_of, rays

from skyline.match.query_rays import QueryRays
from skyline.match.retrieval import Retriever


@pytest.fixture(scope="module")
def places():
    return places_of(np.stack([curve(seed, AZIMUTH_DEG) for seed in range(40)]))


def turned(heading_deg, other_deg):
    return abs((heading_deg - other_deg + 180.0) % 360.0 - 180.0)


@given(
    seed=st.integers(0, 39),
    heading=st.floats(0.0, 360.0),
    pitch=st.floats(-5.0, 5.0),
    roll=st.floats(-5.0, 5.0),
)
@settings(max_examples=25)
def test_a_pose_is_found_back_whatever_the_heading(places, seed, heading, pitch, roll):
    found = Retriever(places).shortlist(rays(seed, heading, pitch_deg=pitch, roll_deg=roll), 3)
    assert abs(found.easting_m[0] - 100.0 * seed) < 50.0
    assert turned(found.heading_deg[0], heading) < 0.3
    assert found.pitch_deg[0] == pytest.approx(pitch, abs=0.3)
    assert found.roll_deg[0] == pytest.approx(roll, abs=0.3)
    assert found.fov_deg[0] == 60.0
    assert (np.diff(found.score) >= 0.0).all()


def test_the_field_of_view_is_found_within_its_range_and_never_outside(places):
    true = rays(5, 30.0)
    wrong = true.with_fov(63.0)
    query = QueryRays(wrong.u, wrong.v, wrong.weight, 63.0, (57.0, 66.0))
    found = Retriever(places).shortlist(query, 5)
    assert found.easting_m[0] == pytest.approx(500.0, abs=50.0)
    assert found.fov_deg[0] == pytest.approx(60.0, abs=0.5)
    narrow = QueryRays(wrong.u, wrong.v, wrong.weight, 63.0, (61.0, 66.0))
    found = Retriever(places).shortlist(narrow, 5)
    assert ((found.fov_deg >= 61.0) & (found.fov_deg <= 66.0)).all()


def test_the_eye_follows_the_ground():
    y = np.stack([curve(3, AZIMUTH_DEG)])
    entry = places_of(y, 500.0)
    found = Retriever(entry, lambda east, north: 0.3 * east - 0.2 * north).shortlist(
        rays(3, 77.0), 1
    )
    expected = 1000.0 + 0.3 * found.easting_m - 0.2 * found.northing_m
    np.testing.assert_allclose(found.eye_elevation_m, expected, atol=1e-3)

"""Retrieval: the fast coarse score against plain loops, and poses found back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyline.errors import InputError
from skyline.matching import QueryRays
from skyline.matching.dense import UNKNOWN_Y, Y_STEP, DenseProfiles
from skyline.matching.phases import PHASES, Phases
from skyline.matching.retrieval import RetrievalConfig, Retriever
from skyline.prediction.panorama import depth_code

BINS = 720
FAR_M = 20_000.0


def curve(seed, azimuth_deg):
    """Return a rugged skyline at azimuths."""
    generator = np.random.default_rng(seed)
    order = np.arange(2, 40)
    amplitude = generator.normal(size=(2, len(order))) * 0.06 / order
    angle = np.multiply.outer(np.radians(azimuth_deg), order)
    return 0.2 + np.cos(angle) @ amplitude[0] + np.sin(angle) @ amplitude[1]


def dense_of(y, distance_m=FAR_M, spacing_m=100.0, slope=(0.0, 0.0)):
    """Make entries of profiles (L, B) in a row from west to east."""
    known = np.isfinite(y)
    steps = np.where(known, np.rint(np.where(known, y, 0.0) / Y_STEP), UNKNOWN_Y)
    distance = np.broadcast_to(np.float32(distance_m), y.shape)
    return DenseProfiles(
        np.arange(len(y)) * spacing_m,
        np.zeros(len(y)),
        np.full(len(y), 1000.0),
        np.tile(np.array(slope, dtype=np.float32), (len(y), 1)),
        steps.astype(np.int16),
        depth_code(np.ascontiguousarray(distance)).astype(np.uint8),
    )


@pytest.fixture(scope="module")
def places():
    return dense_of(np.stack([curve(seed, np.arange(BINS) / 2.0) for seed in range(40)]))


def photo(skyline, heading_deg, fov_deg=60.0, pitch_deg=0.0, roll_deg=0.0, columns=320):
    """Return rays (u, v) of a camera that sees the skyline tangent(azimuth_deg)."""
    azimuth = np.radians(np.linspace(-80.0, 80.0, 4001))
    up = skyline(np.degrees(azimuth) + heading_deg)
    right, forward = np.sin(azimuth), np.cos(azimuth)
    pitch, roll = np.radians([pitch_deg, roll_deg])
    ahead = forward * np.cos(pitch) + up * np.sin(pitch)
    above = up * np.cos(pitch) - forward * np.sin(pitch)
    x = (right * np.cos(roll) - above * np.sin(roll)) / ahead
    y = (right * np.sin(roll) + above * np.cos(roll)) / ahead
    u = np.tan(np.radians(fov_deg / 2.0)) * ((2 * np.arange(columns) + 1) / columns - 1)
    return u, np.interp(u, x, y)


def rays(seed, heading_deg, fov_deg=60.0, **pose):
    u, v = photo(lambda azimuth: curve(seed, azimuth), heading_deg, fov_deg, **pose)
    return QueryRays.equally_trusted(u, v, fov_deg)


def turned(a, b):
    return abs((a - b + 180.0) % 360.0 - 180.0)


@given(seed=st.integers(0, 1000), heading=st.floats(0.0, 360.0))
@settings(max_examples=15, deadline=None)
def test_the_fast_score_is_the_plain_sum_of_the_kernel(seed, heading):
    generator = np.random.default_rng(seed)
    y = np.stack([curve(seed + k, np.arange(BINS) / 2.0) for k in range(3)])
    y[generator.random(y.shape) < 0.05] = np.nan
    phases = Phases.of(dense_of(y), 180, 120.0)
    query = rays(seed, heading)
    fast = phases.sums(slice(None), phases.query_spectra(query, np.array([60.0])))[0]
    held = dense_of(y).y().astype(np.float64)
    waves = phases.query_waves(query)
    weight, angle = np.abs(waves), np.angle(waves)
    run = BINS // 180
    means = np.roll(held, run // 2, axis=1).reshape(3, 180, run).mean(axis=2)
    rise = np.roll(means, -1, axis=1) - means
    plain = np.zeros_like(fast, dtype=np.float64)
    for entry in range(3):
        for turn in range(180):
            for bin_ in np.flatnonzero(weight):
                there = rise[entry, (bin_ + turn) % 180]
                if np.isfinite(there):
                    plain[entry, turn] += weight[bin_] * np.cos(120.0 * there - angle[bin_])
    # A phase is within half a step of its code, and a cosine changes no faster than its angle.
    bound = weight.sum() * (np.pi / PHASES + 1e-4)
    assert np.abs(fast - plain).max() <= bound


@given(
    seed=st.integers(0, 39),
    heading=st.floats(0.0, 360.0),
    pitch=st.floats(-5.0, 5.0),
    roll=st.floats(-5.0, 5.0),
)
@settings(max_examples=25, deadline=None)
def test_a_pose_is_found_back_whatever_the_heading(places, seed, heading, pitch, roll):
    found = Retriever(places).shortlist(rays(seed, heading, pitch_deg=pitch, roll_deg=roll), 3)
    assert abs(found.easting_m[0] - 100.0 * seed) < 50.0
    assert turned(found.heading_deg[0], heading) < 0.3
    assert found.pitch_deg[0] == pytest.approx(pitch, abs=0.3)
    assert found.roll_deg[0] == pytest.approx(roll, abs=0.3)
    assert found.fov_deg[0] == 60.0
    assert (np.diff(found.score) >= 0.0).all()


@pytest.mark.parametrize("heading", [0.0, 44.9, 45.0, 135.2, 225.0, 315.0, 359.9])
def test_the_seams_of_the_headings_are_nothing_special(places, heading):
    found = Retriever(places).shortlist(rays(7, heading), 1)
    assert found.easting_m[0] == pytest.approx(700.0, abs=50.0)
    assert turned(found.heading_deg[0], heading) < 0.3


def test_a_fifth_of_the_columns_may_be_wrong(places):
    query = rays(11, 200.0)
    v = query.v.copy()
    v[100:164] += 0.05
    found = Retriever(places).shortlist(QueryRays.equally_trusted(query.u, v, 60.0), 1)
    assert found.easting_m[0] == pytest.approx(1100.0, abs=50.0)
    assert turned(found.heading_deg[0], 200.0) < 0.5


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


def test_an_unknown_field_of_view_is_searched_widely(places):
    wrong = rays(9, 120.0, fov_deg=45.0).with_fov(70.0)
    query = QueryRays(wrong.u, wrong.v, wrong.weight, 70.0, (25.0, 100.0))
    found = Retriever(places).shortlist(query, 1)
    assert found.easting_m[0] == pytest.approx(900.0, abs=50.0)
    assert found.fov_deg[0] == pytest.approx(45.0, abs=1.0)


def test_a_place_between_entries_is_found():
    # Walls around a square 800 m wide, with battlements; the eye stands off its middle.
    def wall(east, north):
        def skyline(azimuth_deg):
            azimuth = np.radians(azimuth_deg)
            steps = [
                np.where(np.cos(azimuth - turn) > 1e-6, 1.0 / np.cos(azimuth - turn), np.inf) * gap
                for turn, gap in zip(
                    np.arange(4) * np.pi / 2,
                    (400.0 - north, 400.0 - east, 400.0 + north, 400.0 + east),
                    strict=True,
                )
            ]
            distance = np.min(np.where(np.array(steps) > 0.0, steps, np.inf), axis=0)
            x, z = east + distance * np.sin(azimuth), north + distance * np.cos(azimuth)
            height = 120.0 + 8.0 * np.sin(x / 23.0) + 8.0 * np.cos(z / 31.0)
            return height / distance, distance

        return skyline

    y, distance_m = wall(0.0, 0.0)(np.arange(BINS) / 2.0)
    entry = dense_of(y[np.newaxis], distance_m)
    u, v = photo(lambda azimuth: wall(12.0, -9.0)(azimuth)[0], 250.0)
    found = Retriever(entry).shortlist(QueryRays.equally_trusted(u, v, 60.0), 1)
    assert np.hypot(found.easting_m[0] - 12.0, found.northing_m[0] + 9.0) < 6.0
    assert turned(found.heading_deg[0], 250.0) < 0.7


def test_the_eye_follows_the_ground():
    y = np.stack([curve(3, np.arange(BINS) / 2.0)])
    entry = dense_of(y, 500.0, slope=(0.3, -0.2))
    found = Retriever(entry).shortlist(rays(3, 77.0), 1)
    expected = 1000.0 + 0.3 * found.easting_m - 0.2 * found.northing_m
    np.testing.assert_allclose(found.eye_elevation_m, expected, atol=1e-3)


def test_missing_headings_do_not_stop_the_others():
    y = np.stack([curve(seed, np.arange(BINS) / 2.0) for seed in range(20)])
    y[:, 450:] = np.nan
    found = Retriever(dense_of(y)).shortlist(rays(4, 100.0), 1)
    assert found.easting_m[0] == pytest.approx(400.0, abs=50.0)
    assert turned(found.heading_deg[0], 100.0) < 0.3


def test_hypotheses_differ_in_place_or_in_heading(places):
    config = RetrievalConfig(separation_m=250.0, turn_deg=20.0)
    found = Retriever(places, config).shortlist(rays(20, 10.0), 10)
    assert len(found) > 2
    apart = np.abs(found.easting_m[:, np.newaxis] - found.easting_m)
    turn = np.abs(turned_each(found.heading_deg))
    differ = (apart >= 250.0) | (turn > 20.0) | np.eye(len(found), dtype=bool)
    assert differ.all()


def turned_each(heading_deg):
    return (heading_deg[:, np.newaxis] - heading_deg + 180.0) % 360.0 - 180.0


@pytest.mark.parametrize("level", [0.0, 0.3])
def test_a_flat_skyline_is_answered(places, level):
    u = np.linspace(-0.5, 0.5, 200)
    found = Retriever(places).shortlist(QueryRays.equally_trusted(u, u * 0 + level, 53.0), 4)
    assert len(found) == 4
    assert np.isfinite(found.score).all()


@pytest.mark.parametrize("columns", [1, 2, 5])
def test_hardly_any_columns_are_answered(places, columns):
    u = np.linspace(-0.01, 0.01, columns) + 0.3
    found = Retriever(places).shortlist(QueryRays.equally_trusted(u, 0.1 + u * 0, 60.0), 4)
    assert np.isfinite(found.score).all()


def test_profiles_of_nothing_are_answered():
    found = Retriever(dense_of(np.full((3, BINS), np.nan))).shortlist(rays(0, 0.0), 2)
    assert np.isfinite(found.score).all()


def test_senseless_requests_are_refused(places):
    with pytest.raises(InputError, match="count is 0"):
        Retriever(places).shortlist(rays(0, 0.0), 0)
    for bins in (77, 45):
        with pytest.raises(InputError, match="divide"):
            Retriever(places, RetrievalConfig(coarse_bins=bins))
    with pytest.raises(InputError, match="above 0"):
        RetrievalConfig(fitted=0)

"""Profiles and their two matchers against exact skylines and plain loops."""

import numpy as np
import pytest
from ray_scenes import equally_trusted, photographed
from scenes import field_of, fractal

from skyline.match.prior import NOTHING_KNOWN
from skyline.paper.correlation import CorrelationMatcher, Profiles, at_pitches
from skyline.paper.curves import chamfer_px, plausible, ransac_maps
from skyline.paper.matcher import PaperMatcher
from skyline.skylines import polyline_vertices
from skyline.survey.plans import uniform_grid
from skyline_bench.truth import oracle

MATCHERS = PaperMatcher, CorrelationMatcher
TERRAIN = field_of(fractal(160, 160, 600.0, seed=2, exponent=1.9))
CENTRE = (1200.0, -3600.0, 3600.0, -1200.0)


@pytest.fixture(scope="module")
def viewpoints():
    return uniform_grid(TERRAIN, 400.0, CENTRE)


@pytest.fixture(scope="module")
def profiles(viewpoints):
    views = oracle.skyline(TERRAIN, viewpoints, 320)
    return Profiles.from_views([(views, polyline_vertices(views.v, 2.0 / views.width))])


def panorama(viewpoints, index):
    """Azimuth in degrees and elevation tangent of an exact, finer skyline."""
    views = oracle.skyline(TERRAIN, viewpoints[index : index + 1], 1280)
    return views.grid_azimuth_deg().ravel(), np.tan(np.radians(views.elevation_deg())).ravel()


def query_at(viewpoints, index, heading_deg, pitch_deg=0.0):
    """Rays of a camera with a 60 degree field of view, with noise."""
    azimuth_deg, y = panorama(viewpoints, index)
    y += np.random.default_rng(0).normal(0.0, 0.001, y.shape)
    u, v = photographed(np.radians(azimuth_deg), y, heading_deg, pitch_deg, 0.0, 60.0)
    return equally_trusted(u, v, 60.0)


def test_profiles_join_the_headings_without_a_seam(profiles, viewpoints):
    azimuth_deg, y = panorama(viewpoints, 5)
    expected = np.interp(np.arange(2048) * 360.0 / 2048, azimuth_deg, y, period=360.0)
    east_m, north_m = viewpoints.easting_m[5], viewpoints.northing_m[5]
    away_m = np.hypot(profiles.eyes.easting_m - east_m, profiles.eyes.northing_m - north_m)
    error = np.abs(profiles.y[np.argmin(away_m)] - expected)
    # A bin is 0.2 degrees; cliffs between bins are where two samplings may part.
    assert np.median(error) < 1e-3
    assert np.mean(error > 0.02) < 0.02


@pytest.mark.parametrize("prepared", MATCHERS)
def test_stored_places_are_found_with_their_heading(profiles, viewpoints, prepared):
    matcher = prepared(profiles)
    # 44.9 and 315 look across the seams between headings, 359.5 across north.
    right = 0
    cases = [(3, 44.9), (9, 315.0), (17, 359.5), (22, 200.0), (30, 100.0), (41, 271.0)]
    for index, heading_deg in cases:
        best, true = (
            matcher.search(query_at(viewpoints, index, heading_deg), NOTHING_KNOWN, 3),
            viewpoints,
        )
        east_m = best.easting_m[0] - true.easting_m[index]
        north_m = best.northing_m[0] - true.northing_m[index]
        off_deg = abs((best.grid_heading_deg[0] - heading_deg + 180.0) % 360.0 - 180.0)
        right += np.hypot(east_m, north_m) < 1.0 and off_deg < 1.0
    # Keypoints are the paper's weak spot: now and then a low skyline has too few.
    assert right >= (len(cases) if isinstance(matcher, CorrelationMatcher) else len(cases) - 1)


def test_correlation_equals_a_direct_loop(profiles, viewpoints):
    query = query_at(viewpoints, 7, 77.0)
    fits = CorrelationMatcher(profiles).fit(query)
    for location in (0, 7, 20):
        best = -np.inf
        for _, y, weights in at_pitches(query, profiles.bins):
            seen = np.flatnonzero(weights > 0.0)
            q, weight = y[seen], weights[seen]
            for turn in range(profiles.bins):
                p = profiles.y[location, (seen + turn) % profiles.bins].astype(np.float64)
                a, b = q - np.average(q, weights=weight), p - np.average(p, weights=weight)
                off = np.sqrt(np.sum(weight * a * a) * np.sum(weight * b * b))
                best = max(best, np.sum(weight * a * b) / off)
        assert 1.0 - fits.cost[location] == pytest.approx(best, abs=1e-4)


def test_chamfer_distance_is_the_mean_of_nearest_points():
    generator = np.random.default_rng(4)
    a, b = generator.normal(size=(2, 5, 9)).astype(np.float32) * 3.0
    x = np.arange(9) * 2.0
    found = chamfer_px(a, b, 2.0)
    for row in range(5):
        p, q = np.stack([x, a[row]], axis=1), np.stack([x, b[row]], axis=1)
        apart = np.linalg.norm(p[:, np.newaxis] - q, axis=2)
        expected = (apart.min(axis=1).mean() + apart.min(axis=0).mean()) / 2.0
        assert found[row] == pytest.approx(expected, rel=1e-4)


def test_degenerate_queries_have_an_answer(profiles):
    for prepared in MATCHERS:
        for query in (
            equally_trusted(np.linspace(-0.5, 0.5, 200), np.zeros(200), 60.0),
            equally_trusted(np.array([0.0]), np.array([0.1]), 60.0),
            equally_trusted(np.array([-0.1, 0.1]), np.array([0.1, 0.2]), 60.0),
        ):
            assert np.isfinite(prepared(profiles).search(query, NOTHING_KNOWN, 3).cost).all()


@pytest.mark.parametrize(("index", "heading_deg"), [(9, 315.0), (30, 100.0)])
def test_listed_poses_cost_as_much_as_without_a_shortlist(profiles, viewpoints, index, heading_deg):
    query = query_at(viewpoints, index, heading_deg)
    every, listed = (
        PaperMatcher(profiles, pitches_deg=(0.0,), listed=most).fit(query) for most in (100_000, 8)
    )
    chosen = np.isfinite(listed.cost)
    assert 1 < chosen.sum() < np.isfinite(every.cost).sum()
    np.testing.assert_allclose(listed.cost[chosen], every.cost[chosen], rtol=1e-6)
    assert listed.cost.argmin() == every.cost.argmin()


def correspondences(seed, sets=20, points=30):
    """Return points, where affine maps put them, 40 % of them wrong, and which are used."""
    generator = np.random.default_rng(seed)
    source = generator.uniform(-150.0, 150.0, (points, 2)) * [1.0, 0.3]
    maps = np.eye(2, 3) + generator.normal(0.0, 0.04, (sets, 2, 3)) * [1.0, 1.0, 500.0]
    target = source @ maps[:, :, :2].swapaxes(1, 2) + maps[:, np.newaxis, :, 2]
    wrong = generator.random((sets, points)) < 0.4
    target[wrong] += generator.uniform(-80.0, 80.0, (wrong.sum(), 2))
    used = generator.random((sets, points)) < 0.8
    target[~used] = np.nan
    return source, target, used, maps


def test_ransac_recovers_maps_among_wrong_correspondences():
    source, target, used, true = correspondences(6)
    right = plausible(true)
    assert right.sum() > 10
    found = ransac_maps(source, target, used)
    moved = source @ np.swapaxes(found[right, :, :2], 1, 2) + found[right, np.newaxis, :, 2]
    expected = source @ np.swapaxes(true[right, :, :2], 1, 2) + true[right, np.newaxis, :, 2]
    assert np.abs(moved - expected).max() < 1.0


def test_ransac_gives_a_set_the_same_map_whatever_is_beside_it():
    source, target, used, _ = correspondences(7)
    together = ransac_maps(source, target, used)
    alone = [ransac_maps(source, target[k : k + 1], used[k : k + 1])[0] for k in range(20)]
    np.testing.assert_array_equal(together, alone)


def test_plausible_maps_are_those_of_singular_values_and_turn():
    maps = np.eye(2, 3) + np.random.default_rng(9).normal(0.0, 0.3, (500, 2, 3))
    scales = np.linalg.svd(maps[:, :, :2], compute_uv=False)
    turn_deg = np.degrees(np.arctan2(maps[:, 1, 0], maps[:, 0, 0]))
    expected = np.linalg.det(maps[:, :, :2]) > 0.0
    expected &= (scales[:, 0] <= 1.25) & (scales[:, 1] >= 0.8) & (np.abs(turn_deg) <= 15.0)
    assert 10 < expected.sum() < 400
    np.testing.assert_array_equal(plausible(maps), expected)
    assert not plausible(np.full((1, 2, 3), np.nan))[0]

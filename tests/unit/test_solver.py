"""Poses fitted to rays, where the answer is known and where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from ray_scenes import hills, panorama_of, poses, rays_of, seen, swept

from skyline.camera.projection import Projection
from skyline.camera.warps import distorted, wander_ways
from skyline.geodesy.earth import Curvature
from skyline.match.curves import Curves
from skyline.match.eye_prior import EyeHeightPrior
from skyline.match.lens_prior import LensPrior
from skyline.match.rays import Rays
from skyline.match.solver import FINE, Solver, SolverMode
from skyline.pose.pose_errors import HEADING, PITCH
from skyline.terrain.data_edge import DataEdge

TRUTH = {"heading_deg": 350.0, "pitch_deg": 2.0, "roll_deg": -1.5}
SWEPT = 200.0, 4.0, 230.0
"""A panorama's heading, how far its middle row is above the horizon, and its width, degrees."""
EYE = EyeHeightPrior(2.0, 5.0)
HEIGHT_SD_M = 5.0


LONG = SolverMode(steps=8, choices=4, nodes=0)


def curves_of(y, distance_m):
    """Return curves of eyes on level ground, at the usual height."""
    count = len(y)
    position_m, ground_m = np.zeros(count, dtype=complex), np.zeros(count)
    eye_height_m = np.full(count, EYE.usual_m)
    return Curves.of(y, distance_m, position_m, ground_m, np.zeros((count, 2)), eye_height_m)


def settled(hypotheses, panoramas, rays, edge=None):
    """Solve heading, pitch, roll and field of view of hypotheses where they stand."""
    solver = Solver(rays, LONG, EYE, HEIGHT_SD_M, edge=edge)
    curves = curves_of(*panoramas)
    fit = solver.settle(curves, solver.start(hypotheses))
    return solver.poses(curves, fit)


LENS = rays_of(*seen(hills, **TRUTH), 60.0)


@pytest.mark.parametrize(
    "rays",
    [
        LENS,
        replace(LENS, distortion_sd=0.05),
        swept(hills, *SWEPT),
        swept(hills, *SWEPT, Projection.EQUIRECTANGULAR),
    ],
)
def test_derivatives_agree_with_differences(rays):
    solver = Solver(rays, FINE, EYE, HEIGHT_SD_M)
    curves = curves_of(*panorama_of(hills))
    warp = [0.05, 0.02, -0.01, 0.03]
    state = np.array([[0.0, 0.0, 3.0, np.radians(351.0), 0.03, -0.02, 0.04, *warp]])
    state = state[:, : solver.size]
    steps = np.diag([1.0, 1.0, 1.0, 2e-3, 1e-4, 1e-4, 1e-4, *np.full(4, 1e-3)])
    steps = steps[: solver.size, : solver.size]
    there = curves.linearized(solver.rays, state)
    for k, move in enumerate(steps):
        after, before = (
            curves.linearized(solver.rays, state + sign * move).residual_rad[0]
            for sign in (1.0, -1.0)
        )
        expected = (after - before) / (2.0 * move[k])
        # Curves are linear between bins, so slopes agree on average, not at every point; and
        # the factor from tangents to angles counts as constant.
        off = there.jacobian[0, k] - expected
        assert np.sqrt(np.mean(off**2)) < 0.05 * np.sqrt(np.mean(expected**2)) + 1e-9, k


def test_a_wide_lens_finds_its_distortion():
    u, v = seen(hills, heading_deg=350.0, pitch_deg=2.0, roll_deg=-1.5, fov_deg=100.0)
    half_width = np.tan(np.radians(50.0))
    bent = half_width * np.stack(distorted(u / half_width, v / half_width, 0.1))
    true = Rays(u=bent[0], v=bent[1], weight=np.ones_like(u), fov_deg=100.0)
    free = replace(true, distortion_sd=0.05)
    found = settled(poses(grid_heading_deg=348.0, fov_deg=100.0), panorama_of(hills), free)
    straight = settled(poses(grid_heading_deg=348.0, fov_deg=100.0), panorama_of(hills), true)
    assert found.distortion[0] == pytest.approx(0.1, abs=0.005)
    assert found.grid_heading_deg[0] == pytest.approx(350.0, abs=0.02)
    assert straight.distortion[0] == 0.0
    assert found.cost[0] < straight.cost[0]


def test_a_panorama_whose_rows_wander_finds_its_heading():
    wander = np.radians([1.2, -0.5, 0.3, 0.2])
    rays = swept(hills, *SWEPT)
    rays = replace(rays, v=rays.v - wander_ways(np.linspace(-1.0, 1.0, len(rays.u))) @ wander)
    solver = Solver(rays, LONG, EYE, HEIGHT_SD_M)
    curves = curves_of(*panorama_of(hills))
    start = poses(grid_heading_deg=203.0, fov_deg=SWEPT[2])
    fit = solver.settle(curves, solver.start(start))
    assert np.degrees(fit.state[0, HEADING]) == pytest.approx(SWEPT[0], abs=0.02)
    assert np.degrees(fit.state[0, PITCH]) == pytest.approx(SWEPT[1], abs=0.1)
    np.testing.assert_allclose(solver.poses(curves, fit).wander[0], wander, atol=np.radians(0.1))
    assert solver.poses(curves, fit).distortion is None


@pytest.mark.parametrize("raised_deg", [-25.0, 25.0])
def test_a_sphere_cropped_far_from_the_horizon_is_levelled_exactly(raised_deg):
    rays = swept(hills, 200.0, raised_deg, 230.0, Projection.EQUIRECTANGULAR)
    rays = rays.with_fov(228.0).about(2.0)
    start = poses(grid_heading_deg=203.0, pitch_deg=0.8 * raised_deg, fov_deg=228.0)
    found = settled(start, panorama_of(hills), rays)
    assert found.grid_heading_deg[0] == pytest.approx(200.0, abs=0.02)
    assert found.pitch_deg[0] == pytest.approx(raised_deg, abs=0.1)
    assert found.fov_deg[0] == pytest.approx(230.0, abs=0.05)


def _edge(tangent):
    """Return an edge 10 to 14 km off, past which terrain rises to a tangent at least."""
    highest_m = np.full((4, 1), EYE.usual_m + tangent * 10_000.0 * np.sqrt(2.0))
    return DataEdge((-1e4, -1e4, 1e4, 1e4), highest_m, Curvature(enabled=False))


def test_a_range_past_the_edge_speaks_less_against_the_right_place():
    def with_range(azimuth_rad):
        return np.maximum(hills(azimuth_rad), 0.145 + 0.02 * np.sin(23.0 * azimuth_rad))

    shown = np.radians(np.arange(320.0, 380.0))
    assert 0.3 < np.mean(with_range(shown) > hills(shown)) < 0.6
    rays = rays_of(*seen(with_range, **TRUTH), 60.0)
    places = [panorama_of(hills), panorama_of(lambda azimuth: hills(azimuth + 0.4))]
    start = poses(grid_heading_deg=350.0)

    def scores(edge):
        return [settled(start, place, rays, edge).cost[0] for place in places]

    assert scores(_edge(-1.0)) == scores(None)
    (right, wrong), (right_without, wrong_without) = scores(_edge(0.17)), scores(None)
    assert right < right_without - 100.0
    assert wrong - right > wrong_without - right_without + 20.0


@pytest.mark.parametrize(("low", "high", "expected"), [(63.0, 70.0, 63.0), (50.0, 57.0, 57.0)])
def test_the_field_of_view_keeps_to_its_range(low, high, expected):
    rays = rays_of(*seen(hills, **TRUTH), 60.0, (low + high) / 2.0, (low, high))
    found = settled(poses(grid_heading_deg=350.0, fov_deg=1.0), panorama_of(hills), rays)
    assert found.fov_deg[0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(("relief", "noise"), [(1.0, 0.002), (1.0, 0.006), (0.15, 0.006)])
def test_noise_makes_no_lens_narrower(relief, noise):
    # Errors are of pixels: a narrower lens makes smaller angles of them, which must not pay.
    def skyline(azimuth_rad):
        return 0.15 + relief * (hills(azimuth_rad) - 0.15)

    u, v = seen(skyline, **TRUTH)
    found = []
    for seed in range(6):
        noisy = v + np.random.default_rng(seed).normal(0.0, noise, len(v))
        rays = replace(rays_of(u, noisy, 60.0, 60.0, (30.0, 90.0)), lens=LensPrior(0.06))
        start = poses(grid_heading_deg=350.0, fov_deg=60.0)
        found.append(float(settled(start, panorama_of(skyline), rays).fov_deg[0]))
    assert np.mean(found) == pytest.approx(60.0, abs=0.02 + 3.0 * np.std(found) / np.sqrt(6.0))


@pytest.mark.parametrize("sd", [0.01, 3.0])
def test_a_field_of_view_is_drawn_to_the_one_given_as_far_as_that_is_sure(sd):
    level_hills = panorama_of(lambda a: 0.3 * hills(a))
    rays = rays_of(*seen(lambda a: 0.3 * hills(a), **TRUTH), 60.0, 62.0, (50.0, 74.0))
    start = poses(grid_heading_deg=350.0, fov_deg=62.0)
    found = settled(start, level_hills, rays)
    drawn = settled(start, level_hills, replace(rays, lens=LensPrior(sd)))
    assert found.fov_deg[0] == pytest.approx(60.0, abs=0.1)
    if sd > 1.0:
        assert drawn.fov_deg[0] == pytest.approx(found.fov_deg[0], abs=1e-3)
    else:
        assert found.fov_deg[0] + 1e-3 < drawn.fov_deg[0] < 62.0
        assert drawn.cost[0] > found.cost[0]


def test_the_right_skyline_costs_least_and_order_does_not_matter():
    headings = np.array([349.0, 80.0, 200.0, 351.0])
    found = settled(poses(4, grid_heading_deg=headings), panorama_of(hills, 4), LENS)
    assert found.cost[[0, 3]].max() < found.cost[[1, 2]].min() - 100.0
    order = np.array([2, 0, 3, 1])
    other = settled(poses(4, grid_heading_deg=headings[order]), panorama_of(hills, 4), LENS)
    np.testing.assert_allclose(other.cost, found.cost[order], rtol=1e-9)
    np.testing.assert_allclose(other.grid_heading_deg, found.grid_heading_deg[order], rtol=1e-9)


@pytest.mark.parametrize("columns", [2, 15])
def test_too_few_columns_have_no_fit(columns):
    few = np.linspace(0, len(LENS.u) - 1, columns).astype(int)
    rays = replace(LENS, u=LENS.u[few], v=LENS.v[few], weight=LENS.weight[few])
    found = settled(poses(grid_heading_deg=350.0), panorama_of(hills), rays)
    assert found.cost[0] == np.inf
    assert np.isfinite(found.grid_heading_deg[0])


@pytest.mark.parametrize("height", [0.0, 0.1])
def test_a_level_skyline_keeps_its_heading(height):
    rays = rays_of(*seen(lambda a: height + 0.0 * a, 40.0), 60.0, None, (50.0, 70.0))
    found = settled(poses(grid_heading_deg=43.0), panorama_of(lambda a: height + 0.0 * a), rays)
    assert np.isfinite(found.cost[0])
    assert found.grid_heading_deg[0] == pytest.approx(43.0, abs=0.5)
    assert found.pitch_deg[0] == pytest.approx(0.0, abs=0.3)
    assert 50.0 <= found.fov_deg[0] <= 70.0

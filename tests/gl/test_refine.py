"""Refinement by rendering, on small terrain where the truth is known."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from ray_scenes import photographed_from, poses, rays_of
from scenes import field_of, fractal

from skyline.camera.warps import distorted
from skyline.match.curves import Curves
from skyline.match.narrowing import Narrowing
from skyline.match.prior import Prior
from skyline.match.refine import WHOLE, Refinement
from skyline.match.together import JointRefinement
from skyline.pose.poses import Poses
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import joined_views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import at_elevation, stand_on

TRUTH = {"heading_deg": 160.0, "pitch_deg": 1.5, "roll_deg": -1.0}
PLACE = np.array([4000.0, -6000.0])
SHORT = replace(WHOLE, shortlist=12, rounds=5, restarts=1, finalists=4, final_rounds=3)


@dataclass(frozen=True)
class _Scene:
    field: HeightField
    renderer: HorizonRenderer
    height_sd_m: float = 5.0
    edge: None = None

    def render(self, viewpoints, headings):
        return [self.renderer.render(viewpoints, np.asarray(headings, dtype=np.uint8))]

    def ground_m(self, easting_m, northing_m):
        return self.field.height_at(easting_m=easting_m, northing_m=northing_m)


@pytest.fixture(scope="module")
def scene():
    field = field_of(fractal(400, 400, relief_m=1500.0, seed=5, exponent=2.0), spacing_m=30.0)
    with HorizonRenderer(field, RenderConfig(320)) as renderer:
        yield _Scene(field, renderer)


def _seen(scene, above_m=2.0):
    """Return u, v of the true view."""
    eye = stand_on(scene.field, easting_m=PLACE[0], northing_m=PLACE[1], eye_height_m=above_m)
    return photographed_from(scene.field, eye, fov_deg=60.0, **TRUTH)


@pytest.fixture(scope="module")
def rays(scene):
    return _seen(scene)


def _around(count=6, off_m=40.0, turn_deg=2.0):
    ring = off_m * np.exp(2j * np.pi * np.arange(count) / count)
    return poses(
        count,
        easting_m=PLACE[0] + ring.real,
        northing_m=PLACE[1] + ring.imag,
        grid_heading_deg=TRUTH["heading_deg"] + turn_deg * (-1.0) ** np.arange(count),
        fov_deg=61.5,
        cost=np.arange(count),
    )


def _off_m(found: Poses):
    return np.hypot(found.easting_m - PLACE[0], found.northing_m - PLACE[1])


def test_the_pose_is_recovered_where_nothing_is_noisy(scene, rays):
    query = rays_of(*rays, 60.0, 61.5, (57.0, 63.0))
    found = Refinement(query, scene, SHORT).run(_around())
    best = found
    assert _off_m(best)[0] < 3.0
    assert best.grid_heading_deg[0] == pytest.approx(160.0, abs=0.05)
    assert best.pitch_deg[0] == pytest.approx(1.5, abs=0.05)
    assert best.roll_deg[0] == pytest.approx(-1.0, abs=0.1)
    assert best.fov_deg[0] == pytest.approx(60.0, abs=0.1)
    ground_m = scene.ground_m(best.easting_m, best.northing_m)
    assert best.eye_elevation_m[0] - ground_m[0] == pytest.approx(2.0, abs=1.0)
    assert (np.diff(best.cost) >= 0.0).all()
    assert found.figures().terrain_share[0] > 0.97
    assert found.figures().residual_deg[0] < 0.05


@pytest.mark.parametrize("distortion", [-0.03, 0.02])
def test_the_distortion_of_a_usual_lens_is_found(scene, rays, distortion):
    half_width = np.tan(np.radians(30.0))
    bent = half_width * np.stack(distorted(*(np.stack(rays) / half_width), distortion))
    query = replace(rays_of(*bent, 60.0, 61.5, (57.0, 63.0)), distortion_sd=0.01)
    best = Refinement(query, scene, SHORT).run(_around())
    assert _off_m(best)[0] < 5.0
    assert best.distortion[0] == pytest.approx(distortion, abs=0.003)


@pytest.mark.parametrize(("above_m", "known"), [(2.0, True), (2.0, False), (45.0, False)])
def test_the_eye_s_height_above_the_ground_is_found_or_held(scene, above_m, known):
    prior = Prior(Narrowing(eye_height_m=2.0 if known else None))
    refinement = Refinement(rays_of(*_seen(scene, above_m), 60.0), scene, SHORT, prior)
    best = refinement.run(_around())
    height_m = best.eye_elevation_m - scene.ground_m(best.easting_m, best.northing_m)
    assert _off_m(best)[0] < 5.0
    assert height_m[0] == pytest.approx(above_m, abs=1e-9 if known else 2.5)


def test_a_photo_s_noise_and_trees_leave_it_near(scene, rays):
    u, v = rays
    generator = np.random.default_rng(0)
    v = v + generator.normal(0.0, np.radians(0.1), len(v))
    hidden = (np.abs(u - 0.3) < 0.12) | (np.abs(u + 0.35) < 0.08)
    assert 0.3 < hidden.mean() < 0.4
    v = np.where(hidden, v + np.radians(3.0), v)
    found = Refinement(rays_of(u, v, 60.0), scene, SHORT).run(_around())
    off = PLACE - [found.easting_m[0], found.northing_m[0]]
    assert np.hypot(*off) < 20.0
    assert found.figures().terrain_share[0] == pytest.approx(1.0 - hidden.mean(), abs=0.05)
    assert off @ np.linalg.solve(found.figures().covariance_m2[0], off) < 16.0
    assert 20.0 < found.figures().effective_columns[0] < len(v)
    assert np.linalg.eigvalsh(found.figures().covariance_m2).min() > 0.0


def test_neither_order_nor_far_places_matter(scene, rays):
    query = rays_of(*rays, 60.0)
    east_m = [2000, 9000, 5000, 7000]
    far = poses(4, easting_m=east_m, northing_m=-8000.0, grid_heading_deg=50.0, cost=9.0)
    some = Poses.concatenate([_around(), far])
    order = np.random.default_rng(0).permutation(len(some))
    one, other = (Refinement(query, scene, SHORT).run(h) for h in (some, some[order]))
    first_m, same_m = (found.easting_m[0] for found in (one, other))
    np.testing.assert_allclose(first_m, same_m, atol=1e-3)
    assert _off_m(one)[0] < 3.0
    assert one.figures().margin[0] > 0.0


def test_the_derivatives_predict_the_next_rendering(scene):
    step_m = np.array([1.5, -1.0])
    place = np.stack([PLACE, PLACE + step_m])
    ground = scene.ground_m(place[:, 0], place[:, 1])
    slope = (ground[1] - ground[0]) * step_m / (step_m @ step_m)
    views = scene.renderer.render(at_elevation(scene.field, *place.T, ground + 2.0))
    y, distance_m = joined_views(views, np.repeat([0, 1], 4), 2, 1440)
    eye = np.zeros(1, complex), ground[:1], slope[np.newaxis], np.full(1, 2.0)
    channels = Curves.of(y[:1], distance_m[:1], *eye).channels[0]
    forecast = channels[:, 2:4] @ step_m
    change = y[1] - y[0]
    known = np.isfinite(forecast) & np.isfinite(change)
    assert known.mean() > 0.5
    # Occlusion is not in a derivative, so medians are compared.
    off = np.abs(forecast - change)[known]
    assert np.median(off) < 0.1 * np.median(np.abs(change[known]))
    assert np.percentile(off, 80) < 0.4 * np.median(np.abs(change[known]))


def test_a_start_off_the_map_or_on_a_hole_has_no_pose(scene, rays):
    outside = poses(2, easting_m=[-500.0, np.nan], northing_m=-6000.0, grid_heading_deg=160.0)
    query = rays_of(*rays, 60.0)
    assert len(Refinement(query, scene, SHORT).run(outside)) == 0
    both = Poses.concatenate([outside, _around(2, 20.0)])
    assert _off_m(Refinement(query, scene, SHORT).run(both))[0] < 5.0


def test_a_featureless_skyline_tells_no_place(scene):
    flat = field_of(np.zeros((100, 100)), spacing_m=30.0)
    u = np.linspace(-0.5, 0.5, 300)
    with HorizonRenderer(flat, RenderConfig(320)) as renderer:
        some = poses(3, easting_m=1500.0 + np.arange(3) * 60.0, northing_m=-1500.0)
        found = Refinement(rays_of(u, 0.0 * u, 60.0), _Scene(flat, renderer), SHORT).run(some)
    # The skyline is the same from everywhere.
    deviation_m = np.sqrt(np.linalg.eigvalsh(found.figures().covariance_m2).max(axis=1))
    assert len(deviation_m) > 0
    assert (deviation_m > 100.0).all()


def test_the_same_photo_twice_is_no_surer_than_once(scene, rays):
    query = rays_of(*rays, 60.0, 61.5, (57.0, 63.0))
    found = _around()
    alone = Refinement(query, scene, SHORT).run(found)
    each = Refinement(query, scene, SHORT)
    joint, _ = JointRefinement([each, each]).run([found] * 2, [alone[:1]] * 2)
    once, twice = (np.trace(one.figures().covariance_m2[0]) for one in (alone, joint[0]))
    assert twice > 0.8 * once


def test_no_pose_leaves_the_map(scene, rays):
    west, south, _, north = scene.field.bounds_m
    edge = poses(
        8, easting_m=west + 3.0, northing_m=np.linspace(south, north, 8), grid_heading_deg=80.0
    )
    found = Refinement(rays_of(*rays, 60.0), scene, SHORT).run(edge)
    assert np.isfinite(scene.ground_m(found.easting_m, found.northing_m)).all()
    assert np.isfinite(found.eye_elevation_m).all()


def test_no_pose_gives_no_pose(scene, rays):
    found = Refinement(rays_of(*rays, 60.0), scene, SHORT).run(_around()[:0])
    assert len(found) == 0

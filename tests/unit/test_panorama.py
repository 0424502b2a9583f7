"""What displaced eyes see all round: against closed forms and against `predict`."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenes import field_of, fractal

from skyline import oracle
from skyline.camera import columns_u
from skyline.prediction import predict
from skyline.prediction.displacement import Reach
from skyline.prediction.panorama import Ring, depth_code, depth_of_code_m
from skyline.terrain.viewpoints import Viewpoints, stand_on

COLUMNS = 90
U = columns_u(COLUMNS)
FAR = Reach(1000.0, 1000.0)


def room(half_m, height_m):
    """Return tan and depth (4, 1, Q) of a square of walls seen from its middle."""
    depth = np.full((4, 1, COLUMNS), half_m, dtype=np.float32)
    return (height_m / depth).astype(np.float32), depth


@given(depth_m=st.floats(1.0, 65000.0))
def test_a_depth_survives_its_code_within_three_percent(depth_m):
    code = depth_code(np.array([depth_m], dtype=np.float32))
    assert depth_of_code_m(code)[0] == pytest.approx(depth_m, rel=1.0 / 32.0)


def test_depths_out_of_range_take_the_nearest_code():
    np.testing.assert_array_equal(depth_code(np.array([0.1, 1e6], dtype=np.float32)), [0, 255])


@given(east=st.floats(-300.0, 300.0), up=st.floats(-50.0, 50.0), north=st.floats(-300.0, 300.0))
def test_walls_are_seen_exactly_from_anywhere_across_all_seams(east, up, north):
    half_m, height_m = 400.0, 120.0
    ring = Ring.of(*room(half_m, height_m), FAR)
    tan, depth = ring.seen_from(np.array([[east, up, north]]))
    # The forward distance to the walls in each heading's own frame, wall by wall.
    walls = [half_m - north, half_m - east, half_m + north, half_m + east]
    for heading in range(4):
        ahead = walls[heading]
        right = walls[(heading + 1) % 4] / np.maximum(U, 1e-9)
        left = walls[heading - 1] / np.maximum(-U, 1e-9)
        forward = np.minimum(ahead, np.where(U > 0.0, right, left))
        close = np.isclose(tan[0, heading], (height_m - up) / forward, rtol=1e-4, atol=1e-5)
        close &= np.isclose(depth_of_code_m(depth[0, heading]), forward, rtol=1.0 / 30.0)
        # The columns beside a corner of the room are joined by a chord.
        assert close.mean() > 0.93


def test_an_eye_that_does_not_move_sees_the_stored_skyline():
    generator = np.random.default_rng(1)
    tan = generator.uniform(-0.2, 0.4, (4, 1, COLUMNS)).astype(np.float32)
    depth = np.full_like(tan, 2000.0)
    seen, _ = Ring.of(tan, depth, Reach(0.0, 0.0)).seen_from(np.zeros((1, 3)))
    np.testing.assert_allclose(seen[0], tan[:, 0], atol=2e-6)


def test_a_heading_without_a_view_stays_unknown_and_spoils_no_other():
    tan, depth = room(400.0, 100.0)
    tan[2] = depth[2] = np.nan
    seen, code = Ring.of(tan, depth, FAR).seen_from(np.zeros((1, 3)))
    assert np.isnan(seen[0, 2]).all()
    assert (code[0, 2] == 0).all()
    assert np.isfinite(seen[0, [0, 1, 3]]).all()


def test_nothing_known_is_nothing_seen():
    tan = np.full((4, 2, COLUMNS), np.nan, dtype=np.float32)
    seen, _ = Ring.of(tan, tan, FAR).seen_from(np.zeros((3, 3)))
    assert seen.shape == (3, 4, COLUMNS)
    assert np.isnan(seen).all()


def test_a_hidden_shell_surfaces_for_an_eye_high_enough():
    near = np.full((4, 1, COLUMNS), 0.2, dtype=np.float32)
    far = np.full_like(near, 0.15)
    depth = np.concatenate([np.full_like(near, 200.0), np.full_like(near, 4000.0)], axis=1)
    ring = Ring.of(np.concatenate([near, far], axis=1), depth, Reach(10.0, 60.0))
    tan, code = ring.seen_from(np.array([[0.0, 0.0, 0.0], [0.0, 60.0, 0.0]]))
    np.testing.assert_allclose(tan[0], 0.2, atol=1e-5)
    np.testing.assert_allclose(tan[1], (600.0 - 60.0) / 4000.0, atol=1e-5)
    assert depth_of_code_m(code[1]) == pytest.approx(4000.0, rel=1.0 / 32.0)


def test_it_agrees_with_single_predictions_on_rough_terrain():
    field = field_of(fractal(64, 64, 300.0, seed=3))
    eye = stand_on(field, [960.0], [-960.0])
    views = oracle.skyline(field, eye, COLUMNS)
    tan, depth = (
        rows.astype(np.float32)[:, np.newaxis] for rows in (views.elevation_tan, views.depth_m)
    )
    moved = np.array([[20.0, 3.0, -15.0], [-40.0, -2.0, 30.0]])
    seen, _ = Ring.of(tan, depth, Reach.of(moved)).seen_from(moved)
    targets = Viewpoints(
        np.repeat(960.0 + moved[:, 0], 4),
        np.repeat(-960.0 + moved[:, 2], 4),
        np.repeat(eye.eye_elevation_m[0] + moved[:, 1], 4),
    )
    expected = predict(views, np.tile(np.arange(4), 2), targets)
    difference = np.abs(seen.reshape(8, -1) - expected.elevation_tan)
    unknown = np.isnan(expected.elevation_tan)
    # Segments across a frame's side and right beside the eye are drawn a little differently.
    assert (np.isnan(seen.reshape(8, -1)) == unknown).mean() > 0.98
    assert (difference[np.isfinite(difference)] < 1e-5).mean() > 0.97

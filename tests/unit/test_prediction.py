"""Predicted curves: against closed forms, against a plain loop, against the oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prediction_scenes import WIDTH, U, layered, mountains, views_of
from scenes import field_from
from skyline.prediction import predict
from skyline.prediction.curves import (
    MAX_DEPTH_RATIO,
    MIN_DEPTH_M,
    NO_VIEW,
    Reach,
    Scenery,
    block_means,
    flanks,
    seen_from,
)

from skyline.camera import columns_u
from skyline.errors import InputError
from skyline.paper.planning.reprojection import displacements_m
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline.views import FLAG_NO_DATA, Views
from skyline_bench.truth import oracle

PX = 2.0 / WIDTH


def eyes(*east_up_north):
    east, up, north = np.array(east_up_north, dtype=np.float64).T
    return Viewpoints(east, north, up)


def zeros(count):
    return np.zeros(count, dtype=np.intp)


@pytest.mark.parametrize(
    ("heading", "expected"),
    [(0, (3.0, 5.0, 7.0)), (1, (-7.0, 5.0, 3.0)), (2, (-3.0, 5.0, -7.0)), (3, (7.0, 5.0, -3.0))],
)
def test_a_displacement_is_right_up_forward_in_the_axes_of_the_view(heading, expected):
    view = views_of(mountains(U), 900.0, heading, east=100.0, north=200.0, eye=50.0)
    moved = displacements_m(view, [[103.0]], [[207.0]], [[55.0]])
    np.testing.assert_allclose(moved, [[expected]])


def test_an_unknown_height_leaves_the_rest_of_a_displacement_known():
    moved = displacements_m(views_of(mountains(U), 900.0, 1), [[4.0]], [[9.0]], [[np.nan]])
    np.testing.assert_allclose(moved, [[[-9.0, np.nan, 4.0]]])
    assert Reach.of(moved[0]) == Reach(pytest.approx(np.hypot(9.0, 4.0)), 0.0)


@given(right=st.floats(-200.0, 200.0), up=st.floats(-80.0, 80.0), forward=st.floats(-400.0, 400.0))
def test_a_mountain_in_a_plane_moves_exactly(right, up, forward):
    depth = 2000.0
    view = views_of(mountains(U), depth)
    predicted = predict(view, zeros(1), eyes((right, up, forward)))
    # The column at u' shows the point of the plane at u; the plane's profile is known anywhere.
    u = (U * (depth - forward) + right) / depth
    expected = (mountains(u) * depth - up) / (depth - forward)
    seen = (u > U[0] + 1e-6) & (u < U[-1] - 1e-6)
    unseen = (u < U[0] - 1e-6) | (u > U[-1] + 1e-6)
    np.testing.assert_allclose(predicted.elevation_tan[0, seen], expected[seen], atol=0.05 * PX)
    np.testing.assert_allclose(predicted.depth_m[0, seen], depth - forward, rtol=1e-5)
    assert np.isnan(predicted.elevation_tan[0, unseen]).all()
    assert (predicted.flags[0, unseen] == FLAG_NO_DATA).all()
    assert not predicted.flags[0, seen].any()


def test_what_is_far_away_does_not_move():
    view = views_of(mountains(U), 1e7)
    predicted = predict(view, zeros(2), eyes((300.0, 0.0, 0.0), (0.0, 30.0, -300.0)))
    inner = slice(1, -1)
    np.testing.assert_allclose(
        predicted.elevation_tan[:, inner], view.elevation_tan[[0, 0], inner], atol=0.02 * PX
    )


def test_without_a_displacement_a_view_predicts_itself():
    view = layered([(mountains(U, 1), 400.0), (mountains(U, 2, 0.12), 3000.0)])
    predicted = predict(view, zeros(1), eyes((0.0, 0.0, 0.0)))
    np.testing.assert_allclose(predicted.elevation_tan, view.elevation_tan, atol=1e-6)
    np.testing.assert_allclose(predicted.depth_m, view.depth_m, rtol=1e-5)


@given(
    near_up=st.floats(60.0, 120.0),
    far_up=st.floats(100.0, 700.0),
    climb=st.floats(-40.0, 55.0),
    back=st.floats(-150.0, 150.0),
)
def test_shells_reveal_a_hidden_ridge_exactly_when_the_geometry_says_so(
    near_up, far_up, climb, back
):
    near, far = 500.0, 4000.0
    view = layered([(near_up / near, near), (far_up / far, far)])
    target = eyes((0.0, climb, -back))
    predicted = predict(view, zeros(1), target, with_shells=True)
    of_near, of_far = (near_up - climb) / (near + back), (far_up - climb) / (far + back)
    middle = slice(60, -60)
    np.testing.assert_allclose(
        predicted.elevation_tan[0, middle], max(of_near, of_far), atol=0.01 * PX
    )
    if abs(of_near - of_far) > 0.01 * PX:
        depth = (near if of_near > of_far else far) + back
        np.testing.assert_allclose(predicted.depth_m[0, middle], depth, rtol=1e-4)
    skyline_alone = predict(
        views_of(view.elevation_tan, view.depth_m), zeros(1), target
    ).elevation_tan[0, middle]
    seen_before = near_up / near >= far_up / far
    np.testing.assert_allclose(skyline_alone, of_near if seen_before else of_far, atol=0.01 * PX)


def test_predicted_shells_hold_what_each_stored_shell_held():
    view = layered([(0.3, 500.0), (0.2, 4000.0)])
    shells = predict(view, zeros(1), eyes((0.0, 50.0, 100.0)), with_shells=True).shells
    middle = slice(60, -60)
    np.testing.assert_allclose(shells.elevation_tan[0, 0, middle], 100.0 / 400.0, rtol=1e-5)
    np.testing.assert_allclose(shells.elevation_tan[0, 1, middle], 750.0 / 3900.0, rtol=1e-5)
    np.testing.assert_allclose(shells.depth_m[0, 1, middle], 3900.0, rtol=1e-5)
    np.testing.assert_array_equal(shells.edges_m, view.shells.edges_m)


def test_a_depth_jump_is_a_gap_and_not_a_slope():
    tan = np.where(U < 0.0, 0.3, 0.1)
    depth = np.where(U < 0.0, 400.0, 400.0 * 1.1 * MAX_DEPTH_RATIO)
    view = views_of(tan, depth)
    # Seen from farther right, the near block slides left and uncovers what was never seen.
    predicted = predict(view, zeros(1), eyes((100.0, 0.0, 0.0))).elevation_tan[0]
    near_ends, far_begins = -100.0 / 400.0, -100.0 / (400.0 * 1.1 * MAX_DEPTH_RATIO)
    gap = (near_ends + 2 * PX < U) & (far_begins - 2 * PX > U)
    assert gap.sum() > 10
    assert np.isnan(predicted[gap]).all()
    np.testing.assert_allclose(predicted[far_begins + 2 * PX < U][:-60], 0.1, rtol=1e-5)


def naive_envelope(right, up, forward, joined, displacement, columns):
    """One segment and one column at a time."""
    x, y, z = displacement
    curve = np.full(columns, np.nan)
    for point in range(len(right) - 1):
        ends = [point, point + 1]
        depth = forward[ends].astype(np.float64) - z
        if not joined[point] or (depth <= MIN_DEPTH_M).any():
            continue
        abscissa, ordinate = (right[ends] - x) / depth, (up[ends] - y) / depth
        order = np.argsort(abscissa)
        for column, u in enumerate(columns_u(columns)):
            if abscissa[order[0]] <= u <= abscissa[order[1]]:
                v = np.interp(u, abscissa[order], ordinate[order])
                curve[column] = np.fmax(curve[column], v)
    return curve


def test_all_eyes_at_once_see_what_a_plain_loop_sees():
    generator = np.random.default_rng(3)
    ridges = [(mountains(U, seed, 0.2), 200.0 * 2.5**seed * (1.3 + U)) for seed in range(3)]
    scenery = Scenery.of(layered(ridges), 64, use_shells=True)
    moved = generator.uniform(-250.0, 250.0, (20, 3)) * [1.0, 0.2, 1.0]
    polylines = scenery.polylines(0, Reach.of(moved))
    seen = seen_from(polylines, moved, 48)
    parts = polylines.right_m, polylines.up_m, polylines.forward_m, polylines.joined
    expected = np.stack([naive_envelope(*parts, one, 48) for one in moved])
    assert np.isnan(expected).any()
    np.testing.assert_array_equal(np.isnan(seen), np.isnan(expected))
    np.testing.assert_allclose(seen, expected, atol=1e-4)


def test_what_polylines_leave_out_is_never_seen():
    generator = np.random.default_rng(4)
    ridges = [(mountains(U, seed, 0.4 / 2.0**seed), 300.0 * 2.0**seed) for seed in range(6)]
    scenery = Scenery.of(layered(ridges), 80, use_shells=True)
    moved = generator.uniform(-50.0, 50.0, (40, 3)) * [1.0, 0.3, 1.0]
    some, everything = scenery.polylines(0, Reach.of(moved)), scenery.polylines(0, Reach(1e9, 1e9))
    assert len(some.up_m) < 0.8 * len(everything.up_m)
    # At the frame's sides what hides can leave it, and then nobody knows.
    inner = slice(16, -16)
    np.testing.assert_array_equal(
        seen_from(some, moved, 80)[:, inner], seen_from(everything, moved, 80)[:, inner]
    )


def test_an_eye_that_is_nowhere_sees_nothing():
    polylines = Scenery.of(views_of(mountains(U), 900.0), WIDTH, False).polylines(
        0, Reach(100.0, 0.0)
    )
    moved = np.array([[0.0, np.nan, 0.0], [np.nan, 0.0, 0.0], [0.0, 0.0, 1000.0]])
    assert np.isnan(seen_from(polylines, moved, WIDTH)).all()


def test_views_without_data_predict_nothing():
    view = views_of(np.full(WIDTH, np.nan), np.nan)
    predicted = predict(view, zeros(1), eyes((10.0, 0.0, 0.0)))
    assert np.isnan(predicted.elevation_tan).all()
    assert (predicted.flags == FLAG_NO_DATA).all()


@given(width=st.integers(1, 50), blocks=st.integers(1, 50), seed=st.integers(0, 1000))
def test_block_means_leave_unknown_columns_out(width, blocks, seed):
    generator = np.random.default_rng(seed)
    rows = generator.normal(size=(2, 3, width))
    rows[generator.random(rows.shape) < 0.3] = np.nan
    means = block_means(rows, blocks)
    parts = np.split(rows, [b * width // blocks for b in range(1, blocks)], axis=-1)
    if width <= blocks:
        parts = np.split(rows, width, axis=-1)
    for index, part in enumerate(parts):
        known = ~np.isnan(part)
        total = np.where(known, part, 0.0).sum(axis=-1)
        expected = np.where(known.any(axis=-1), total / np.maximum(known.sum(axis=-1), 1), np.nan)
        np.testing.assert_allclose(means[..., index], expected, rtol=1e-5, atol=1e-6)


def test_flanks_are_the_neighbouring_headings_of_the_same_eye():
    views = views_of(
        np.tile(mountains(U), (6, 1)), 900.0, [3, 0, 1, 0, 2, 0], eye=[1, 1, 1, 2, 1, 1]
    )
    expected = [[4, 1], [0, 2], [1, 4], [NO_VIEW, NO_VIEW], [2, 0], [0, 2]]
    np.testing.assert_array_equal(flanks(views), expected)


def test_flanks_show_what_enters_at_the_sides():
    # A square of walls around the eye, 300 m away, of one height all round.
    walls = views_of(np.tile(np.full(WIDTH, 0.2), (4, 1)), 300.0, [0, 1, 2, 3])
    target = eyes((150.0, 0.0, -120.0))
    alone = predict(walls[[0]], zeros(1), target).elevation_tan[0]
    joined = predict(walls, zeros(1), target).elevation_tan[0]
    corner_left, corner_right = (-300.0 - 150.0) / 420.0, (300.0 - 150.0) / 420.0
    front = (corner_left < U) & (corner_right > U)
    # In front the north wall, to its right the east wall, 150 m off.
    expected = np.where(front, 60.0 / 420.0, 60.0 / 150.0 * U)
    np.testing.assert_allclose(joined[1:-1], expected[1:-1], atol=1e-3)
    assert np.isnan(alone[corner_right + PX < U]).all()


def test_a_predicted_view_has_the_eye_of_its_target_and_the_heading_of_its_source():
    views = views_of(np.tile(mountains(U), (4, 1)), 5000.0, [0, 1, 2, 3])
    targets = eyes((5.0, 1.0, 6.0), (7.0, 2.0, 8.0), (9.0, 3.0, 10.0))
    predicted = predict(views, np.array([3, 0, 3]), targets, columns=40)
    np.testing.assert_array_equal(predicted.heading, [3, 0, 3])
    np.testing.assert_array_equal(predicted.easting_m, targets.easting_m)
    np.testing.assert_array_equal(predicted.northing_m, targets.northing_m)
    np.testing.assert_array_equal(predicted.eye_elevation_m, targets.eye_elevation_m)
    assert predicted.width == 40
    assert predicted.shells is None
    one = predict(views, np.array([3]), targets[2:], columns=40)
    np.testing.assert_array_equal(one.elevation_tan[0], predicted.elevation_tan[2])


def test_no_targets_give_no_views():
    assert len(predict(views_of(mountains(U), 900.0), zeros(0), eyes((0, 0, 0))[:0])) == 0


def test_bad_requests_say_what_is_wrong():
    view = views_of(mountains(U), 900.0)
    with pytest.raises(InputError, match=r"sources have shape \(2,\).*expected \(1,\)"):
        predict(view, zeros(2), eyes((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="from 1 to 1; expected rows of the 1 stored"):
        predict(view, np.array([1]), eyes((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="shell_edges_m"):
        predict(view, zeros(1), eyes((0.0, 0.0, 0.0)), with_shells=True)


def peaks(east, north):
    """Return a ring of mountains 6 km off around a gentle basin."""
    distance, bearing = np.hypot(east, north), np.arctan2(east, north)
    ring = 900.0 * np.exp(-(((distance - 6000.0) / 900.0) ** 2))
    return ring * (1.2 + np.sin(5.0 * bearing) + 0.4 * np.cos(13.0 * bearing)) + 0.002 * distance


@pytest.mark.parametrize("move", [(200.0, 0.0), (0.0, 250.0), (-150.0, -150.0)])
def test_prediction_agrees_with_the_oracle_in_every_heading(move):
    field = field_from(peaks, 181, 100.0)
    here, there = (stand_on(field, 130.0 + e, -70.0 + n) for e, n in ((0.0, 0.0), move))
    stored, truth = (oracle.skyline(field, eye, WIDTH) for eye in (here, there))
    four = Viewpoints(
        np.repeat(there.easting_m, 4),
        np.repeat(there.northing_m, 4),
        np.repeat(there.eye_elevation_m, 4),
    )
    predicted = predict(stored, np.arange(4), four)
    error_px = np.abs(predicted.elevation_tan - truth.elevation_tan) / PX
    moved_px = np.abs(stored.elevation_tan - truth.elevation_tan) / PX
    assert np.median(moved_px) > 1.0
    assert np.nanquantile(error_px, 0.95) < 0.3
    assert np.isfinite(error_px).mean() > 0.9
    assert isinstance(predicted, Views)

"""Predicted curves: against closed forms, against a plain loop, against the oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from prediction_scenes import WIDTH, U, mountains, views_of
from scenes import field_from

from skyline.camera import columns_u
from skyline.errors import InputError
from skyline.paper.prediction import (
    MAX_DEPTH_RATIO,
    MIN_DEPTH_M,
    NO_VIEW,
    flanks,
    polylines,
    predict,
    reach_m,
    seen_from,
)
from skyline.paper.reprojection import displacements_m
from skyline.skylines import FLAG_NO_DATA, Views
from skyline.terrain.viewpoints import Viewpoints, stand_on
from skyline_bench.truth import oracle

PX = 2.0 / WIDTH
ALONE = np.array([NO_VIEW, NO_VIEW])


def eyes(*east_up_north):
    east, up, north = np.array(east_up_north, dtype=np.float64).T
    return Viewpoints(easting_m=east, northing_m=north, eye_elevation_m=up)


def zeros(count):
    return np.zeros(count, dtype=np.intp)


def two_ridges():
    """A near ridge to the left, a far one to the right of it."""
    near = U < 0.1
    return views_of(
        np.where(near, mountains(U, 1, 0.2), mountains(U, 2, 0.12)),
        np.where(near, 300.0 * (1.3 + U), 3000.0),
    )


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
    assert reach_m(moved[0]) == pytest.approx(np.hypot(9.0, 4.0))


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
    view = two_ridges()
    predicted = predict(view, zeros(1), eyes((0.0, 0.0, 0.0)))
    np.testing.assert_allclose(predicted.elevation_tan, view.elevation_tan, atol=1e-6)
    np.testing.assert_allclose(predicted.depth_m, view.depth_m, rtol=1e-5)


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
    moved = generator.uniform(-250.0, 250.0, (20, 3)) * [1.0, 0.2, 1.0]
    lines = polylines(two_ridges(), 0, ALONE, reach_m(moved))
    seen, _ = seen_from(lines, moved, 48)
    parts = lines.right_m, lines.up_m, lines.forward_m, lines.joined
    expected = np.stack([naive_envelope(*parts, one, 48) for one in moved])
    assert np.isnan(expected).any()
    np.testing.assert_array_equal(np.isnan(seen), np.isnan(expected))
    np.testing.assert_allclose(seen, expected, atol=1e-4)


def test_what_stays_outside_the_frame_is_left_out_and_never_seen():
    generator = np.random.default_rng(4)
    walls = views_of(np.tile(mountains(U), (4, 1)), 300.0 * (1.3 + U), [0, 1, 2, 3])
    moved = generator.uniform(-50.0, 50.0, (40, 3)) * [1.0, 0.3, 1.0]
    some, everything = (
        polylines(walls, 0, flanks(walls)[0], reach) for reach in (reach_m(moved), 1e9)
    )
    assert len(some.up_m) < 0.8 * len(everything.up_m)
    for one, other in zip(
        seen_from(some, moved, 80), seen_from(everything, moved, 80), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_an_eye_that_is_nowhere_sees_nothing():
    lines = polylines(views_of(mountains(U), 900.0), 0, ALONE, 100.0)
    moved = np.array([[0.0, np.nan, 0.0], [np.nan, 0.0, 0.0], [0.0, 0.0, 1000.0]])
    assert np.isnan(seen_from(lines, moved, WIDTH)).all()


def test_views_without_data_predict_nothing():
    view = views_of(np.full(WIDTH, np.nan), np.nan)
    predicted = predict(view, zeros(1), eyes((10.0, 0.0, 0.0)))
    assert np.isnan(predicted.elevation_tan).all()
    assert (predicted.flags == FLAG_NO_DATA).all()


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
    predicted = predict(views, np.array([3, 0, 3]), targets)
    np.testing.assert_array_equal(predicted.heading, [3, 0, 3])
    np.testing.assert_array_equal(predicted.easting_m, targets.easting_m)
    np.testing.assert_array_equal(predicted.northing_m, targets.northing_m)
    np.testing.assert_array_equal(predicted.eye_elevation_m, targets.eye_elevation_m)
    assert predicted.width == views.width
    one = predict(views, np.array([3]), targets[2:])
    np.testing.assert_array_equal(one.elevation_tan[0], predicted.elevation_tan[2])


def test_no_targets_give_no_views():
    assert len(predict(views_of(mountains(U), 900.0), zeros(0), eyes((0, 0, 0))[:0])) == 0


def test_bad_requests_say_what_is_wrong():
    view = views_of(mountains(U), 900.0)
    with pytest.raises(InputError, match=r"sources have shape \(2,\).*expected \(1,\)"):
        predict(view, zeros(2), eyes((0.0, 0.0, 0.0)))
    with pytest.raises(InputError, match="from 1 to 1; expected rows of the 1 stored"):
        predict(view, np.array([1]), eyes((0.0, 0.0, 0.0)))


def peaks(east, north):
    """Return a ring of mountains 6 km off around a gentle basin."""
    distance, bearing = np.hypot(east, north), np.arctan2(east, north)
    ring = 900.0 * np.exp(-(((distance - 6000.0) / 900.0) ** 2))
    return ring * (1.2 + np.sin(5.0 * bearing) + 0.4 * np.cos(13.0 * bearing)) + 0.002 * distance


@pytest.mark.parametrize("move", [(200.0, 0.0), (0.0, 250.0), (-150.0, -150.0)])
def test_prediction_agrees_with_the_oracle_in_every_heading(move):
    field = field_from(peaks, 181, 100.0)
    here, there = (
        stand_on(field, easting_m=130.0 + e, northing_m=-70.0 + n) for e, n in ((0.0, 0.0), move)
    )
    stored, truth = (oracle.skyline(field, eye, WIDTH) for eye in (here, there))
    four = Viewpoints(
        easting_m=np.repeat(there.easting_m, 4),
        northing_m=np.repeat(there.northing_m, 4),
        eye_elevation_m=np.repeat(there.eye_elevation_m, 4),
    )
    predicted = predict(stored, np.arange(4), four)
    error_px = np.abs(predicted.elevation_tan - truth.elevation_tan) / PX
    moved_px = np.abs(stored.elevation_tan - truth.elevation_tan) / PX
    assert np.median(moved_px) > 1.0
    assert np.nanquantile(error_px, 0.95) < 0.3
    assert np.isfinite(error_px).mean() > 0.9
    assert isinstance(predicted, Views)

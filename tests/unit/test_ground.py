"""Errors of places on the ground, and the way there and back, against planes and other poses."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import candidate_at, field_from, field_of, fractal

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.files.shapes import LINE, POINT, POLYGON, Shape
from skyline.geodesy.earth import Curvature
from skyline.ground.ground_shapes import in_photo, on_ground
from skyline.ground.ground_view import GroundErrors
from skyline.photo.skyline import PhotoSkyline
from skyline.view.viewer import Viewer

PHOTO = PhotoSkyline(np.full(400, np.nan), np.zeros(400), 400, 300)
PLANE = field_from(lambda east, north: 0.0 * east, 81, 50.0)
ROUGH = field_of(1000.0 + fractal(90, 100, 500.0, seed=4), 30.0)
WALL = field_from(lambda east, north: np.where(np.abs(north - 600.0) < 60.0, 200.0, 0.0), 81, 50.0)
EXACT = GroundErrors(pixel_sd_px=0.0, height_sd_m=0.0)


def photo_of(projection=Projection.PERSPECTIVE):
    return replace(PHOTO, projection=projection)


def sds(**given):
    names = ("east", "north", "up", "heading", "pitch", "roll", "log_scale", "distortion")
    return [given.get(name, 0.0) for name in names]


NO_ERRORS = sds()


def view_at(field, height_m=100.0, errors=NO_ERRORS, east_m=0.0, north_m=0.0, **angles):
    """Return the ground as a camera with independent errors, by default none, sees it."""
    ground_m = float(field.height_at(easting_m=east_m, northing_m=north_m))
    pose = candidate_at(east_m, north_m, eye_elevation_m=ground_m + height_m, **angles)
    pose = replace(pose, covariance=tuple(map(tuple, np.diag(np.square(errors)))))
    return Viewer(field, curvature=Curvature(enabled=False)).ground_view(pose, PHOTO)


def straight_down_to(view, distance_m):
    """Return the pixel in the middle column whose ray meets level ground so far away."""
    found = view.pixels(view.eye.easting_m, view.eye.northing_m + distance_m)
    return found.column_px, found.row_px


@pytest.mark.parametrize(
    ("error", "east_m", "north_m"),
    [
        (sds(east=3.0), 3.0, 0.0),
        (sds(north=4.0), 0.0, 4.0),
        (sds(up=2.0), 0.0, 2.0 * 500.0 / 100.0),
        (sds(heading=0.01), 500.0 * 0.01, 0.0),
        (sds(pitch=1e-4), 0.0, 1e-4 * (500.0**2 + 100.0**2) / 100.0),
    ],
)
def test_errors_of_a_pose_move_a_place_on_level_ground_as_trigonometry_has_it(
    error, east_m, north_m
):
    view = view_at(PLANE, errors=error, pitch_deg=-10.0)
    found = view.points(*straight_down_to(view, 500.0), EXACT)
    sd_m = np.sqrt(np.diagonal(found.covariance_m2[0]))
    np.testing.assert_allclose(sd_m, [east_m, north_m, 0.0], rtol=0.02, atol=0.02)
    assert found.error_m[0] == pytest.approx(max(east_m, north_m), rel=0.02)


@pytest.mark.parametrize(
    ("column_px", "row_px"), [([1.0, np.nan], [1.0, 1.0]), ([1.0], [1.0, 2.0]), (1.0, 1.0)]
)
def test_pixels_are_as_many_finite_columns_as_rows(column_px, row_px):
    view = view_at(ROUGH)
    with pytest.raises(InputError, match=r"expected equally many|not a finite"):
        view.points(column_px, row_px)


def test_points_on_the_ground_are_printed_by_their_shapes():
    view = view_at(PLANE, pitch_deg=-10.0)
    found = view.points(*straight_down_to(view, 500.0), EXACT)
    assert "easting_m=(1,) float64, northing_m=(1,) float64" in repr(found)


def test_errors_of_the_model_and_the_pixel_are_errors_of_the_place():
    view = view_at(PLANE, pitch_deg=-10.0)
    at = straight_down_to(view, 500.0)
    model = view.points(*at, GroundErrors(pixel_sd_px=0.0, height_sd_m=3.0))
    # A metre of height is 5 m of ground at 500 m from an eye at 100 m.
    assert model.error_m[0] == pytest.approx(15.0, rel=0.02)
    major_m, minor_m, azimuth = (float(one[0]) for one in model.axes)
    assert (major_m, minor_m) == (pytest.approx(15.0 * 2.4477, rel=0.02), pytest.approx(0, abs=0.1))
    assert np.sin(azimuth) == pytest.approx(0.0, abs=1e-3)
    pixel = view.points(*at, GroundErrors(pixel_sd_px=1.0, height_sd_m=0.0))
    per_px = np.tan(np.radians(30.0)) / 200.0
    across_m = per_px * np.hypot(500.0, 100.0) / np.cos(np.radians(10.0 - 11.31)) * 1.0
    assert np.sqrt(pixel.covariance_m2[0, 0, 0]) == pytest.approx(across_m, rel=0.02)


def test_a_ray_that_a_metre_of_height_moves_by_20_metres_is_grazing():
    view = view_at(PLANE, height_m=30.0)
    near = view.points(*straight_down_to(view, 500.0), EXACT)
    far = view.points(*straight_down_to(view, 900.0), EXACT)
    assert (near.is_grazing[0], far.is_grazing[0]) == (False, True)


def test_a_ray_beside_an_edge_may_show_what_is_far_behind_it():
    step = field_from(lambda east, north: np.where(north > 500.0, -80.0, 0.0), 81, 50.0)
    view = view_at(step, errors=sds(pitch=2e-3), height_m=100.0)
    before, near = (view.points(*straight_down_to(view, d), EXACT) for d in (300.0, 495.0))
    assert near.error_m[0] > 3.0 * before.error_m[0] * (495.0 / 300.0) ** 2


def line_to(view, *distances_m):
    """Return the line in the middle column to level ground so far away, on the ground."""
    pixels = [np.concatenate(straight_down_to(view, d)) for d in distances_m]
    return on_ground(view, Shape(LINE, (np.stack(pixels),), "a", {}), view.terrain.frame, EXACT)


def test_a_line_over_an_edge_says_from_where_to_where_it_jumps():
    step = field_from(lambda east, north: np.where(north > 500.0, -80.0, 0.0), 81, 50.0)
    # The ray over the edge, 100 m below the eye at 500 m, meets the ground 180 m below at 900 m.
    jump = line_to(view_at(step), 300.0, 1100.0).jump
    assert (jump.near_m, jump.far_m) == (pytest.approx(500.0, rel=0.1), pytest.approx(900, rel=0.1))
    assert jump.column_px == pytest.approx(199.5, abs=0.01)


def test_a_line_on_level_ground_does_not_jump():
    assert line_to(view_at(PLANE), 300.0, 1100.0).jump is None


@pytest.mark.parametrize("projection", Projection)
def test_a_camera_s_changes_are_differences_of_directions(projection):
    pose = candidate_at(0.0, 0.0, 30.0, 4.0, -3.0, 70.0)
    wander = (0.02, -0.01, 0.005, 0.01) if projection.is_panorama else ()
    pose = replace(pose, wander=wander, distortion=0.0 if wander else 0.05)
    camera, column, row = pose.camera(photo_of(projection)), np.array([30.0, 310.0]), [200.0, 40.0]
    turned, lifted = camera.changes(column, row)
    step, half = 1e-5, projection.half_width(70.0)
    others = [
        replace(camera, grid_heading_deg=30.0 + np.degrees(step)),
        replace(camera, pitch_deg=4.0 + np.degrees(step)),
        replace(camera, roll_deg=-3.0 + np.degrees(step)),
        replace(
            camera,
            fov_deg=float(projection.fov_deg(half * np.exp(step))),
            # The rows of an image wander with its scale.
            wander=tuple(np.array(wander) * np.exp(step)),
        ),
    ]
    if wander:
        others.append(replace(camera, wander=(wander[0] + step, *wander[1:])))
    else:
        others.append(replace(camera, distortion=0.05 + step))
    azimuth_deg, tangent = camera.directions(column, row)
    for k, other in enumerate(others):
        moved_deg, moved = other.directions(column, row)
        by_azimuth = np.radians(moved_deg - azimuth_deg) / step
        np.testing.assert_allclose(turned[:, k], by_azimuth, atol=1e-4)
        np.testing.assert_allclose(lifted[:, k], (moved - tangent) / step, atol=1e-4)


@pytest.mark.parametrize("roll_deg", [0.0, 7.0])
def test_from_the_photo_to_the_map_and_back_is_the_same_pixel(roll_deg):
    view = view_at(ROUGH, 20.0, NO_ERRORS, 1400.0, -1300.0, roll_deg=roll_deg)
    row, column = (one.ravel().astype(float) for one in np.mgrid[:300:7, :400:7])
    there = view.points(column, row, EXACT)
    seen = ~there.is_sky & ~there.is_grazing
    back = view.pixels(there.easting_m[seen], there.northing_m[seen])
    off_px = np.hypot(back.column_px - column[seen], back.row_px - row[seen])
    assert seen.sum() > 500
    assert off_px.max() < 0.2
    assert back.is_hidden.mean() < 0.01


def test_ground_behind_a_wall_is_hidden():
    view = view_at(WALL, height_m=50.0)
    found = view.pixels(np.zeros(3), np.array([300.0, 580.0, 900.0]))
    assert found.is_hidden.tolist() == [False, False, True]


def test_a_photo_s_polygon_has_its_area_and_its_error_on_the_map():
    view = view_at(PLANE, 400.0, sds(up=4.0), pitch_deg=-30.0)
    corners_m = np.array([(-100.0, 500.0), (100.0, 500.0), (100.0, 700.0), (-100.0, 700.0)])
    place = view.pixels(*corners_m.T)
    ring = np.stack([place.column_px, place.row_px], axis=1)
    found = on_ground(view, Shape(POLYGON, (ring,), "it"), PLANE.frame, EXACT)
    scale = float(PLANE.frame.scale(easting_m=0.0, northing_m=600.0))
    assert found.area.value == pytest.approx(40_000.0 / scale**2, rel=0.01)
    # All lengths grow with the height of the eye, by 1 % each, and areas by 2 %.
    assert found.area.sd == pytest.approx(0.02 * 40_000.0, rel=0.05)
    assert found.length.value == pytest.approx(800.0 / scale, rel=0.01)
    assert found.length.sd == pytest.approx(8.0, rel=0.05)
    assert len(found.vertices) == 4
    assert len(found.rings[0]) > 40


def test_lines_of_the_photo_follow_the_ground_between_their_vertices():
    view = view_at(ROUGH, 20.0, NO_ERRORS, 1400.0, -1300.0)
    line = Shape(LINE, (np.array([(50.0, 250.0), (350.0, 250.0)]),), "it")
    found = on_ground(view, line, ROUGH.frame, EXACT)
    ring = found.rings[0]
    on_ground_m = ROUGH.height_at(easting_m=ring.easting_m, northing_m=ring.northing_m)
    assert len(ring) == 76
    assert np.median(np.abs(ring.elevation_m - on_ground_m)) < 0.01
    assert found.slope_length_m > found.length.value


def test_sky_is_no_place():
    view = view_at(PLANE)
    with pytest.raises(InputError):
        on_ground(view, Shape(POINT, (np.array([(200.0, 20.0)]),), "it"), PLANE.frame, EXACT)


def test_lines_of_the_map_are_hidden_in_part():
    view = view_at(WALL, height_m=50.0)
    lonlat = np.stack(WALL.frame.to_lonlat([20.0, 20.0], [200.0, 1200.0]), axis=1)
    parts = in_photo(view, Shape(LINE, (lonlat,), "it"), WALL.frame).parts(400, 300)
    assert [hidden for _, hidden in parts] == [False, True]
    assert all(len(part) > 1 for part, _ in parts)

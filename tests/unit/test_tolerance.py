"""Tolerance areas: where they lie, what the ground does to them, and what they refuse."""

import numpy as np
import pytest
from prediction_scenes import WIDTH, U, mountains, views_of
from scenes import field_from

from skyline.paper.reprojection import skyline_points_m, tolerance_errors_px
from skyline.terrain.heightfield import ground_of
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle


def level(easting, northing):
    return np.zeros(np.broadcast(easting, northing).shape)


def plateau(easting, northing):
    """Level ground, a hole to the east of 1000 m, a step up north of 2000 m."""
    return np.where(easting > 1000.0, np.nan, np.where(northing > 2000.0, 50.0, 0.0))


def view_at(heading=0, depth_m=1500.0, east=999.0, north=1999.0):
    return views_of(mountains(U), depth_m, heading, east, north, eye=2.0)


def errors_around(views, ground, size, spacing_m):
    return tolerance_errors_px(
        skyline_points_m(views),
        views,
        views.heading,
        ground,
        size=size,
        spacing_m=spacing_m,
        width=views.width,
    )


def test_rows_go_south_and_columns_east():
    asked = []

    def ground(easting, northing):
        asked[:] = easting.reshape(4, 4), northing.reshape(4, 4)
        return level(easting, northing)

    errors_around(view_at(east=0.0, north=0.0), ground, 4, 25.0)
    east, north = asked
    np.testing.assert_array_equal(east[0], [-50.0, -25.0, 0.0, 25.0])
    np.testing.assert_array_equal(north[:, 0], [50.0, 25.0, 0.0, -25.0])


@pytest.mark.parametrize("heading", range(4))
def test_ground_is_looked_up_on_the_map_whatever_the_heading(heading):
    depth_m = np.where(U < 0.0, 1000.0, 3000.0)
    errors = errors_around(view_at(heading, depth_m), plateau, 5, 2.0)[0]
    assert np.isinf(errors[:, 3:]).all()
    assert np.isfinite(errors[:, :3]).all()
    # 50 m up, Equation 4 at the mean depth misses both halves.
    missed = 50.0 * (1 / 1000 - 1 / 3000) / 2.0 * WIDTH / 2.0
    np.testing.assert_allclose(errors[:2, :3], missed, rtol=0.1)
    assert (errors[2:, :3] < 0.3).all()
    assert errors[2, 2] == 0.0
    assert errors.dtype == np.float32


@pytest.mark.parametrize("heading", range(4))
def test_moving_towards_the_mountains_is_along_the_heading(heading):
    errors = errors_around(view_at(heading, depth_m=300.0), level, 3, 400.0)[0]
    north, east, south, west = errors[0, 1], errors[1, 2], errors[2, 1], errors[1, 0]
    around = np.roll([north, east, south, west], -heading)
    # Ahead of the view the mountains are passed.
    np.testing.assert_array_equal(np.isinf(around), [True, False, False, False])


def test_far_mountains_tolerate_every_move_and_near_ones_few():
    def bowl(radius_m):
        def height(east, north):
            distance, bearing = np.hypot(east, north), np.arctan2(east, north)
            ridge = np.exp(-(((distance - radius_m) / (0.25 * radius_m)) ** 2))
            return 0.3 * radius_m * ridge * (1.2 + np.sin(6.0 * bearing + distance / radius_m))

        return field_from(height, 121, radius_m / 40.0)

    sizes = []
    for radius_m in (400.0, 8000.0):
        field = bowl(radius_m)
        views = oracle.skyline(field, stand_on(field, easting_m=0.0, northing_m=0.0), 128)
        errors = errors_around(views, ground_of(field), 11, 25.0)
        sizes.append((errors <= 1.5).sum(axis=(1, 2)))
    assert (sizes[1] == 121).all()
    assert (sizes[0] < 100).all()

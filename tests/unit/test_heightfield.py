"""The surface of a height field, and eyes that stand on it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scenes import FRAME, at_m, field_of

from skyline.errors import InputError
from skyline.geodesy.map_frame import Frame
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_at


def on_triangle(heights, row, col):
    """Evaluate the surface of two triangles a cell at one place, by solving for a plane."""
    top, left = math.floor(row), math.floor(col)
    north_west, south_east = (top, left), (top + 1, left + 1)
    third = (top, left + 1) if col - left > row - top else (top + 1, left)
    corners = np.array([north_west, south_east, third])
    plane = np.linalg.solve(np.column_stack([corners, np.ones(3)]), heights[tuple(corners.T)])
    return float(plane @ [row, col, 1.0])


@given(data=st.data())
def test_height_is_the_triangle_s(data):
    shape = data.draw(st.tuples(st.integers(2, 6), st.integers(2, 6)))
    height_m = st.floats(-500, 9000) | st.just(np.nan)
    heights = data.draw(hnp.arrays(np.float64, shape, elements=height_m))
    part = st.floats(0.001, 0.999)
    south, east = data.draw(st.tuples(part, part).filter(lambda p: abs(p[0] - p[1]) > 1e-3))
    row = data.draw(st.integers(0, shape[0] - 2)) + south
    col = data.draw(st.integers(0, shape[1] - 2)) + east
    field = field_of(heights, 25.0, 30.0, west_m=1000.0, north_m=2000.0)
    height = float(field.height_at(**at_m(field.to_map(row, col))))
    assert height == pytest.approx(on_triangle(heights, row, col), abs=1e-6, nan_ok=True)


def test_heights_given_are_copied_and_frozen():
    heights = np.zeros((3, 3), dtype=np.float32)
    field = field_of(heights)
    digest = field.digest
    heights[1, 1] = 9.0
    assert field.heights_m[1, 1] == 0.0
    assert field_of(field.heights_m.copy()).digest == digest
    assert not field.heights_m.flags.writeable


def test_digest_is_of_samples_grid_and_frame():
    heights = np.zeros((2, 3), dtype=np.float32)
    fields = [
        *map(field_of, (heights, heights + 1, heights.reshape(3, 2), heights.astype(np.float64))),
        field_of(heights, west_m=1.0),
        field_of(heights, 30.0, 25.0),
        field_of(heights, 25.0, 30.0),
        replace(field_of(heights), frame=Frame.local(lon=9.8, lat=46.9)),
    ]
    assert len({field.digest for field in fields}) == 8


@pytest.mark.parametrize(
    "heights", [np.zeros(3), np.zeros((0, 3)), np.full((2, 2), np.inf), np.zeros((2, 2), complex)]
)
def test_unusable_heights_and_corners_are_refused(heights):
    with pytest.raises(InputError):
        field_of(heights)
    with pytest.raises(InputError):
        field_of(np.zeros((2, 2)), west_m=np.nan)


def test_masked_samples_are_holes():
    heights = np.ma.masked_equal(np.array([[7, -9999], [8, 9]], np.int16), -9999)
    field = HeightField(heights, 0.0, 0.0, 30.0, 30.0, FRAME)
    np.testing.assert_array_equal(field.heights_m, [[7.0, np.nan], [8.0, 9.0]])


def test_a_place_is_metres_or_degrees_by_name():
    slope = np.arange(12.0)[np.newaxis, :] + np.zeros((9, 1))
    field = HeightField(slope, -550.0, 400.0, 100.0, 100.0, FRAME)
    lon, lat = FRAME.to_lonlat(230.0, -120.0)
    assert float(field.height_at(lon=lon, lat=lat)) == pytest.approx(7.8, abs=1e-6)
    assert float(field.height_at(easting_m=230.0, northing_m=-120.0)) == pytest.approx(7.8)
    many = field.height_at(lon=[lon, lon, 8.0], lat=lat)
    np.testing.assert_allclose(many, [7.8, 7.8, np.nan], atol=1e-6)
    eye = stand_at(field, lon=lon, lat=lat, eye_height_m=1.5, summit_within_m=0.0)
    assert float(eye.easting_m[0]) == pytest.approx(230.0, abs=1e-6)
    assert float(eye.eye_elevation_m[0]) == pytest.approx(9.3, abs=1e-6)


def test_a_grid_in_degrees_is_no_height_field():
    with pytest.raises(InputError):
        HeightField(np.zeros((3, 3)), 9.0, 47.0, 1.0 / 3600.0, 1.0 / 3600.0, FRAME)

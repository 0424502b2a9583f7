"""Frames, boxes in degrees and curvature, against the ellipsoid."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from skyline.angles import angle_between_deg, wrapped_deg
from skyline.geodesy.bounds import box_around, check_bounds, contains_box, width_deg
from skyline.geodesy.cell_grid import CellGrid
from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import TRUE_DEG, Frame, in_rectangle

WGS84 = Geod(ellps="WGS84")


@given(lon=st.floats(-180.0, 180.0), lat=st.floats(-84.0, 84.0), azimuth=st.floats(0.0, 360.0))
def test_local_frame_is_true_at_its_centre(lon, lat, azimuth):
    frame = Frame.local(lon=lon, lat=lat)
    there_lon, there_lat, _ = WGS84.fwd(lon, lat, azimuth, 1000.0)
    easting, northing = frame.from_lonlat(there_lon, there_lat)
    assert float(easting) == pytest.approx(1000.0 * math.sin(math.radians(azimuth)), abs=0.01)
    assert float(northing) == pytest.approx(1000.0 * math.cos(math.radians(azimuth)), abs=0.01)


def test_scale_is_map_metres_per_metre_on_the_ground():
    mercator = Frame.from_crs("EPSG:3395")
    easting, northing = mercator.from_lonlat([9.9, 9.901], [46.8, 46.8])
    ground_m = WGS84.inv(9.9, 46.8, 9.901, 46.8)[2]
    expected = np.diff(easting)[0] / ground_m
    scale = mercator.scale(easting_m=easting[0], northing_m=northing[0])
    assert float(scale) == pytest.approx(expected, rel=1e-6)
    local = Frame.local(lon=9.9, lat=46.8).scale(easting_m=0.0, northing_m=0.0)
    assert float(local) == pytest.approx(1.0, abs=1e-9)


BOXES = {
    "across, UTM 60": ("EPSG:32660", (810e3, 1000e3, 900e3, 1100e3)),
    "across, Chatham": ("EPSG:3793", (3000e3, 4900e3, 3900e3, 5300e3)),
    "across, beside the pole": ("EPSG:3413", (-500e3, 400e3, -300e3, 600e3)),
    "up to the antimeridian": ("local", (-20e3, -20e3, 0.0, 20e3)),
    "bent sides": ("ESRI:102003", (-2100e3, 200e3, -1800e3, 400e3)),
}


@pytest.mark.parametrize("name", BOXES)
def test_a_box_in_degrees_holds_its_rectangle_and_no_more(name):
    crs, (west_m, south_m, east_m, north_m) = BOXES[name]
    frame = Frame.local(lon=180.0, lat=-17.0) if crs == "local" else Frame.from_crs(crs)
    west, south, east, north = box = frame.box_deg(
        easting_m=[west_m, east_m], northing_m=[south_m, north_m]
    )
    edge = np.meshgrid(np.linspace(west_m, east_m, 301), np.linspace(south_m, north_m, 301))
    lon, lat = frame.to_lonlat(*edge)
    east_of_west, width = (lon - west + 1e-7) % 360.0 - 1e-7, width_deg(box)
    ends = east_of_west.min(), east_of_west.max()
    assert ends == pytest.approx((0.0, width), abs=1e-4 * (1.0 + width))
    assert (lat.min(), lat.max()) == pytest.approx((south, north), abs=1e-4)
    assert (west > east) is name.startswith("across")
    assert -180.0 <= west < 180.0
    assert -180.0 < east <= 180.0
    back_m = frame.rectangle_m(check_bounds(box))
    assert (np.array(back_m[:2]) <= np.array([west_m, south_m]) + 1.0).all()
    assert (np.array(back_m[2:]) >= np.array([east_m, north_m]) - 1.0).all()


ARCTIC, ANTARCTIC = Frame.from_crs("EPSG:3413"), Frame.from_crs("EPSG:3031")
POLES = [(ARCTIC, 90.0), (ANTARCTIC, -90.0), (Frame.local(lon=30.0, lat=89.9), 90.0)]


@pytest.mark.parametrize(("frame", "pole"), POLES)
def test_a_box_round_a_pole_has_all_longitudes(frame, pole):
    sides_m = [-50e3, 50e3]
    box = frame.box_deg(easting_m=sides_m, northing_m=sides_m)
    assert (box[0], box[2]) == (-180.0, 180.0)
    assert pole in (box[1], box[3])
    assert width_deg(check_bounds(box)) == 360.0
    west, south, east, north = frame.rectangle_m(box)
    assert max(west, south) <= -49_999.0
    assert min(east, north) >= 49_999.0


def test_a_map_of_a_wide_area_is_used_where_a_local_frame_is_no_truer():
    """Lambert-93 is made for all of France, 1,000 km wide, and too far off in Corsica alone."""
    lambert = Frame.from_crs("EPSG:2154")
    france_m = lambert.rectangle_m((-4.8, 42.0, 8.2, 51.1))
    greatest = lambert.angle_error_deg(easting_m=france_m[0], northing_m=france_m[1])
    assert TRUE_DEG < float(greatest) < 0.1
    assert lambert.untrue_deg(france_m) == 0.0
    corsica_m = lambert.rectangle_m((8.5, 41.3, 9.6, 41.9))
    assert lambert.untrue_deg(corsica_m) == pytest.approx(0.09, abs=0.01)
    mercator = Frame.from_crs("EPSG:3857")
    wide_m = mercator.rectangle_m((-4.8, 42.0, 8.2, 51.1))
    assert mercator.untrue_deg(wide_m) > 10.0


def test_a_box_around_two_crosses_the_antimeridian_where_they_do():
    east, west = (-179.9, -1.0, -179.6, 0.5), (179.5, 0.0, -179.7, 1.0)
    assert box_around(east, west) == box_around(west, east) == (179.5, -1.0, -179.6, 1.0)
    assert box_around((9.1, 0.0, 9.3, 1.0), (9.2, 0.2, 9.3, 0.4)) == (9.1, 0.0, 9.3, 1.0)


@pytest.mark.parametrize(
    ("inner", "is_in"),
    [
        ((179.5, 0.0, -179.5, 1.0), True),
        ((-179.9, 0.2, -179.6, 0.4), True),
        ((179.4, 0.2, -179.6, 0.4), False),
        ((-179.9, 0.2, -179.4, 0.4), False),
        ((179.6, -0.1, 179.7, 0.4), False),
        ((179.6, 0.2, 179.7, 1.1), False),
    ],
)
def test_a_box_contains_one_that_reaches_out_on_no_side(inner, is_in):
    assert contains_box((179.5, 0.0, -179.5, 1.0), inner) == is_in


def test_rows_of_cells_go_south_from_the_north_western_corner():
    grid = CellGrid(west_m=100.0, north_m=50.0, cell_m=10.0, rows=2, cols=3)
    assert grid.eastings_m().tolist() == [105.0, 115.0, 125.0]
    assert grid.northings_m().tolist() == [45.0, 35.0]


def test_a_rectangle_holds_its_sides():
    inside = in_rectangle((0.0, 0.0, 10.0, 5.0), [0.0, 10.0, 10.1, np.nan], [5.0, 0.0, 0.0, 1.0])
    assert inside.tolist() == [True, True, False, False]


def test_angles_are_taken_the_short_way_round():
    assert wrapped_deg([190.0, -180.0, 540.0]).tolist() == [-170.0, -180.0, -180.0]
    assert float(wrapped_deg(-170.0, 180.0)) == 190.0
    off_deg = angle_between_deg([350.0, 10.0, 0.0], [10.0, 350.0, 180.0])
    assert off_deg.tolist() == [20.0, 20.0, 180.0]


def test_an_eye_sees_a_point_lower_by_the_drop():
    """5 km away, and 500 m up: the drop is 0.87 * 25e6 / (2 * 6371008.8) = 1.707 m."""
    azimuth, tangent, away_m = Curvature().seen(3000.0, 4000.0, 500.0)
    assert math.degrees(azimuth) == pytest.approx(36.8699, abs=1e-4)
    assert (float(tangent), float(away_m)) == (pytest.approx(498.293 / 5000.0, abs=1e-6), 5000.0)


@pytest.mark.parametrize("axis", range(3))
def test_a_point_that_moves_is_seen_to_move_as_the_derivatives_say(axis):
    there = np.array([3000.0, -4000.0, 500.0])
    step = np.eye(3)[axis]
    before, after = (Curvature().seen(*(there + side * step)) for side in (-1.0, 1.0))
    moved = (np.array(after[:2]) - before[:2]) / 2.0
    changes = Curvature().seen_changes(*Curvature().seen(*there))
    np.testing.assert_allclose(changes[:, axis], moved, rtol=1e-6, atol=1e-15)


def test_the_horizon_is_where_the_drop_hides_level_ground():
    """From 2 m, sqrt(2 * 2 * 6371008.8 / 0.87) = 5412 m; ground as high as the eye has none."""
    away_m = Curvature().horizon_m(np.array([2.0, 0.0, -1.0]))
    assert away_m == pytest.approx([5412.0, 0.0, 0.0], abs=0.5)

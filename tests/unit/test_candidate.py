"""Distinct poses among hypotheses; candidates in degrees, from true north, and on the map."""

import dataclasses

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from pyproj import Geod
from ray_scenes import poses
from scenes import candidate_at
from shapely import MultiPolygon, Polygon

from skyline.geodesy.antimeridian import lonlat_rings
from skyline.geodesy.map_frame import Frame
from skyline.pose.outlines import Ellipse, view_wedge_m

MIDDLES = {
    "EPSG:32632": (11.8, 46.8),
    "EPSG:2056": (9.8, 46.8),
    "EPSG:3413": (25.0, 78.0),
    "EPSG:2193": (168.7, -44.6),
}
FRAMES = {name: Frame.from_crs(name) for name in MIDDLES}


@given(
    name=st.sampled_from(sorted(FRAMES)),
    east_m=st.floats(-2e4, 2e4),
    north_m=st.floats(-2e4, 2e4),
    grid_heading_deg=st.floats(0.0, 360.0, exclude_max=True),
)
def test_places_and_headings_go_to_degrees_and_back(name, east_m, north_m, grid_heading_deg):
    frame = FRAMES[name]
    easting_m, northing_m = np.add(frame.from_lonlat(*MIDDLES[name]), [east_m, north_m])
    found = candidate_at(easting_m, northing_m, grid_heading_deg, frame=frame)
    assert 0.0 <= found.heading_deg < 360.0
    back = frame.from_lonlat(found.lon, found.lat)
    np.testing.assert_allclose(back, [easting_m, northing_m], atol=1e-4)
    turn = (found.grid_heading_deg - grid_heading_deg + 180.0) % 360.0 - 180.0
    assert abs(turn) < 1e-9
    # A step along the grid heading goes the true way that the candidate says it looks.
    along = np.radians(grid_heading_deg)
    step = easting_m + 10.0 * np.sin(along), northing_m + 10.0 * np.cos(along)
    lon, lat = frame.to_lonlat(*step)
    east = (lon - found.lon) * np.cos(np.radians(found.lat))
    # On the sphere; the ellipsoid's radii differ by less than a hundredth.
    went = np.degrees(np.arctan2(east, lat - found.lat))
    assert abs((went - found.heading_deg + 180.0) % 360.0 - 180.0) < 0.5


@given(sd_m=st.floats(0.1, 500.0), seed=st.integers(0, 100))
def test_68_of_100_draws_about_a_pose_lie_within_its_radius(sd_m, seed):
    covariance_m2 = ((sd_m**2, 0.0), (0.0, sd_m**2))
    found = dataclasses.replace(candidate_at(0.0, 0.0, 0.0), covariance_m2=covariance_m2)
    drawn = np.random.default_rng(seed).normal(0.0, sd_m, (20_000, 2))
    within = np.hypot(*drawn.T) <= found.radius_m
    # Five standard deviations of such a share.
    assert within.mean() == pytest.approx(0.68, abs=5.0 * np.sqrt(0.68 * 0.32 / 20_000))


def test_the_best_pose_of_a_place_and_a_way_of_looking_stands_for_it():
    east_m = [0.0, 10.0, 500.0, 505.0]
    some = poses(4, easting_m=east_m, grid_heading_deg=[0, 90, 0, 0], cost=[2.0, 1.0, 3.0, 3.0])
    assert some.suppress_non_maxima(9, separation_m=100.0).tolist() == [1, 2]
    turned = poses(3, grid_heading_deg=[359.0, 2.0, 90.0], cost=[1.0, 2.0, 3.0])
    assert turned.suppress_non_maxima(9, separation_m=100.0, turn_deg=10.0).tolist() == [0, 2]
    lost = poses(3, easting_m=[0.0, 500.0, 900.0], cost=[np.inf, 1.0, 2.0])
    assert lost.suppress_non_maxima(1, separation_m=1.0).tolist() == [1]
    assert lost.suppress_non_maxima(5, separation_m=1.0).tolist() == [1, 2]


def test_a_pose_has_rivals_at_other_places_and_in_other_directions():
    east_m = [0.0, 50.0, 900.0]
    some = poses(3, easting_m=east_m, grid_heading_deg=[350.0, 100.0, 5.0], cost=[1.0, 4.0, 9.0])
    assert some.rival_margin(200.0).tolist() == [8.0, 5.0, -8.0]
    assert some.rival_margin(200.0, turn_deg=30.0).tolist() == [3.0, -3.0, -8.0]
    assert np.isinf(some[:1].rival_margin(200.0)).all()


def test_an_ellipse_has_the_covariance_s_axes():
    along, across, azimuth_deg = 30.0, 10.0, 25.0
    major = np.array([np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))])
    minor = np.array([major[1], -major[0]])
    covariance = along**2 * np.outer(major, major) + across**2 * np.outer(minor, minor)
    ellipse = Ellipse.of(candidate_at(5.0, 7.0, covariance_m2=covariance))
    quantile = np.sqrt(-2.0 * np.log(0.05))
    assert ellipse.semi_major_m == pytest.approx(along * quantile)
    assert ellipse.semi_minor_m == pytest.approx(across * quantile)
    outline = ellipse.outline_m
    away = outline - [5.0, 7.0]
    assert np.degrees(np.arctan2(*away[0])) % 180.0 == pytest.approx(azimuth_deg)
    off = np.einsum("pi,ij,pj->p", away, np.linalg.inv(covariance), away)
    np.testing.assert_allclose(off, quantile**2)
    np.testing.assert_array_equal(outline[0], outline[-1])
    assert Polygon(outline).area == pytest.approx(np.pi * along * across * quantile**2, rel=0.01)
    assert Polygon(outline).exterior.is_ccw


def test_a_wedge_spans_the_field_of_view_about_the_heading():
    looking = candidate_at(500.0, 70.0, 350.0)
    wedge = view_wedge_m(looking, 1000.0)
    np.testing.assert_array_equal(wedge[[0, -1]], [[looking.easting_m, looking.northing_m]] * 2)
    away = wedge[1:-1] - wedge[0]
    np.testing.assert_allclose(np.hypot(*away.T), 1000.0)
    azimuth = np.degrees(np.arctan2(*away.T)) % 360.0
    np.testing.assert_allclose(azimuth[[-1, 0]], [320.0, 20.0])
    assert Polygon(wedge).exterior.is_ccw


GEOD = Geod(ellps="WGS84")
FIJI = Frame.local(lon=180.0, lat=-17.0)


@pytest.mark.parametrize("fov_deg", [1.0, 200.0, 360.0])
@pytest.mark.parametrize("east_m", [-3000.0, -1999.0, 0.0, 1e-4, 300.0])
def test_a_view_is_cut_at_the_antimeridian(east_m, fov_deg):
    for heading_deg in range(0, 360, 15):
        held = candidate_at(east_m, 0.0, heading_deg, fov_deg=fov_deg, frame=FIJI)
        wedge = view_wedge_m(held, 2000.0)
        rings = lonlat_rings(wedge, FIJI)
        polygons = [Polygon(ring) for ring in rings]
        assert MultiPolygon(polygons).is_valid
        assert all(one.exterior.is_ccw for one in polygons)
        assert np.abs(np.concatenate(rings)[:, 0]).max() <= 180.0
        assert max(np.ptp(ring[:, 0]) for ring in rings) < 0.05
        area_m2 = sum(GEOD.geometry_area_perimeter(one)[0] for one in polygons)
        assert area_m2 == pytest.approx(Polygon(wedge).area, rel=1e-3)
        sides = {bool(np.mean(ring[:, 0]) > 0.0) for ring in rings}
        assert sides == {bool(side) for side in wedge[np.abs(wedge[:, 0]) > 0.05, 0] < 0.0}

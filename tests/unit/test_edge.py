"""The edge of a DEM: how far off it is, and how high what lies beyond may stand."""

import numpy as np
import pytest
from scenes import field_of

from skyline.geodesy import Curvature
from skyline.terrain.edge import DataEdge

BOUNDS_M = (-3000.0, -1000.0, 5000.0, 2000.0)
AZIMUTH_RAD = np.radians(np.append(np.arange(0.0, 360.0, 7.3), [90.0, 180.0, 270.0]))
CURVED, FLAT = Curvature(), Curvature(enabled=False)


def _inside(easting_m, northing_m):
    west, south, east, north = BOUNDS_M
    return (west <= easting_m) & (easting_m <= east) & (south <= northing_m) & (northing_m <= north)


@pytest.mark.parametrize("place_m", [(0.0, 0.0), (4900.0, -900.0), (-2999.0, 1999.0)])
def test_the_edge_is_where_a_ray_leaves_the_data(place_m):
    distance_m = DataEdge(BOUNDS_M, 900.0, CURVED).distance_m(*place_m, AZIMUTH_RAD)
    for azimuth, edge_m in zip(AZIMUTH_RAD, distance_m, strict=True):
        along_m = np.arange(0.5, 12_000.0, 1.0)
        east, north = place_m[0] + along_m * np.sin(azimuth), place_m[1] + along_m * np.cos(azimuth)
        left_m = along_m[~_inside(east, north)][0]
        assert edge_m == pytest.approx(max(left_m, 1.0), abs=1.0)


@pytest.mark.parametrize("curvature", [CURVED, FLAT])
@pytest.mark.parametrize("eye_m", [200.0, 899.0, 900.0, 1500.0])
def test_nothing_beyond_the_edge_stands_higher_than_is_said(curvature, eye_m):
    edge = DataEdge(BOUNDS_M, 900.0, curvature)
    most = edge.elevation_tan(100.0, -200.0, eye_m, AZIMUTH_RAD)
    from_m = edge.distance_m(100.0, -200.0, AZIMUTH_RAD)
    past_m = from_m[:, np.newaxis] + np.append(0.0, np.geomspace(0.1, 1e6, 4000))
    seen = (900.0 - eye_m - curvature.drop_m(past_m)) / past_m
    highest = seen.max(axis=1)
    assert (seen <= most[:, np.newaxis] + 1e-12).all()
    np.testing.assert_allclose(most, highest, atol=1e-3 if curvature is FLAT else 1e-6)


def test_the_edge_of_a_field_is_its_outermost_samples():
    field = field_of(np.arange(12.0).reshape(3, 4), spacing_m=30.0)
    edge = DataEdge.of(field, CURVED)
    assert edge.bounds_m == field.bounds_m
    assert edge.highest_m == 11.0

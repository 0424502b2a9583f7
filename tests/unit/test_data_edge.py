"""The edge of a DEM: its distance, and the height of terrain beyond."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import field_of

from skyline.geodesy.earth import Curvature
from skyline.terrain.data_edge import DataEdge

BOUNDS_M = (-3000.0, -1000.0, 5000.0, 2000.0)
AZIMUTH_RAD = np.radians(np.append(np.arange(0.0, 360.0, 7.3), [90.0, 180.0, 270.0]))
CURVED, FLAT = Curvature(), Curvature(enabled=False)


def _inside(easting_m, northing_m, bounds_m=BOUNDS_M):
    west, south, east, north = bounds_m
    return (west <= easting_m) & (easting_m <= east) & (south <= northing_m) & (northing_m <= north)


@pytest.mark.parametrize("place_m", [(0.0, 0.0), (4900.0, -900.0), (-2999.0, 1999.0)])
def test_the_edge_is_where_a_ray_leaves_the_data(place_m):
    # 900 m above the eye, on a flat Earth, the tangent gives the distance of the edge.
    edge = DataEdge(BOUNDS_M, np.full((4, 1), 900.0), FLAT)
    distance_m = 900.0 / edge.elevation_tan(*place_m, 0.0, AZIMUTH_RAD)
    for azimuth, edge_m in zip(AZIMUTH_RAD, distance_m, strict=True):
        along_m = np.arange(0.5, 12_000.0, 1.0)
        east, north = place_m[0] + along_m * np.sin(azimuth), place_m[1] + along_m * np.cos(azimuth)
        left_m = along_m[~_inside(east, north)][0]
        assert edge_m == pytest.approx(max(left_m, 1.0), abs=1.0)


@pytest.mark.parametrize("curvature", [CURVED, FLAT])
@pytest.mark.parametrize("eye_m", [200.0, 899.0, 900.0, 1500.0])
def test_nothing_beyond_the_edge_stands_higher_than_its_bound(curvature, eye_m):
    edge, high = (DataEdge(BOUNDS_M, np.full((4, 1), m), curvature) for m in (900.0, 1e6))
    most = edge.elevation_tan(100.0, -200.0, eye_m, AZIMUTH_RAD)
    flat = replace(high, curvature=FLAT)
    from_m = (1e6 - eye_m) / flat.elevation_tan(100.0, -200.0, eye_m, AZIMUTH_RAD)
    past_m = from_m[:, np.newaxis] + np.append(0.0, np.geomspace(0.1, 1e6, 4000))
    seen = (900.0 - eye_m - curvature.drop_m(past_m)) / past_m
    highest = seen.max(axis=1)
    assert (seen <= most[:, np.newaxis] + 1e-12).all()
    np.testing.assert_allclose(most, highest, atol=1e-3 if curvature is FLAT else 1e-6)


def test_terrain_beyond_is_as_high_as_terrain_near_the_edge():
    heights = np.random.default_rng(8).exponential(300.0, (70, 90))
    heights[20:40, :30] = np.nan
    field = field_of(heights, spacing_m=1000.0)
    edge = DataEdge.of(field, FLAT)
    sample_east, sample_north = field.to_map(*np.indices(heights.shape))
    away_m = np.arange(0.0, 150_000.0, 10.0)
    places = np.random.default_rng(9).uniform(edge.bounds_m[:2], edge.bounds_m[2:], (40, 2))
    for (place_east, place_north), azimuth in zip(places, AZIMUTH_RAD[:40], strict=True):
        on_east = place_east + away_m * np.sin(azimuth)
        on_north = place_north + away_m * np.cos(azimuth)
        inside = _inside(on_east, on_north, edge.bounds_m)
        left_m = away_m[inside][-1]
        exit_east, exit_north = on_east[inside][-1], on_north[inside][-1]
        most = edge.elevation_tan(place_east, place_north, 0.0, azimuth) * left_m
        # The band is ten samples deep; parts of a side and samples are half a sample apart at most.
        apart_m = np.maximum(abs(sample_east - exit_east), abs(sample_north - exit_north))
        known = np.where(np.isnan(heights), 0.0, heights)
        assert known[apart_m <= 8500.0].max() <= most * 1.01
        assert most <= known[apart_m <= 11_500.0].max() * 1.01

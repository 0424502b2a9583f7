"""The oracle against a loop over every edge of every triangle."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import FRAME

from skyline.geodesy.earth import Curvature
from skyline.skylines import columns_u, rotation
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle


def skyline_by_edges(field, viewpoints, index, heading, width):
    """Return v of every column by a loop over the edges of all triangles."""
    heights = field.heights_m.astype(np.float64)
    edges = set()
    for row in range(field.rows - 1):
        for col in range(field.cols - 1):
            diagonal = ((row, col), (row + 1, col + 1))
            for third in ((row, col + 1), (row + 1, col)):
                corners = (*diagonal, third)
                if not any(np.isnan(heights[corner]) for corner in corners):
                    edges |= {diagonal, (diagonal[0], third), (third, diagonal[1])}
    u = columns_u(width)
    best = np.full(width, -np.inf)
    for ends in edges:
        points = []
        for row, col in ends:
            east, north = field.to_map(row, col)
            east, north = east - viewpoints.easting_m[index], north - viewpoints.northing_m[index]
            up = heights[row, col] - viewpoints.eye_elevation_m[index]
            up -= Curvature().drop_per_m2 * (east**2 + north**2)
            points.append(rotation(heading) @ np.array([east, up, north]))
        first, second = points
        start, end = first[0] - u * first[2], second[0] - u * second[2]
        crossed = (start * end <= 0.0) & (start != end)
        share = np.where(crossed, start / np.where(crossed, start - end, 1.0), 0.0)
        depth = first[2] + share * (second[2] - first[2])
        crossed &= depth > 0.0
        up = first[1] + share * (second[1] - first[1])
        best = np.where(crossed, np.maximum(best, up / np.where(crossed, depth, 1.0)), best)
    return best


@settings(max_examples=25)
@given(*[st.integers(2, 9)] * 2, st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from([7, 16]))
def test_oracle_equals_a_loop_over_every_edge(rows, cols, seed, holes, width):
    generator = np.random.default_rng(seed)
    heights = generator.normal(size=(rows, cols)) * 40.0
    if holes:
        heights[generator.random((rows, cols)) < 0.2] = np.nan
    field = HeightField(heights, 1e6, 5e6, 30.0, 25.0, FRAME)
    easting = 1e6 + generator.uniform(0, (cols - 1) * 30.0, 20)
    northing = 5e6 - generator.uniform(0, (rows - 1) * 25.0, 20)
    standing = ~np.isnan(field.height_at(easting_m=easting, northing_m=northing))
    viewpoints = stand_on(
        field, easting_m=easting[standing][:1], northing_m=northing[standing][:1], eye_height_m=1.5
    )
    views = oracle.skyline(field, viewpoints, width)
    for index in range(len(viewpoints)):
        for heading in range(4):
            expected = skyline_by_edges(field, viewpoints, index, heading, width)
            expected[np.isinf(expected)] = np.nan
            below_m = viewpoints.eye_elevation_m[index] - np.nanmin(field.heights_m)
            dip_tan = -2.0 * np.sqrt(below_m * Curvature().drop_per_m2)
            # The field ends within a tenth of the distance of such a horizon.
            expected = np.maximum(expected, dip_tan * np.hypot(1.0, columns_u(width)))
            found = views.v[4 * index + heading]
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)

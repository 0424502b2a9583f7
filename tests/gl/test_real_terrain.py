"""Both skylines of real terrain: the rasterizer against the oracle, and against others' figures."""

import numpy as np
import pytest
from scenes import at_m, scattered

from skyline.geodesy.earth import Curvature
from skyline.geodesy.map_frame import Frame
from skyline.render.depth import DepthRenderer
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle

SEED = 20


@pytest.fixture(scope="module")
def lakes(shared_data):
    """Heights, and another program's horizons in degrees by azimuth."""
    with np.load(shared_data / "sierra" / "lakes_ipw_horizon.npz") as published:
        corner = float(published["x"][0]), float(published["y"][0])
        frame = Frame.from_crs("EPSG:32611")
        field = HeightField(published["dem"], *corner, 50.0, 50.0, frame)
        azimuth = published["azimuth_compass"]
        cardinal = [int(np.flatnonzero(azimuth == 90 * heading)[0]) for heading in range(4)]
        return field, published["horizon_elev_deg"][cardinal]


@pytest.mark.slow
def test_lakes_horizons_agree_with_published_ones(lakes):
    field, published_deg = lakes
    generator = np.random.default_rng(SEED)
    row = generator.integers(20, field.rows - 20, 300)
    col = generator.integers(20, field.cols - 20, 300)
    viewpoints = stand_on(field, **at_m(field.to_map(row, col)), eye_height_m=0.0)
    flat = Curvature(enabled=False)
    # An odd width has a column straight ahead, where the ordinate is the elevation's tangent.
    truth = oracle.skyline(field, viewpoints, 3, flat)
    with DepthRenderer(field, 641, flat) as renderer:
        views = renderer.render(viewpoints)
    assert np.isfinite(truth.v).all()
    for found in (truth, views):
        straight_ahead = found.v[:, found.width // 2].reshape(-1, 4)
        difference_deg = np.degrees(np.arctan(straight_ahead)) - published_deg[:, row, col].T
        assert (np.abs(np.nanmedian(difference_deg, axis=0)) < 0.1).all()


@pytest.mark.slow
def test_everest_voids_are_counted_and_make_no_phantom_skyline(shared_data):
    field = read_dem([shared_data / "everest" / "mt_everest_90m.tif"])
    counts = field.provenance
    # Spikes were voids in all but name, so they join the file's own 130,953.
    assert counts.filled + counts.hollow == 130_953 + counts.despiked
    assert counts.despiked < 20
    viewpoints = scattered(field, 12, SEED)
    truth = oracle.skyline(field, viewpoints, 160)
    with DepthRenderer(field, 160) as renderer:
        views = renderer.render(viewpoints)
    for skylines in (truth, views):
        points = skylines.skyline_points_m()
        distance = np.hypot(points[..., 0], points[..., 2])
        height = points[..., 1] + skylines.eye_elevation_m[:, np.newaxis]
        height += Curvature().drop_m(distance)
        # Half a pixel of the depth path stands for this much at the skyline's distance.
        slack = distance / 160.0
        assert np.nanmax(height - slack) < 8849.0
    seen = (views.flags == 0) & (truth.flags == 0)
    error_px = (views.v - truth.v)[seen] * 80.0
    assert np.abs(error_px).max() <= 1.0

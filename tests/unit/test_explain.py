"""The bounds that `skyline explain` prints hold."""

import numpy as np
import pytest
from scenes import at_m, field_of, fractal

from skyline.geodesy.earth import Curvature
from skyline.skylines import pixel_size
from skyline.tasks.explain import curvature_bound_px
from skyline.terrain.sight_range import sight_range_m
from skyline.terrain.viewpoints import stand_on
from skyline_bench.truth import oracle


def test_leaving_curvature_out_costs_no_more_than_its_bound():
    for seed in range(5):
        field, place = field_of(fractal(64, 64, 900.0, seed=seed), 300.0), at_m((9000.0, -9000.0))
        eyes, mars = stand_on(field, **place), Curvature(radius_m=3_389_500.0, refraction_k=0.0)
        reach_m = field.reach_m(**place)
        bound_px = curvature_bound_px(reach_m, mars, 160)
        curved = oracle.skyline(field, eyes, 160, mars)
        flat = oracle.skyline(field, eyes, 160, Curvature(enabled=False))
        # The horizon of ground past the border is none of a flat Earth's.
        inside = curved.depth_m <= reach_m
        cost_px = np.abs(curved.v - flat.v)[inside].max() / pixel_size(160)
        assert 0.1 * bound_px < cost_px <= bound_px


@pytest.mark.parametrize("eye_height_m", [2.0, 300.0])
def test_nothing_beyond_sight_shows(eye_height_m):
    """A pillar of the greatest height shows just within the range of sight, not beyond it."""
    moon = Curvature(radius_m=200_000.0, refraction_k=0.0)
    for share, shows in ((0.98, True), (1.02, False)):
        heights = np.zeros((5, 400), dtype=np.float32)
        heights[:, -1] = 500.0
        field = field_of(heights, 100.0)
        sight_m = sight_range_m(field, eye_height_m, moon)
        easting = (field.cols - 1) * 100.0 - share * sight_m
        eye = stand_on(field, easting_m=easting, northing_m=-200.0, eye_height_m=eye_height_m)
        view = oracle.skyline(field, eye, 65, moon)
        assert (view.depth_m[1, 32] > 0.97 * share * sight_m) == shows

"""Synthetic queries against the oracle, and what their seed and their options decide."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import field_of, fractal

from skyline.errors import InputError
from skyline.matching.query_rays import level
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.truth import oracle

pytestmark = pytest.mark.usefixtures("no_gl_error")

EXACT = QueryConfig(
    fov_error=0.0, noise_deg=(0.0, 0.0), masked_share=0.0, fov_deg=(40.0, 90.0), width_px=320
)
PLAIN = QueryConfig(width_px=320)
AREA = (1000.0, -3000.0, 3000.0, -1000.0)


@pytest.fixture(scope="module")
def terrain():
    """Rough terrain, 4 x 4 km, with a hole."""
    heights = fractal(134, 134, 500.0, seed=4)
    heights[50:60, 50:60] = np.nan
    return field_of(heights)


def found_rows(queries):
    return np.stack([query.skyline.row_px for query in queries])


def test_an_exact_query_levelled_is_the_oracles_skyline(terrain):
    for query in make_queries(terrain, AREA, 4, seed=2, config=EXACT):
        truth = query.truth
        assert query.given_fov_deg == truth.fov_deg
        assert query.fov_slack == 0.0
        rays = query.rays()
        azimuth, y = level(rays.u, rays.v, truth.pitch_deg, truth.roll_deg)
        eye = Viewpoints(
            easting_m=np.array([truth.easting_m]),
            northing_m=np.array([truth.northing_m]),
            eye_elevation_m=np.array([truth.eye_elevation_m]),
        )
        views = oracle.skyline(terrain, eye, width=4096)
        order = np.argsort(views.azimuth_deg().ravel())
        expected = np.interp(
            np.degrees(azimuth) + truth.heading_deg,
            views.azimuth_deg().ravel()[order],
            views.elevation_deg().ravel()[order],
            period=360.0,
        )
        error = np.abs(np.degrees(np.arctan(y)) - expected)
        # Corners between two columns and the sides of cliffs are where widths differ.
        assert np.median(error) < 1e-4
        assert np.quantile(error, 0.95) < 0.02


def test_eyes_stand_on_the_surface_inside_the_area(terrain):
    around_the_hole = (1400.0, -1900.0, 1900.0, -1400.0)
    queries = make_queries(terrain, around_the_hole, 40, seed=1, config=PLAIN)
    for truth in (query.truth for query in queries):
        assert 1400.0 <= truth.easting_m <= 1900.0
        assert -1900.0 <= truth.northing_m <= -1400.0
        ground_m = terrain.height_at(easting_m=truth.easting_m, northing_m=truth.northing_m)
        assert truth.eye_elevation_m == pytest.approx(ground_m + 2.0)


def test_a_seed_decides_and_the_count_does_not(terrain):
    few, many = (make_queries(terrain, AREA, count, seed=3, config=PLAIN) for count in (2, 70))
    other = make_queries(terrain, AREA, 2, seed=4, config=PLAIN)
    assert found_rows(few).tobytes() == found_rows(many[:2]).tobytes()
    assert [query.truth for query in few] == [query.truth for query in many[:2]]
    assert few[0].truth != other[0].truth


def test_poses_do_not_depend_on_the_rest(terrain):
    plain = make_queries(terrain, AREA, 6, seed=3, config=PLAIN)
    hidden = make_queries(
        terrain, AREA, 6, seed=3, config=replace(PLAIN, occluded_share=(0.3, 0.3), noise_deg=(0, 0))
    )
    assert [query.truth for query in plain] == [query.truth for query in hidden]
    assert [query.given_fov_deg for query in plain] == [query.given_fov_deg for query in hidden]


def test_errors_are_as_large_as_asked(terrain):
    queries = make_queries(terrain, AREA, 30, seed=5, config=replace(PLAIN, noise_deg=(0.2, 0.2)))
    error_px = np.concatenate([query.skyline.row_px - query.row_px for query in queries])
    error_deg = np.degrees(error_px / (160.0 / np.tan(np.radians(30.0))))
    assert np.sqrt(np.nanmean(error_deg**2)) == pytest.approx(0.2, rel=0.05)
    # Half of the variance is shared by neighbouring columns.
    neighbours = np.nanmean(error_deg[:-1] * error_deg[1:]) / np.nanmean(error_deg**2)
    assert neighbours == pytest.approx(0.5, abs=0.06)


def test_masks_and_given_fields_of_view(terrain):
    queries = make_queries(terrain, AREA, 40, seed=6, config=PLAIN)
    for query in queries:
        off = query.given_fov_deg / query.truth.fov_deg - 1.0
        assert abs(off) <= PLAIN.fov_error == pytest.approx(np.sqrt(3.0) * query.fov_slack)
        masked = ~query.skyline.trusted & np.isfinite(query.row_px)
        assert masked.sum() <= 32
        assert np.isfinite(query.distance_m) == np.isfinite(query.row_px).any()
    ratio = np.array([query.given_fov_deg / query.truth.fov_deg for query in queries])
    assert 0.95 <= ratio.min() < 0.97
    assert 1.03 < ratio.max() <= 1.05


@pytest.mark.parametrize("masked", [0.0, 1.0])
def test_occluders_are_masked_or_left_in(terrain, masked):
    config = replace(
        EXACT, fov_deg=(60.0, 60.0), occluded_share=(0.25, 0.25), occluders_masked=masked
    )
    for query in make_queries(terrain, AREA, 5, seed=7, config=config):
        hidden = np.zeros(320, dtype=bool)
        for occluder in query.occluders:
            hidden[slice(*occluder.columns)] = True
        assert hidden.sum() == 80
        found, true = query.skyline.row_px, query.row_px
        np.testing.assert_array_equal(found[~hidden], true[~hidden])
        if masked:
            assert np.isnan(found[hidden]).all()
        else:
            seen = hidden & np.isfinite(true) & np.isfinite(found)
            assert seen.any()
            assert (found[seen] < true[seen]).all()


@pytest.mark.parametrize(
    "config",
    [
        {"fov_deg": (90.0, 40.0)},
        {"fov_error": 0.6},
        {"max_tilt_deg": 30.0},
        {"occluded_share": (0.0, 1.0)},
        {"smooth_share": -0.1},
        {"masked_runs": 0},
        {"azimuths": 0},
    ],
)
def test_bad_options_are_refused(config):
    with pytest.raises(InputError, match="expected"):
        QueryConfig(**config)


def test_bad_requests_are_refused(terrain):
    with pytest.raises(InputError, match="number of queries is 0"):
        make_queries(terrain, AREA, 0)
    with pytest.raises(InputError, match="seed is -1"):
        make_queries(terrain, AREA, 1, seed=-1)
    with pytest.raises(InputError, match="no place on the surface"):
        make_queries(terrain, (1600.0, -1700.0, 1700.0, -1600.0), 1)


def test_aligned_queries_look_as_stored_views_do(terrain):
    config = replace(EXACT, is_aligned=True)
    headings = {one.truth.heading_deg for one in make_queries(terrain, AREA, 20, 6, config)}
    assert headings == {0.0, 90.0, 180.0, 270.0}

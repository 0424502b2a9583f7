"""Synthetic queries: cameras, occluders, other elevation models, and the skylines made of them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ray_scenes import hills
from scenes import field_of, fractal

from skyline.camera.levelling import level
from skyline.camera.warps import undistorted
from skyline.photo.noted_focal_length import NOMINAL_SD
from skyline.photo.skyline import PhotoSkyline
from skyline.render.depth import DepthRenderer
from skyline.terrain.viewpoints import at_elevation
from skyline_bench.queries.made_photos import Scenery
from skyline_bench.queries.pinhole import Camera
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.truth import oracle
from skyline_training.examples import with_lenses
from skyline_training.photos import draw_photo

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


def test_an_exact_query_levelled_is_the_oracles_skyline(terrain):
    for query in make_queries(terrain, AREA, 4, seed=2, config=EXACT):
        truth = query.truth
        assert query.given_fov_deg == truth.fov_deg
        assert query.fov_sd_share == 0.0
        rays = query.rays()
        azimuth, y = level(rays.u, rays.v, truth.pitch_deg, truth.roll_deg)
        eye = at_elevation(terrain, truth.easting_m, truth.northing_m, truth.eye_elevation_m)
        views = oracle.skyline(terrain, eye, width=4096)
        seen = views.grid_azimuth_deg().ravel(), views.elevation_deg().ravel()
        expected = np.interp(np.degrees(azimuth) + truth.grid_heading_deg, *seen, period=360.0)
        error = np.abs(np.degrees(np.arctan(y)) - expected)
        # Corners between two columns and the sides of cliffs are where widths differ.
        assert np.median(error) < 1e-4
        assert np.quantile(error, 0.95) < 0.02


@pytest.mark.parametrize("distortion_sd", [0.0, 0.05])
def test_a_bent_query_without_its_distortion_is_the_pin_hole_camera_s(terrain, distortion_sd):
    """The truth's sign of the distortion is the matcher's."""
    bent = replace(EXACT, distortion_sd=distortion_sd)
    pairs = zip(
        make_queries(terrain, AREA, 6, seed=2, config=EXACT),
        make_queries(terrain, AREA, 6, seed=2, config=bent),
        strict=True,
    )
    for straight, query in pairs:
        k, half_width = query.truth.distortion, np.tan(np.radians(query.truth.fov_deg / 2.0))
        across, above = (plane / half_width for plane in query.skyline.image_plane())
        u, v = (half_width * place for place in undistorted(across, above, k))
        expected_u, expected_v = straight.skyline.image_plane()
        error = np.abs(v - np.interp(u, expected_u, expected_v, np.nan, np.nan))
        assert (k == 0.0) == (distortion_sd == 0.0)
        assert np.nanquantile(error, 0.9) < 0.5 * half_width / query.skyline.width_px
        assert np.isfinite(error).mean() > 0.8


def test_a_bent_photograph_s_skyline_is_its_query_s(terrain):
    bright = Scenery(visibility_m=1e6, snow_line_m=np.inf, tree_line_m=-np.inf, clouds=0.0)
    config = replace(EXACT, distortion_sd=0.05, height_px=240, azimuths=14_400)
    with DepthRenderer(terrain, 640) as renderer:
        for query in make_queries(terrain, AREA, 3, seed=2, config=config):
            photo = draw_photo(renderer, query, 1, bright).astype(np.float64)
            trusted = query.skyline.trusted
            row = np.rint(query.skyline.row_px[trusted]).astype(int)
            inside = (row > 6) & (row < 233)
            column = np.flatnonzero(trusted)[inside]
            above, below = (photo[row[inside] + d, column].mean(axis=1) for d in (-3, 3))
            assert len(column) > 100
            assert np.mean(above > below) > 0.95


def test_a_seed_decides_and_the_count_does_not(terrain):
    few, many = (make_queries(terrain, AREA, count, seed=3, config=PLAIN) for count in (2, 70))
    other = make_queries(terrain, AREA, 2, seed=4, config=PLAIN)
    for one, same in zip(few, many, strict=False):
        assert one.skyline.row_px.tobytes() == same.skyline.row_px.tobytes()
        assert one.truth == same.truth
    assert few[0].truth != other[0].truth


def test_cameras_are_tilted_evenly_or_as_people_hold_them(terrain):
    held = replace(PLAIN, tilt_sd_deg=(6.0, 3.0), max_tilt_deg=15.0)
    for config, sd_deg in ((PLAIN, (5.0 / 3.0**0.5,) * 2), (held, (6.0, 3.0))):
        truths = [query.truth for query in make_queries(terrain, AREA, 200, seed=3, config=config)]
        tilt_deg = np.array([[truth.pitch_deg, truth.roll_deg] for truth in truths])
        # The standard error of a standard deviation is a twentieth of it.
        assert tilt_deg.std(axis=0) == pytest.approx(sd_deg, rel=0.15)
        assert np.abs(tilt_deg).max() <= config.max_tilt_deg


def test_occluders_are_masked_or_left_in(terrain):
    config = replace(EXACT, fov_deg=(60.0, 60.0), occluded_share=(0.25, 0.25))
    noticed = left_in = 0
    for query in make_queries(terrain, AREA, 5, seed=7, config=config):
        hidden = np.zeros(320, dtype=bool)
        found, true = query.skyline.row_px, query.row_px
        for occluder in query.occluders:
            columns = slice(*occluder.columns)
            hidden[columns] = True
            seen = np.isfinite(found[columns])
            noticed += not seen.any()
            left_in += int(seen.any())
            above = seen & np.isfinite(true[columns])
            assert (found[columns][above] < true[columns][above]).all()
        assert hidden.sum() == 80
        np.testing.assert_array_equal(found[~hidden], true[~hidden])
    assert min(noticed, left_in) > 0


AZIMUTH_DEG = np.arange(0.0, 360.0, 0.02)


@given(
    heading_deg=st.floats(0.0, 360.0),
    pitch_deg=st.floats(-15.0, 15.0),
    roll_deg=st.floats(-15.0, 15.0),
    fov_deg=st.floats(20.0, 100.0),
)
def test_levelling_the_image_gives_the_skyline_back(heading_deg, pitch_deg, roll_deg, fov_deg):
    camera = Camera(heading_deg, pitch_deg, roll_deg, fov_deg, 200, 300)
    row_px, sample = camera.skyline(AZIMUTH_DEG, hills(np.radians(AZIMUTH_DEG)))
    assert np.isfinite(row_px).all()
    query = PhotoSkyline(row_px, np.ones(200), 200, 300, fov_deg)
    azimuth, y = level(*query.image_plane(), pitch_deg, roll_deg)
    azimuth_deg = np.degrees(azimuth) + heading_deg
    np.testing.assert_allclose(y, hills(np.radians(azimuth_deg)), atol=1e-5)
    apart = (AZIMUTH_DEG[sample] - azimuth_deg + 180.0) % 360.0 - 180.0
    assert np.abs(apart).max() < 0.021


def test_the_upper_of_two_branches_is_the_skyline():
    # A cliff, 0.2 high from azimuth 0 on, leans over to the left of a rolled image.
    steps = np.where((AZIMUTH_DEG >= 0.0) & (AZIMUTH_DEG < 20.0), 0.2, 0.0)
    rolled = Camera(0.0, roll_deg=10.0, width_px=400, height_px=400)
    row_px, _ = rolled.skyline(AZIMUTH_DEG, steps)
    foot = rolled.skyline(AZIMUTH_DEG, np.zeros_like(steps))[0]
    leaning = np.flatnonzero(row_px < foot - 1.0)
    # The cliff's top is 0.2 tan(10 deg) of a focal length aside of its foot.
    assert leaning.min() == pytest.approx(
        199.5 - 0.2 * np.sin(np.radians(10)) * rolled.focal_px, abs=2
    )
    assert np.isfinite(row_px).all()


def test_lenses_are_known_in_three_ways_in_turn(terrain):
    made = make_queries(terrain, AREA, 300, seed=2, config=PLAIN)
    given, noted, unknown = (with_lenses(made, seed=2)[kind::3] for kind in range(3))
    assert [query.skyline for query in given] == [query.skyline for query in made[::3]]
    assert {query.skyline.fov_deg for query in unknown} == {None}
    rays = [query.rays() for query in noted]
    np.testing.assert_allclose([one.lens.sd for one in rays], NOMINAL_SD)
    off = [one.log_scale(query.truth.fov_deg) for one, query in zip(rays, noted, strict=True)]
    whole = np.array(off) > -3.0 * NOMINAL_SD
    # Of crops, evenly down to a half, one in eight is as wide as three deviations.
    assert np.mean(whole) == pytest.approx(0.83, abs=0.1)
    assert max(off) < 4.0 * NOMINAL_SD

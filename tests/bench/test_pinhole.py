"""A skyline on the image of a camera held anyhow."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyline.errors import InputError
from skyline.matching.query_rays import level
from skyline.photo.query import QuerySkyline
from skyline_bench.queries.pinhole import Camera

AZIMUTH_DEG = np.arange(0.0, 360.0, 0.02)


def hills(azimuth_deg):
    """Tangent of the elevation angle of rolling hills."""
    azimuth = np.radians(azimuth_deg)
    return 0.1 + 0.06 * np.sin(5.0 * azimuth) + 0.03 * np.cos(17.0 * azimuth)


@given(
    heading_deg=st.floats(0.0, 360.0),
    pitch_deg=st.floats(-15.0, 15.0),
    roll_deg=st.floats(-15.0, 15.0),
    fov_deg=st.floats(20.0, 100.0),
)
def test_levelling_the_image_gives_the_skyline_back(heading_deg, pitch_deg, roll_deg, fov_deg):
    camera = Camera(heading_deg, pitch_deg, roll_deg, fov_deg, 200, 300)
    row_px, sample = camera.skyline(AZIMUTH_DEG, hills(AZIMUTH_DEG))
    assert np.isfinite(row_px).all()
    query = QuerySkyline(row_px, np.ones(200), 200, 300, fov_deg)
    azimuth, y = level(*query.image_plane(), pitch_deg, roll_deg)
    azimuth_deg = np.degrees(azimuth) + heading_deg
    np.testing.assert_allclose(y, hills(azimuth_deg), atol=1e-5)
    apart = (AZIMUTH_DEG[sample] - azimuth_deg + 180.0) % 360.0 - 180.0
    assert np.abs(apart).max() < 0.021


def test_rays_of_the_skylines_pixels_point_at_it():
    camera = Camera(130.0, -4.0, 6.0, 70.0, 64, 80)
    row_px, _ = camera.skyline(AZIMUTH_DEG, hills(AZIMUTH_DEG))
    rays, column = camera.rays(), np.arange(64)
    above, below = np.floor(row_px).astype(int), np.ceil(row_px).astype(int)
    for row, sign in ((above, 1.0), (below, -1.0)):
        east, up, north = rays[row, column].T
        over = up / np.hypot(east, north) - hills(np.degrees(np.arctan2(east, north)))
        assert (sign * over > -1e-6).all()


def test_the_optical_axis_looks_along_the_heading():
    east, up, north = Camera(90.0, 10.0, 0.0, 60.0, 3, 3).rays()[1, 1]
    np.testing.assert_allclose([east, up, north], [np.cos(0.17453), np.sin(0.17453), 0], atol=1e-5)


def test_a_camera_turned_clockwise_sees_the_horizon_rise_to_the_right():
    row_px, _ = Camera(0.0, roll_deg=5.0).skyline(AZIMUTH_DEG, np.zeros_like(AZIMUTH_DEG))
    np.testing.assert_allclose(np.diff(row_px), -np.tan(np.radians(5.0)), atol=1e-3)


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


def test_what_is_not_known_is_not_drawn():
    row_px, sample = Camera(0.0).skyline(AZIMUTH_DEG, np.full_like(AZIMUTH_DEG, np.nan))
    assert np.isnan(row_px).all()
    assert (sample == -1).all()


@pytest.mark.parametrize(
    "wrong", [{"fov_deg": 130.0}, {"pitch_deg": 30.0}, {"roll_deg": -21.0}, {"width_px": 1}]
)
def test_cameras_out_of_range_are_refused(wrong):
    with pytest.raises(InputError, match="expected"):
        Camera(0.0, **wrong)

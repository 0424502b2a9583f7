"""Elevation models of other worlds: their radius, no refraction, and closed forms."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
import rioxarray  # noqa: F401  (the accessor `rio`)
import xarray as xr
from rasterio.transform import from_origin
from scenes import write_dem

from skyline import (
    Frame,
    InputError,
    MatchConfig,
    Matcher,
    PhotoSkyline,
    Viewer,
    build_places,
    horizon,
    read_dem,
    sky_view_grid,
)
from skyline.geodesy.earth import EARTH_RADIUS_M, Curvature
from skyline.report.horizon_files import write_horizons
from skyline.tasks.render import RenderTask

MOON_M = 1_737_400.0
EYE_M = 60.0
LON, LAT = 30.0, -60.0
"""The middle of the models."""
CRS = {
    "degrees": "IAU_2015:30100",
    "metres": f"+proj=stere +lat_0={LAT} +lon_0={LON} +R={MOON_M} +units=m",
}
SAMPLES = 281
WALL_M = 400.0


def away_m(lon, lat):
    """Return the arcs from the middle on the Moon's sphere."""
    lon, lat, lat0 = np.radians(lon - LON), np.radians(lat), np.radians(LAT)
    cosine = np.sin(lat) * np.sin(lat0) + np.cos(lat) * np.cos(lat0) * np.cos(lon)
    return MOON_M * np.arccos(np.clip(cosine, -1.0, 1.0))


@pytest.fixture(scope="module", params=CRS)
def moon(request, tmp_path_factory):
    """A smooth Moon with a wall 12 km round the middle in its southern half, 400 m high."""
    half = SAMPLES // 2
    if request.param == "metres":
        step_x = step_y = 115.0
        middle = 0.0, 0.0
    else:
        step_y = 1.0 / 256.0
        step_x = 2.0 * step_y
        middle = LON, LAT
    offset = np.arange(SAMPLES) - half
    x, y = np.meshgrid(middle[0] + step_x * offset, middle[1] - step_y * offset)
    if request.param == "metres":
        lon, lat = Frame.from_crs(CRS["metres"]).to_lonlat(x, y)
    else:
        lon, lat = x, y
    is_wall = (np.abs(away_m(lon, lat) - 12_000.0) < 600.0) & (lat < LAT)
    # A centimetre of dust: ground of one height with walls round it would be taken for a void.
    dust_m = np.random.default_rng(0).uniform(0.0, 0.01, is_wall.shape)
    heights = (np.where(is_wall, WALL_M, 0.0) + dust_m).astype(np.float32)
    corner = middle[0] - step_x * (half + 0.5), middle[1] + step_y * (half + 0.5)
    path = tmp_path_factory.mktemp("moon") / "moon.tif"
    transform = from_origin(*corner, step_x, step_y)
    return read_dem([write_dem(path, heights, CRS[request.param], transform=transform)])


@pytest.fixture(scope="module")
def around(moon):
    """The horizon round the middle."""
    return horizon(moon, lon=LON, lat=LAT, eye_height_m=EYE_M, step_deg=5.0)


def test_a_moon_has_its_radius_and_no_refraction(moon):
    assert not moon.frame.is_of_earth
    assert moon.frame.curvature == Curvature(radius_m=MOON_M, refraction_k=0.0)
    assert Frame.local(lon=9.8, lat=46.8).curvature == Curvature(EARTH_RADIUS_M, 0.13)


def test_a_number_is_no_curvature():
    with pytest.raises(InputError, match=r"curvature is 0.13; expected a Curvature"):
        Frame.local(lon=9.8, lat=46.8).curvature_or(0.13)


def test_heights_of_a_moon_count_from_its_sphere(moon):
    assert moon.provenance.conventions["vertical_datum"] == (
        "sphere of 1737.4 km, assumed: none is named"
    )


def test_renderings_of_a_moon_have_its_radius_too(moon, tmp_path):
    task = RenderTask(dem=("moon.tif",), output=tmp_path / "moon.h5")
    assert task.config(moon).curvature == moon.frame.curvature
    given = replace(task, refraction_k=0.1).config(moon).curvature
    assert (given.radius_m, given.refraction_k) == (MOON_M, 0.1)


def test_a_metre_of_a_moons_frame_is_a_metre_of_its_ground(moon):
    lon, lat = np.array([30.0, 30.0, 30.02]), np.array([-60.0, -59.99, -60.0])
    east_m, north_m = moon.frame.from_lonlat(lon, lat)
    apart_m = np.hypot(east_m - east_m[0], north_m - north_m[0])
    np.testing.assert_allclose(apart_m[1:], away_m(lon, lat)[1:], rtol=1e-4)
    np.testing.assert_allclose(moon.frame.to_lonlat(east_m, north_m), [lon, lat], atol=1e-9)


def test_the_horizon_of_a_smooth_moon_dips_as_on_a_sphere(around):
    north = np.abs((around.azimuth_deg[0] + 180.0) % 360.0 - 180.0) < 60.0
    dip_deg = np.degrees(np.arccos(MOON_M / (MOON_M + EYE_M)))
    np.testing.assert_allclose(around.elevation_deg[0, north], -dip_deg, atol=0.001)
    arc_m = MOON_M * np.radians(dip_deg)
    np.testing.assert_allclose(around.distance_m[0, north], arc_m, rtol=0.03)


def test_a_wall_on_a_moon_is_as_high_as_on_a_sphere(around):
    south = np.abs(around.azimuth_deg[0] - 180.0) < 60.0
    arc = around.distance_m[0, south] / MOON_M
    np.testing.assert_allclose(around.distance_m[0, south], 11_400.0, atol=250.0)
    top_m = MOON_M + WALL_M
    up_deg = np.degrees(np.arctan2(top_m * np.cos(arc) - MOON_M - EYE_M, top_m * np.sin(arc)))
    np.testing.assert_allclose(around.elevation_deg[0, south], up_deg, atol=0.003)


def test_the_sky_view_of_an_array_on_a_moon_is_that_of_the_horizons_there():
    lon, lat = 30.0 + 0.01 * np.arange(8), -60.0 + 0.01 * np.arange(6)
    heights = np.random.default_rng(0).uniform(0.0, 300.0, (6, 8)).astype(np.float32)
    model = xr.DataArray(heights, {"lat": lat, "lon": lon}, ("lat", "lon"))
    model = model.rio.write_crs(CRS["degrees"])
    factors = sky_view_grid(model)
    there = horizon(
        model, lon=lon[3], lat=lat[2], eye_height_m=0.1, step_deg=5.0, summit_within_m=0.0
    )
    assert float(factors[2, 3]) == pytest.approx(float(there.sky_view_factor()), abs=1e-6)


def test_no_sun_of_the_earth_stands_over_a_moon(moon, around):
    with pytest.raises(InputError, match="another world"):
        around.sun_above("2026-12-21")
    photo = PhotoSkyline(np.full(8, 2.0), np.ones(8), 8, 6, 60.0)
    with Viewer(moon) as viewer:
        pose = viewer.pose(lon=LON, lat=LAT, heading_deg=180.0, fov_deg=60.0)
        with pytest.raises(InputError, match="another world"):
            viewer.bodies(pose, photo, datetime(2026, 12, 21, 12, tzinfo=UTC))


@pytest.mark.parametrize("ending", [".zip", ".hor", ".txt", ".sam.csv", ".hrz"])
def test_no_program_for_the_earth_is_given_the_horizon_of_a_moon(around, tmp_path, ending):
    with pytest.raises(InputError, match=r"another world, of 1737 km radius; write \.csv"):
        write_horizons(around, tmp_path / f"moon{ending}")
    assert not list(tmp_path.iterdir())
    write_horizons(around, tmp_path / "moon.csv")


def test_photos_that_fit_nowhere_on_a_moon_have_its_longitudes_too(moon, tmp_path):
    path = tmp_path / "moon.h5"
    build_places(moon, path, 50.0, (LON - 0.002, LAT - 0.001, LON + 0.002, LAT + 0.001))
    bare = PhotoSkyline(np.full(8, np.nan), np.zeros(8), 8, 8, 60.0)
    with Matcher(path, moon, config=MatchConfig(refine=False)) as matcher:
        found = matcher.match_together([bare, bare])
    assert not matcher.crs.equals("EPSG:4326")
    assert [one.crs for one in found.results] == [matcher.crs] * 2


def test_a_pose_on_a_moon_is_seen_with_the_moons_curvature(moon):
    with Viewer(moon) as viewer:
        assert viewer.curvature.radius_m == MOON_M
        pose = viewer.pose(lon=LON, lat=LAT, heading_deg=180.0)
    assert pose.eye_elevation_m == pytest.approx(2.0, abs=0.02)

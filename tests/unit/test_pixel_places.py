"""The place on the terrain in each pixel, against closed forms and a march along every ray."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scenes import candidate_at, field_from, field_of, fractal

from skyline.camera.projection import Projection
from skyline.errors import InputError, OffMapError
from skyline.geodesy.earth import Curvature
from skyline.photo.skyline import PhotoSkyline
from skyline.terrain.viewpoints import at_elevation
from skyline.view.viewer import Viewer, sight_of
from skyline_bench.truth import oracle

FLAT = Curvature(enabled=False)
WIDTH_PX, HEIGHT_PX = 90, 45


CAMERAS = {
    "level": ({}, Projection.PERSPECTIVE),
    "held askew": ({"pitch_deg": 8.0, "roll_deg": -6.0, "fov_deg": 75.0}, Projection.PERSPECTIVE),
    "down, distorted": ({"pitch_deg": -25.0, "roll_deg": 3.0}, Projection.PERSPECTIVE),
    "panorama": ({"pitch_deg": 4.0, "roll_deg": 2.0, "fov_deg": 200.0}, Projection.CYLINDRICAL),
    "around": ({"fov_deg": 360.0}, Projection.EQUIRECTANGULAR),
}
"""Angles and projection of cameras."""


def pose_at(field, east_m, north_m, eye_height_m, name, heading_deg=130.0):
    angles, projection = CAMERAS[name]
    eye_m = float(field.height_at(easting_m=east_m, northing_m=north_m)) + eye_height_m
    pose = candidate_at(east_m, north_m, heading_deg, **angles, eye_elevation_m=eye_m)
    wander = (0.03, -0.02, 0.01, 0.02) if name == "panorama" else ()
    pose = replace(pose, distortion=0.06 if "distorted" in name else 0.0, wander=wander)
    # A small photo of which no skyline is known.
    unknown, size = (np.full(WIDTH_PX, np.nan), np.zeros(WIDTH_PX)), (WIDTH_PX, HEIGHT_PX)
    return pose, PhotoSkyline(*unknown, *size, projection=projection)


def rays_of(pose, skyline):
    row_px, column_px = np.mgrid[:HEIGHT_PX, :WIDTH_PX]
    azimuth_deg, elevation_tan = pose.camera(skyline).directions(column_px, row_px)
    return np.radians(azimuth_deg), elevation_tan


def marched_m(field, pose, curvature, azimuth_rad, elevation_tan, step_m):
    """Return where rays (N,) first are below the surface, to ``step_m``; NaN for sky."""
    reach_m = field.reach_m(easting_m=pose.easting_m, northing_m=pose.northing_m)
    away_m = np.arange(step_m, reach_m, step_m)
    found = np.full(len(azimuth_rad), np.nan)
    for index, (azimuth, tan) in enumerate(zip(azimuth_rad, elevation_tan, strict=True)):
        ground_m = field.height_at(
            easting_m=pose.easting_m + away_m * np.sin(azimuth),
            northing_m=pose.northing_m + away_m * np.cos(azimuth),
        )
        ray_m = pose.eye_elevation_m + tan * away_m + curvature.drop_per_m2 * away_m**2
        below = np.flatnonzero(ground_m >= ray_m)
        if len(below):
            found[index] = away_m[below[0]]
    return found


@pytest.mark.parametrize("name", CAMERAS)
def test_a_plane_is_met_where_it_is(name):
    field = field_from(lambda east, north: 0.1 * east - 0.05 * north, 81, 50.0)
    pose, skyline = pose_at(field, 13.0, -21.0, 40.0, name)
    places = Viewer(field, curvature=FLAT).places(pose, skyline)
    azimuth_rad, elevation_tan = rays_of(pose, skyline)
    rise = 0.1 * np.sin(azimuth_rad) - 0.05 * np.cos(azimuth_rad)
    with np.errstate(divide="ignore"):
        true_m = np.where(elevation_tan < rise, 40.0 / (rise - elevation_tan), np.nan)
    east_m = pose.easting_m + true_m * np.sin(azimuth_rad)
    north_m = pose.northing_m + true_m * np.cos(azimuth_rad)
    inside = (np.abs(east_m) <= 1999.0) & (np.abs(north_m) <= 1999.0)
    outside = ~((np.abs(east_m) <= 2001.0) & (np.abs(north_m) <= 2001.0))
    np.testing.assert_allclose(places.distance_m[inside], true_m[inside], rtol=1e-5)
    assert np.isnan(places.distance_m[outside]).all()
    assert inside.any()
    lon, lat = field.frame.to_lonlat(east_m[inside], north_m[inside])
    np.testing.assert_allclose(places.lon[inside], lon, rtol=0.0, atol=1e-8)
    np.testing.assert_allclose(places.lat[inside], lat, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize("below_m", [0.0, 7.0])
def test_an_eye_on_the_ground_sees_as_from_the_lowest_camera(below_m):
    plane = field_from(lambda east, north: 0.0 * east, 81, 50.0)
    pose, skyline = pose_at(plane, 13.0, -21.0, -below_m, "level")
    places = Viewer(plane, curvature=FLAT).places(pose, skyline)
    _, elevation_tan = rays_of(pose, skyline)
    true_m = np.where(elevation_tan < -1e-3, 0.3 / -np.minimum(elevation_tan, -1e-9), np.nan)
    near = true_m < 1000.0
    np.testing.assert_allclose(places.distance_m[near], true_m[near], rtol=1e-4)
    assert near.sum() > 0.4 * near.size
    assert Viewer(plane, curvature=FLAT).held(pose).eye_elevation_m == pytest.approx(0.3)


@pytest.fixture(scope="module")
def rough():
    heights = 1000.0 + fractal(90, 100, 500.0, seed=4)
    heights[30:36, 50:58] = np.nan
    return field_of(heights, 30.0)


@pytest.mark.parametrize("name", CAMERAS)
def test_rough_terrain_is_met_where_a_march_meets_it(rough, name):
    """Beside edges a ray may see what rays a quarter of a pixel beside it see."""
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, name)
    curvature = Curvature()
    places = Viewer(rough).places(pose, skyline)
    azimuth_rad, elevation_tan = (one[::3, ::3].ravel() for one in rays_of(pose, skyline))
    found_m = places.distance_m[::3, ::3].ravel()
    step_m = 0.5
    true_m = marched_m(rough, pose, curvature, azimuth_rad, elevation_tan, step_m)
    off_m = np.abs(found_m - true_m + 0.5 * step_m)
    is_exact = (off_m <= 0.5 * step_m + 1e-3) | (np.isnan(found_m) & np.isnan(true_m))
    assert is_exact.mean() > 0.96
    column_deg = skyline.projection.column_deg(WIDTH_PX, pose.fov_deg).min()
    beside = np.radians(column_deg) * np.linspace(-0.26, 0.26, 41)
    for index in np.flatnonzero(~is_exact):
        rays = azimuth_rad[index] + beside, np.full(len(beside), elevation_tan[index])
        around_m = marched_m(rough, pose, curvature, *rays, step_m)
        if np.isnan(found_m[index]):
            assert np.isnan(around_m).any()
        else:
            # Between two of these rays the surface changes by its slope times their distance.
            slack_m = step_m + 3.0 * np.radians(column_deg) * found_m[index]
            assert np.nanmin(np.abs(around_m - found_m[index])) < slack_m


@pytest.mark.parametrize("name", CAMERAS)
def test_places_are_seen_in_their_pixels(rough, name):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, name)
    places = Viewer(rough).places(pose, skyline)
    easting_m, northing_m = rough.frame.from_lonlat(places.lon, places.lat)
    east_m, north_m = easting_m - pose.easting_m, northing_m - pose.northing_m
    away_m = np.hypot(east_m, north_m)
    up_m = places.elevation_m - pose.eye_elevation_m - Curvature().drop_m(away_m)
    azimuth_deg = np.degrees(np.arctan2(east_m, north_m))
    column, row = pose.camera(skyline).pixels(azimuth_deg, up_m / away_m)
    seen = np.isfinite(places.distance_m)
    rows, columns = np.nonzero(seen)
    across = np.abs(column[seen] - columns)
    across = np.minimum(across, WIDTH_PX - across) if pose.fov_deg == 360.0 else across
    assert across.max() < 0.01
    assert np.abs(row[seen] - rows).max() < 0.01


@pytest.mark.parametrize("name", CAMERAS)
def test_the_elevation_of_a_place_is_the_terrain_s(rough, name):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, name)
    places = Viewer(rough).places(pose, skyline)
    off_m = np.abs(places.elevation_m - rough.height_at(lon=places.lon, lat=places.lat))
    # Beside an edge what is seen a quarter of a pixel away may stand in.
    assert np.mean(off_m[np.isfinite(places.distance_m)] < 0.01) > 0.96


@pytest.mark.parametrize("name", CAMERAS)
def test_sky_is_above_the_skyline(rough, name):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, name)
    seen = np.isfinite(Viewer(rough).places(pose, skyline).distance_m)
    eye = at_elevation(rough, pose.easting_m, pose.northing_m, pose.eye_elevation_m)
    sight = sight_of(pose, skyline, oracle.skyline(rough, eye, 2048))
    order, columns = np.argsort(sight.column_px), np.arange(WIDTH_PX)
    border = np.interp(columns, sight.column_px[order], sight.row_px[order])
    # Ground past the data's border may be seen, and has no place.
    is_sure = np.interp(columns, sight.column_px[order], sight.is_sure[order]) == 1.0
    below_px = np.arange(HEIGHT_PX)[:, np.newaxis] - border
    near_px = 1.0 + np.abs(np.gradient(border))
    wrong = is_sure & (seen != (below_px > 0.0)) & (np.abs(below_px) > near_px)
    assert is_sure.mean() > 0.3
    if name != "around":  # Its last column is where the sight begins.
        assert wrong.sum() == 0
    assert not wrong[:, 2:-2].any()


def test_coarser_pixels_are_those_of_all_pixels(rough):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, "held askew")
    viewer, reports = Viewer(rough), []
    whole = viewer.places(pose, skyline)
    coarse = viewer.places(pose, skyline, 4, lambda *done: reports.append(done))
    same = np.isclose(whole.distance_m[::4, ::4], coarse.distance_m, rtol=1e-6, equal_nan=True)
    assert same.mean() > 0.96
    assert reports[-1] == (coarse.distance_m.size, coarse.distance_m.size)
    with pytest.raises(InputError):
        viewer.places(pose, skyline, 0)
    with pytest.raises(OffMapError):
        viewer.places(replace(pose, easting_m=9e5), skyline)


def test_places_are_a_dataset_and_tables(rough):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, "level")
    places = Viewer(rough).places(pose, skyline, 2)
    data = places.to_xarray()
    np.testing.assert_array_equal(data.distance_m, places.distance_m)
    assert float(data.sel(row_px=40, column_px=60).lon) == places.lon[20, 30]
    table = places.to_dataframe()
    assert len(table) == np.isfinite(places.distance_m).sum()
    row, column = table["row_px"] // 2, table["column_px"] // 2
    np.testing.assert_array_equal(table["elevation_m"], places.elevation_m[row, column])
    points = places.to_geodataframe()
    assert points.crs == "EPSG:4326"
    np.testing.assert_array_equal(points.geometry.x, places.lon[row, column])


def test_files_of_places_hold_the_arrays_and_the_pose(rough, tmp_path):
    pose, skyline = pose_at(rough, 1400.0, -1300.0, 25.0, "level")
    places = Viewer(rough).places(pose, skyline, 2)
    places.save(tmp_path / "p.npz", pose)
    places.save(tmp_path / "p.tif", pose)
    with np.load(tmp_path / "p.npz") as file:
        held = dict(file)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        raster = rasterio.open(tmp_path / "p.tif")
    with raster:
        bands = dict(zip(raster.descriptions, raster.read(), strict=True))
        assert raster.tags()["pose"] == str(held["pose"])
    for name in ("distance_m", "lon", "lat", "elevation_m"):
        np.testing.assert_array_equal(held[name], getattr(places, name))
        np.testing.assert_array_equal(bands[name], getattr(places, name))
    assert '"heading_deg": 130.0' in str(held["pose"])
    with pytest.raises(InputError):
        places.save(tmp_path / "p.csv", pose)

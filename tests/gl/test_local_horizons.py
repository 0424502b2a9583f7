"""Horizons round places: against the oracle from true north, and what is made of them."""

from datetime import UTC, date, datetime, timedelta

import numpy as np
import pandas as pd
import pytest
import rioxarray
import xarray as xr
from scenes import at_deg, field_from, fractal, write_dem

from skyline import (
    Curvature,
    Frame,
    HeightField,
    InputError,
    OffMapError,
    horizon,
    read_dem,
    stand_on,
)
from skyline_bench.truth import oracle

# On the standard parallel, seven degrees from the middle: so far is the map's north from the true.
POLAR = Frame.from_crs("EPSG:3413")
EAST_M, NORTH_M = 270_000.0, -2_160_000.0


@pytest.fixture(scope="module")
def rough():
    return HeightField(fractal(90, 80, 700.0, seed=3), EAST_M, NORTH_M, 30.0, 30.0, POLAR)


def places_on(field, count):
    most = np.array([[field.rows - 4], [field.cols - 4]])
    row, col = np.random.default_rng(4).uniform(3, most, (2, count))
    return field.frame.to_lonlat(*field.to_map(row, col))


def true_sides(field, eye, grid_deg):
    """Yield of each side: its azimuths' indices, and their elevations, distances and flags."""
    heading = np.round(grid_deg / 90.0).astype(int) % 4
    away = np.radians((grid_deg - 90.0 * heading + 180.0) % 360.0 - 180.0)
    for side in range(4):
        columns = np.flatnonzero(heading == side)
        columns = columns[np.argsort(away[columns])]
        truth = oracle.skyline_at(field, eye, np.tan(away[columns]), Curvature())
        cosine = np.cos(away[columns])
        elevation_deg = np.degrees(np.arctan(truth.v[side] * cosine))
        yield columns, elevation_deg, truth.depth_m[side] / cosine, truth.flags[side]


@pytest.mark.parametrize("step_deg", [0.5, 7.5])
def test_equals_the_oracle_at_azimuths_from_true_north(rough, step_deg):
    lon, lat = places_on(rough, 6)
    found = horizon(rough, lon=lon, lat=lat, eye_height_m=2.0, step_deg=step_deg)
    steps = round(360.0 / step_deg)
    assert found.elevation_deg.shape == (6, steps)
    np.testing.assert_array_equal(found.azimuth_deg[3], np.arange(steps) * step_deg)
    easting, northing = POLAR.from_lonlat(lon, lat)
    turn = POLAR.convergence_deg(easting_m=easting, northing_m=northing)
    assert turn.min() > 6.0
    for index in range(6):
        grid_deg = (found.azimuth_deg[index] - turn[index]) % 360.0
        eye = stand_on(rough, easting_m=easting[index], northing_m=northing[index])
        for columns, true_deg, away_m, flags in true_sides(rough, eye, grid_deg):
            off_deg = found.elevation_deg[index, columns] - true_deg
            assert np.abs(off_deg).max() < 2e-3
            np.testing.assert_array_equal(found.flags[index, columns], flags)
            clear = np.abs(off_deg) < 1e-4
            assert clear.mean() > 0.9
            found_m = found.distance_m[index, columns]
            np.testing.assert_allclose(found_m[clear], away_m[clear], rtol=1e-4)


def test_a_data_array_stands_for_its_file(tmp_path):
    path = write_dem(tmp_path / "dem.tif", fractal(60, 60, 400.0, seed=2))
    lon, lat = places_on(read_dem(path), 2)
    of_file = horizon(path, lon=lon, lat=lat, step_deg=7.5)
    with rioxarray.open_rasterio(path) as array:
        of_array = horizon(array, lon=lon, lat=lat, step_deg=7.5, surface=array)
    np.testing.assert_array_equal(of_array.elevation_deg, of_file.elevation_deg)
    np.testing.assert_array_equal(of_array.surface_deg, of_file.elevation_deg)


def test_the_axes_of_a_square_raster_are_broadcast_by_their_names(rough):
    lon, lat = places_on(rough, 3)
    axes = xr.DataArray(lon, dims="x"), xr.DataArray(lat, dims="y")
    grid = horizon(rough, lon=axes[0], lat=axes[1], step_deg=7.5)
    assert grid.shape == (3, 3)
    np.testing.assert_allclose(grid.lon[1], lon)
    np.testing.assert_allclose(grid.lat[:, 1], lat)
    heights_m = rough.height_at(lon=axes[0], lat=axes[1])
    np.testing.assert_allclose(heights_m[1, 2], rough.height_at(lon=lon[2], lat=lat[1]))


def test_heights_of_eyes_are_broadcast_with_the_places(rough):
    lon, lat = (at.reshape(2, 1) for at in places_on(rough, 2))
    grid = horizon(rough, lon=lon, lat=lat, eye_height_m=[2.0, 5.0], step_deg=7.5)
    assert grid.shape == (2, 2)
    np.testing.assert_allclose(np.diff(grid.eye_elevation_m), 3.0)


def test_the_corner_of_a_map_is_on_it_and_a_metre_aside_is_not(rough):
    west, south, _, _ = rough.bounds_m
    lon, lat = rough.frame.to_lonlat(west - 1e-7, south)
    corner = horizon(rough, lon=lon, lat=lat, step_deg=7.5, summit_within_m=0.0)
    assert corner.eye_elevation_m == pytest.approx(rough.heights_m[-1, 0] + 2.0)
    lon, lat = rough.frame.to_lonlat(west - 1.0, south)
    with pytest.raises(OffMapError):
        horizon(rough, lon=lon, lat=lat, step_deg=7.5)


def test_eastings_are_said_to_be_no_degrees(rough):
    with pytest.raises(OffMapError, match="give degrees"):
        horizon(rough, lon=EAST_M + 100.0, lat=NORTH_M - 100.0)


def test_an_id_that_a_table_lacks_is_empty(rough):
    lon, lat = places_on(rough, 3)
    ids = pd.Series(["A", None, np.nan], dtype=object)
    assert horizon(rough, lon=lon, lat=lat, step_deg=45.0, ids=ids).id.tolist() == ["A", "", ""]


def test_a_place_without_a_longitude_is_named(rough):
    lon, lat = places_on(rough, 3)
    lon[1] = np.nan
    with pytest.raises(InputError, match=r"lon of viewpoint 1 \(1 such\) is masked or not a"):
        horizon(rough, lon=lon, lat=lat)


def test_a_horizon_has_the_shape_of_its_longitudes_and_latitudes(rough):
    lon, lat = (at.reshape(2, 3) for at in places_on(rough, 6))
    grid = horizon(rough, lon=lon, lat=lat, step_deg=7.5, ids=[list("abc"), list("def")])
    assert (grid.shape, grid.elevation_deg.shape) == ((2, 3), (2, 3, 48))
    one = horizon(rough, lon=float(lon[1, 2]), lat=float(lat[1, 2]), step_deg=7.5)
    assert (one.shape, one.sky_view_factor().shape) == ((), ())
    for same in (grid[1, 2], grid[1][-1], grid.sel("f"), grid.sel(lon=lon[1, 2], lat=lat[1, 2])):
        np.testing.assert_array_equal(same.elevation_deg, one.elevation_deg)
    assert [str(place.id) for row in grid for place in row] == list("abcdef")
    assert repr(grid) == "LocalHorizons(2 x 3 places, 48 azimuths, 7.5 degrees apart)"


def test_ids_of_other_places_are_refused(rough):
    lon, lat = places_on(rough, 2)
    with pytest.raises(InputError, match=r"shape \(2,\), and the ids \(1,\); give an id for each"):
        horizon(rough, lon=lon, lat=lat, ids=["a"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lon": [], "lat": []}, "no place was given"),
        ({"lon": [9.8, 9.9], "lat": [46.7, 46.7, 46.8]}, "as many latitudes as longitudes"),
        ({"lon": np.ma.masked_array([9.8], [True]), "lat": [46.7]}, "is masked"),
        ({"lon": 9.8, "lat": 46.7, "step_deg": "10"}, "step is '10' degrees; expected a divisor"),
    ],
)
def test_places_that_cannot_be_are_refused_in_one_line(rough, given, message):
    with pytest.raises(InputError, match=f"^.*{message}.*$"):
        horizon(rough, **given)


def test_the_sun_rises_behind_a_ridge_when_another_ephemeris_says_so():
    pvlib = pytest.importorskip("pvlib")
    ridge = field_from(
        lambda east, north: 1500.0 + 900.0 * np.exp(-(((np.abs(east) - 4000.0) / 700.0) ** 2))
        + 0.05 * north, 401, 30.0,
    )  # fmt: skip
    lon, lat = (float(at) for at in ridge.frame.to_lonlat(0.0, 0.0))
    found = horizon(ridge, lon=lon, lat=lat)
    for day in (date(2026, 3, 20), date(2026, 6, 21), date(2026, 12, 21)):
        ((rise, set_),) = found.sun_above(day)
        noon = datetime(day.year, day.month, day.day, 12, tzinfo=UTC) - timedelta(hours=lon / 15.0)
        times = pd.date_range(noon - timedelta(hours=12), noon + timedelta(hours=12), freq="5s")
        sun = pvlib.solarposition.get_solarposition(times, lat, lon, altitude=1500.0)
        line = np.interp(sun.azimuth, found.azimuth_deg, found.elevation_deg, period=360.0)
        shines = times[sun.apparent_elevation + 0.2666 > line]
        assert shines[0] > noon - timedelta(hours=7)
        assert abs((rise - shines[0]).total_seconds()) < 60.0
        assert abs((set_ - shines[-1]).total_seconds()) < 60.0
        # The ridge, and not the sea's horizon, hides the sun.
        flat = times[sun.apparent_elevation > 0.0]
        assert (rise - flat[0]).total_seconds() > 3000.0


def test_the_sun_of_a_polar_summer_never_sets_and_of_a_polar_winter_never_rises():
    plain = field_from(lambda east, north: 0.0 * east * north, 101, 30.0)
    far_north = HeightField(plain.heights_m, 0.0, 0.0, 30.0, 30.0, Frame.local(lon=20.0, lat=75.0))
    found = horizon(far_north, **at_deg(far_north.frame.to_lonlat(1500.0, -1500.0)))
    ((begin, end),) = found.sun_above(date(2026, 6, 21))
    assert end - begin == timedelta(days=1)
    for day in (date(2026, 12, 21), "2026-12-21", np.datetime64("2026-12-21")):
        assert found.sun_above(day) == []
    for day in (date(1, 1, 1), "1582-12-31", date.max, np.datetime64("NaT"), "21.12.", None):
        with pytest.raises(InputError, match="in the years 1583 to 9998"):
            found.sun_above(day)


MOUNTAIN = field_from(lambda east, north: 3000.0 - 0.8 * np.hypot(east, north), 101, 90.0)
BESIDE_DEG = MOUNTAIN.frame.to_lonlat(-38.0, 30.0)


def test_a_summit_does_not_stand_before_who_stands_on_it():
    """True coordinates lie up to half a sample beside the model's summit."""
    slope = horizon(MOUNTAIN, **at_deg(BESIDE_DEG), summit_within_m=0.0)
    towards = 2 * 128
    assert slope.elevation_deg[towards] > 30.0
    assert slope.distance_m[towards] < 60.0
    for within_m in (None, 100.0):
        found = horizon(MOUNTAIN, **at_deg(BESIDE_DEG), summit_within_m=within_m)
        assert found.eye_elevation_m == pytest.approx(3002.0, abs=1e-3)
        assert found.elevation_deg.max() < 0.0


def test_a_horizon_of_a_file_is_drawn_and_shown_in_a_notebook(tmp_path):
    path = write_dem(tmp_path / "dem.tif", fractal(60, 60, 400.0, seed=2))
    terrain = read_dem(path)
    assert read_dem(terrain) is terrain
    lon, lat = places_on(terrain, 7)
    found = horizon(path, lon=lon, lat=lat, step_deg=7.5)
    np.testing.assert_array_equal(
        found.elevation_deg, horizon(terrain, lon=lon, lat=lat, step_deg=7.5).elevation_deg
    )
    axes = found[3].plot()
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_ydata(), found.elevation_deg[3])
    html = found._repr_html_()
    assert html.count("<svg ") == 5
    assert "and 2 more places" in html
    assert repr(found) == "LocalHorizons(7 places, 48 azimuths, 7.5 degrees apart)"

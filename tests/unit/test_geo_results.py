"""Candidates as a GeoDataFrame, and rows of a store as a Dataset, say what they are made from."""

from dataclasses import fields

import geopandas
import numpy as np
import pyogrio
import pytest
from pyproj import CRS
from scenes import candidate_at
from store_rows import PLACES_HEADER, VIEWS_HEADER, numbered_places, numbered_views, write_rows

import skyline
from skyline import Frame, InputError, MatchResult, PhotoSkyline, Pose, open_store
from skyline.report.place_files import write_geopackage

UTM = Frame(VIEWS_HEADER.frame_wkt)
BEST = candidate_at(
    750_000.0, 5_180_000.0, 300.0, confidence=0.9, confidence_1km=0.95, frame=UTM,
    covariance_m2=((400.0, 100.0), (100.0, 900.0)),
)  # fmt: skip
OTHER = candidate_at(751_000.0, 5_181_000.0, 20.0, frame=UTM, rank=2)
SKYLINE = PhotoSkyline(np.full(8, 3.0), np.ones(8), 8, 8, 60.0)


def test_a_result_is_a_table_of_points_in_degrees():
    table = MatchResult(SKYLINE, (BEST, OTHER), 0.1).to_geodataframe()
    assert table.crs == "EPSG:4326"
    assert list(table["rank"]) == [1, 2]
    assert list(table["is_answer"]) == [True, False]
    whole = {field.name for field in fields(Pose)} - {"covariance_m2", "covariance"}
    for name in whole:
        value = getattr(BEST, name)
        assert table[name].isna()[0] if value is None else table[name][0] == value, name
    assert table["confidence"].isna().tolist() == [False, True]
    spread = ["easting_variance_m2", "northing_variance_m2", "easting_northing_covariance_m2"]
    assert table.loc[0, spread].tolist() == [400.0, 900.0, 100.0]
    # The points, brought back to the frame by other means, are where the candidates are.
    back = table.to_crs("EPSG:32632").geometry
    np.testing.assert_allclose(back.x, table["easting_m"], atol=1e-4)
    np.testing.assert_allclose(back.y, table["northing_m"], atol=1e-4)


def test_points_of_another_world_are_not_on_the_earth():
    mars = CRS.from_user_input("+proj=longlat +R=3389500")
    assert MatchResult(SKYLINE, (BEST,), 0.1, crs=mars).to_geodataframe().crs == mars


def test_results_of_any_kind_are_a_table():
    refused = MatchResult(SKYLINE, (OTHER,), 0.1, "too unsure", name="b.jpg")
    nothing = MatchResult(SKYLINE, (), 0.1, "no place fits", name="c.jpg")
    found = MatchResult(SKYLINE, (BEST, OTHER), 0.1, name="a.jpg", id="A")
    table = skyline.to_dataframe([found, refused, nothing])
    assert table["photo"].tolist() == ["a.jpg", "b.jpg", "c.jpg"]
    assert table["answered"].tolist() == [1, 0, 0]
    assert table["lon"].tolist()[:2] == [BEST.lon, OTHER.lon]
    assert table["lon"].isna()[2]
    assert table["id"][0] == "A"
    assert found.to_dataframe()["lat"].tolist() == [BEST.lat, OTHER.lat]
    assert nothing.to_dataframe()["lat"].tolist() == []
    held = skyline.Orientation(SKYLINE, BEST, heading_sd_deg=0.1, confidence=0.9, name="d.jpg")
    row = held.to_dataframe().iloc[0]
    assert (row["heading_deg"], row["trusted"]) == (BEST.heading_deg, 1)
    assert held.to_dict()["lon"] == BEST.lon


@pytest.fixture
def place_store(tmp_path):
    with open_store(write_rows(tmp_path / "places.h5", 0, 50, PLACES_HEADER)) as store:
        yield store


@pytest.fixture
def view_store(tmp_path):
    with open_store(write_rows(tmp_path / "views.h5", 0, 12, VIEWS_HEADER)) as store:
        yield store


def test_places_are_a_dataset_by_azimuth(place_store):
    data, places = place_store.to_xarray(), numbered_places(0, 50)
    assert data.elevation_deg.dims == ("place", "grid_azimuth_deg")
    tan = np.tan(np.radians(data.elevation_deg))
    np.testing.assert_allclose(tan, places.elevation_tan(), atol=1e-5)
    np.testing.assert_array_equal(data.distance_m[:, 1::3], places.distance_m())
    np.testing.assert_array_equal(data.grid_azimuth_deg, np.arange(360) + 0.5)
    assert not data.attrs
    some = place_store.to_xarray([7, 3])
    assert some.identical(data.isel(place=[7, 3]))
    assert len(place_store.to_xarray(slice(0)).place) == 0


def test_views_are_a_dataset_of_the_same_terms(view_store):
    data, (views, _) = view_store.to_xarray(slice(2, 9)), numbered_views(2, 9)
    assert list(data["view"]) == list(range(2, 9))
    np.testing.assert_allclose(data.elevation_deg, views.elevation_deg(), rtol=1e-5)
    along = np.linalg.norm(views.skyline_points_m()[..., [0, 2]], axis=-1)
    np.testing.assert_allclose(data.distance_m, along, rtol=1e-5)
    np.testing.assert_array_equal(data.flags, views.flags)
    np.testing.assert_array_equal(data.grid_azimuth_deg, views.grid_azimuth_deg())


@pytest.mark.parametrize("kind", ["place_store", "view_store"])
def test_azimuths_are_from_true_north_at_each_place(kind, request):
    data = request.getfixturevalue(kind).to_xarray()
    lon, lat = UTM.to_lonlat(data.easting_m, data.northing_m)
    np.testing.assert_array_equal(data.lon, lon)
    np.testing.assert_array_equal(data.lat, lat)
    assert data.azimuth_deg.ndim == 2
    turn = (data.azimuth_deg - data.grid_azimuth_deg - data.convergence_deg + 180.0) % 360.0
    np.testing.assert_allclose(turn, 180.0, atol=1e-9)
    # Geographic north of a place lies at azimuth 0, whatever the grid's north is.
    north = UTM.from_lonlat(lon, lat + 1e-4)
    grid = np.degrees(np.arctan2(north[0] - data.easting_m, north[1] - data.northing_m))
    np.testing.assert_allclose(grid + data.convergence_deg, 0.0, atol=1e-3)
    assert Frame.from_crs(data.spatial_ref.attrs["crs_wkt"]).crs == UTM.crs


def test_a_geopackage_is_opened_by_gdal(place_store, tmp_path):
    path = tmp_path / "places.gpkg"
    path.write_bytes(b"what was there")
    assert write_geopackage(place_store, path) == 50
    assert [file.name for file in tmp_path.glob("*.gpkg*")] == ["places.gpkg"]
    about = pyogrio.read_info(path, layer="places")
    assert (about["driver"], about["geometry_type"], about["features"]) == ("GPKG", "Point", 50)
    read = geopandas.read_file(path, layer="places")
    assert read.crs == UTM.crs
    columns = read.columns.drop("geometry")
    table, places = place_store.to_geodataframe(), numbered_places(0, 50)
    assert read[columns].equals(table[columns])
    np.testing.assert_array_equal(read.geometry.x, places.easting_m)
    np.testing.assert_array_equal(read.geometry.y, places.northing_m)
    assert (table["spacing_m"] == 50.0).all()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("place_store", "places.shp"),
        ("place_store", "places.h5/places.gpkg"),
        ("view_store", "views.gpkg"),
    ],
)
def test_a_geopackage_that_cannot_be_is_refused(tmp_path, request, kind, name):
    with pytest.raises(InputError):
        write_geopackage(request.getfixturevalue(kind), tmp_path / name)
    assert not (tmp_path / name).exists()

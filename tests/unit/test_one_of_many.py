"""Of several places one is chosen by name, or none is taken."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from font_scenes import UNDRAWN
from matplotlib.figure import Figure
from pyproj import CRS
from scenes import field_from

from skyline import InputError, LocalHorizons, Orienter, Viewer, save_panorama

AZIMUTH_DEG = np.arange(8) * 45.0


def horizons_of(*heights_deg, names=()):
    """Return horizons of places on the equator, each of one height all the way round."""
    count = len(heights_deg)
    shape = count, len(AZIMUTH_DEG)
    return LocalHorizons(
        lon=np.arange(count) * 1.0,
        lat=np.zeros(count),
        eye_elevation_m=np.zeros(count),
        azimuth_deg=np.broadcast_to(AZIMUTH_DEG, shape),
        elevation_deg=np.repeat(np.array(heights_deg, np.float32)[:, np.newaxis], 8, axis=1),
        distance_m=np.full(shape, 1000.0, np.float32),
        flags=np.zeros(shape, np.uint8),
        surface_deg=np.full(shape, np.nan, np.float32),
        id=np.array(names or [""] * count, dtype=np.str_),
    )


def test_none_of_several_suns_is_taken_unless_its_place_is_chosen():
    three = horizons_of(1.0, 2.0, 3.0)
    with pytest.raises(InputError):
        three.sun_above("2026-06-21")
    assert three[1].sun_above("2026-06-21") == three[1:2].sun_above("2026-06-21")


def test_places_are_taken_by_number_as_from_an_array():
    three = horizons_of(1.0, 2.0, 3.0)
    assert len(three) == 3
    assert [float(one.elevation_deg[0]) for one in three] == [1.0, 2.0, 3.0]
    assert three[-1].lon == 2.0
    assert three[1:].lon.tolist() == three[np.array([False, True, True])].lon.tolist() == [1.0, 2.0]
    with pytest.raises(IndexError):
        three[3]
    with pytest.raises(TypeError):
        len(three[0])


def test_places_are_taken_by_id_or_by_the_nearest_position():
    three = horizons_of(1.0, 2.0, 3.0, names=["A", "B", "B"])
    assert three.sel("A").elevation_deg[0] == 1.0
    assert three.sel(lon=1.4, lat=1.0).elevation_deg[0] == 2.0
    for call in ({"place_id": "B"}, {"place_id": "C"}, {"place_id": "A", "lon": 1.0}, {}):
        with pytest.raises(InputError):
            three.sel(**call)


@pytest.mark.parametrize(
    ("lon", "lat"), [(np.nan, 0.0), (500_000.0, 5_200_000.0), ("1", "0"), ([1.0, 2.0], [0.0, 0.0])]
)
def test_no_place_is_nearest_to_what_is_no_position_in_degrees(lon, lat):
    with pytest.raises(InputError):
        horizons_of(1.0, 2.0).sel(lon=lon, lat=lat)


def test_no_sun_shines_on_another_world():
    on_the_moon = replace(horizons_of(1.0), crs=CRS.from_user_input("+proj=longlat +R=1737400"))
    assert on_the_moon.to_geodataframe().crs == on_the_moon.crs
    for call in (lambda: on_the_moon.sun_above("2026-06-21"), on_the_moon[0].sky):
        with pytest.raises(InputError, match="another world"):
            call()


def test_a_series_is_of_one_place_or_of_all_by_place():
    three = horizons_of(1.0, 2.0, 3.0)
    expected = pd.Series(np.full(8, 3.0), pd.Index(AZIMUTH_DEG))
    for series in (three[2].to_series(), horizons_of(3.0).to_series()):
        pd.testing.assert_series_equal(series, expected, check_names=False)
    columns = three.to_series().unstack("place")
    assert columns.loc[45.0].tolist() == [1.0, 2.0, 3.0]
    named = horizons_of(1.0, 2.0, names=["A", "B"]).to_series()
    assert named["B", 90.0] == 2.0


def test_a_table_has_a_row_for_each_place_and_azimuth():
    table = horizons_of(1.0, 2.0, names=["A", "B"]).to_dataframe()
    assert list(table) == ["id", "lon", "lat", "azimuth_deg", "elevation_deg", "distance_m"]
    assert table.loc[9].tolist() == ["B", 1.0, 0.0, 45.0, 2.0, 1000.0]
    assert len(table) == 16


def test_a_table_of_points_has_a_row_for_each_place():
    table = horizons_of(0.0, 60.0).to_geodataframe()
    assert table.crs == "EPSG:4326"
    assert table.geometry.x.tolist() == [0.0, 1.0]
    assert table["sky_view_factor"].tolist() == pytest.approx([1.0, 0.25])


@pytest.mark.parametrize(
    ("shape", "dims"), [((), ()), ((6,), ("point",)), ((2, 3), ("y", "x"))], ids=str
)
def test_a_dataset_has_the_dimensions_of_the_places(shape, dims):
    places = horizons_of(*range(6 if shape else 1)).reshape(*shape)
    data = places.to_xarray()
    assert data.elevation_deg.dims == (*dims, "azimuth_deg")
    assert data.sky_view_factor.dims == data.lon.dims == dims
    np.testing.assert_array_equal(data.sel(azimuth_deg=90.0).elevation_deg, places.lon)


def test_a_plot_has_a_line_for_each_place():
    (line,) = horizons_of(2.0).plot().lines
    np.testing.assert_array_equal(line.get_ydata(), np.full(8, 2.0))
    axes = horizons_of(1.0, 2.0, names=["$A_{$", "B"]).plot()
    assert [one.get_ydata()[0] for one in axes.lines] == [1.0, 2.0]
    axes.figure.canvas.draw()
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["$A_{$", "B"]


def test_the_sun_is_seen_longest_where_the_horizon_is_lowest():
    ((_, low),) = horizons_of(0.0).sun_above("2026-06-21")[:1]
    ((_, high),) = horizons_of(1.0, 2.0, 3.0)[2].sun_above("2026-06-21")[:1]
    assert low > high


def test_a_plot_has_its_place_s_name_where_a_font_draws_it(install_font, caplog):
    def title(name):
        axes = Figure().subplots()
        found = horizons_of(1.0, names=[name])
        assert found.plot(ax=axes) is axes
        axes.figure.canvas.draw()  # A missing letter, or bad mathematics, would be an error.
        return axes.get_title()

    place = "lon 0.00000, lat 0.00000, eye 0 m"
    assert title("$A_{$") == f"$A_{{$: {place}"
    assert title(UNDRAWN) == place
    assert len(caplog.records) == 1
    install_font("Tiny", UNDRAWN)
    assert title(UNDRAWN) == f"{UNDRAWN}: {place}"


def test_what_has_one_place_refuses_several(tmp_path):
    field = field_from(lambda east, north: 0.0 * east * north, 101, 30.0)
    lon, lat = field.frame.to_lonlat([0.0, 300.0], [0.0, 300.0])
    for call in (
        lambda: Orienter(field, lon=lon, lat=lat),
        lambda: Viewer(field).pose(lon=lon, lat=lat, heading_deg=0.0),
        lambda: save_panorama(field, tmp_path / "a.png", lon=lon, lat=lat),
    ):
        with pytest.raises(InputError):
            call()

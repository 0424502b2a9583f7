"""Of several places one is chosen by name, or none is taken."""

import numpy as np
import pandas as pd
import pytest
from font_scenes import UNDRAWN
from matplotlib.figure import Figure
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


@pytest.mark.parametrize("method", ["to_series", "plot", "sun_above"])
def test_none_of_several_places_is_taken_unless_it_is_chosen(method):
    call = getattr(horizons_of(1.0, 2.0, 3.0), method)
    day = ("2026-06-21",) if method == "sun_above" else ()
    with pytest.raises(InputError):
        call(*day)
    with pytest.raises(InputError):
        call(*day, 3)


def test_a_series_is_of_the_place_that_is_chosen_or_the_only_one():
    expected = pd.Series(np.full(8, 3.0), pd.Index(AZIMUTH_DEG))
    three = horizons_of(1.0, 2.0, 3.0)
    for series in (three.to_series(2), three.to_series(-1), horizons_of(3.0).to_series()):
        pd.testing.assert_series_equal(series, expected, check_names=False)


def test_a_plot_is_of_the_place_that_is_chosen():
    (line,) = horizons_of(1.0, 2.0, 3.0).plot(1).lines
    np.testing.assert_array_equal(line.get_ydata(), np.full(8, 2.0))


def test_the_sun_is_seen_longest_where_the_horizon_is_lowest():
    ((_, low),) = horizons_of(0.0).sun_above("2026-06-21")[:1]
    ((_, high),) = horizons_of(1.0, 2.0, 3.0).sun_above("2026-06-21", 2)[:1]
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

"""Positions of sun and moon, and where to stand for them to stand over a summit."""

from datetime import UTC, date, datetime, timedelta, timezone

import numpy as np
import pytest
from scenes import field_from

from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.sky.alignments import standpoints
from skyline.sky.sun import Body, Sky, time_of

pytest.importorskip("ephem")

# Azimuths and true elevations from astropy 8.0 (ERFA; iers.conf.auto_download off).
ASTROPY = [
    (datetime(2026, 12, 21, 11, 20), 9.85, 46.75, Body.SUN, 180.328, 19.810),
    (datetime(2026, 12, 21, 11, 20), 9.85, 46.75, Body.MOON, 37.355, -11.764),
    (datetime(1900, 6, 1, 15, 0), -118.3, 36.6, Body.SUN, 81.201, 26.438),
    (datetime(2040, 3, 20, 8, 0), 86.9, 27.9, Body.SUN, 225.125, 53.278),
    (datetime(2040, 3, 20, 8, 0), 86.9, 27.9, Body.MOON, 78.268, 36.024),
]


@pytest.mark.parametrize(("at", "lon", "lat", "body", "azimuth_deg", "elevation_deg"), ASTROPY)
def test_sun_and_moon_stand_where_another_ephemeris_says(
    at, lon, lat, body, azimuth_deg, elevation_deg
):
    seen = Sky(lon, lat, 0.0).look(body, at)
    assert seen.azimuth_deg == pytest.approx(azimuth_deg, abs=0.01)
    # Refraction raises a body by at most 1 / tan(elevation) arc minutes, about.
    raised_deg = max(0.0, 1.0 / 60.0 / np.tan(np.radians(elevation_deg)))
    assert elevation_deg - 0.01 < seen.elevation_deg < elevation_deg + raised_deg + 0.01
    assert 0.24 < seen.radius_deg < 0.29


def test_a_time_is_read_in_its_zone():
    noon = datetime(2026, 12, 21, 12, tzinfo=UTC)
    for given in ("2026-12-21T12:00Z", "2026-12-21 14:00+02:00", datetime(2026, 12, 21, 12)):
        assert time_of(given) == noon
    assert time_of(noon.astimezone(timezone(timedelta(hours=-8)))) == noon
    for given in ("2026-12-21T12:00", "2026-12-21", "noon", "0001-01-01T00:00Z", None):
        with pytest.raises(InputError, match="expected a day and a time with its zone"):
            time_of(given)


@pytest.mark.parametrize("at", [datetime(2026, 12, 21, 12, tzinfo=UTC), "2026-12-21T12:00Z"])
def test_a_body_stands_in_one_place_whatever_the_zone_of_the_time(at):
    sky = Sky(9.85, 46.75, 0.0)
    in_davos = datetime(2026, 12, 21, 13, tzinfo=timezone(timedelta(hours=1)))
    # The sun moves by 14 degrees of azimuth in an hour, and this is one moment.
    assert sky.look(Body.SUN, in_davos) == sky.look(Body.SUN, at)


# A mountain 1,000 m above a plain, and steeper than any shadow here.
SPIRE = field_from(
    lambda east, north: 1000.0 + np.maximum(0.0, 1000.0 - 10.0 * np.hypot(east, north)), 401, 30.0
)
FLAT = Curvature(enabled=False)


def standpoints_at(east_m, north_m, radius_m, body=Body.SUN, day=date(2026, 3, 20)):
    summit_deg, middle_deg = (
        tuple(map(float, SPIRE.frame.to_lonlat(*at))) for at in ((0.0, 0.0), (east_m, north_m))
    )
    within = *middle_deg, radius_m / 1000.0
    return standpoints(SPIRE, summit_deg, day, body, within, eye_height_m=2.0, curvature=FLAT)


@pytest.mark.parametrize("body", Body)
def test_one_stands_where_the_summits_shadow_ends(body):
    found = standpoints_at(0.0, 0.0, 2000.0, body)
    assert len(found) > 60
    for one in found[:: len(found) // 10]:
        # 998 m above the eye.
        away_m = 998.0 / np.tan(np.radians(one.elevation_deg))
        assert one.distance_m == pytest.approx(away_m, abs=0.1)
        east_m, north_m = SPIRE.frame.from_lonlat(one.lon, one.lat)
        convergence_deg = SPIRE.frame.convergence_deg(easting_m=east_m, northing_m=north_m)
        back_rad = np.radians(one.azimuth_deg - convergence_deg)
        np.testing.assert_allclose(
            [east_m, north_m], [-away_m * np.sin(back_rad), -away_m * np.cos(back_rad)], atol=0.2
        )
        seen = Sky(one.lon, one.lat, 1002.0).look(body, one.time)
        assert one.azimuth_deg == pytest.approx(seen.azimuth_deg, abs=1e-3)


def test_only_places_in_the_area_are_given():
    found = standpoints_at(0.0, 1200.0, 500.0)
    assert found
    for one in found:
        at = SPIRE.frame.from_lonlat(one.lon, one.lat)
        assert np.hypot(at[0], at[1] - 1200.0) <= 500.0
    assert standpoints_at(0.0, -2000.0, 500.0) == []


def test_a_summit_off_the_map_is_refused():
    with pytest.raises(InputError, match="off the elevation model"):
        standpoints(
            SPIRE, (50.0, 10.0), date(2026, 3, 20), Body.SUN, (0.0, 0.0, 0.1),
            eye_height_m=2.0, curvature=FLAT,
        )  # fmt: skip

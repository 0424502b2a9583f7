"""The sun above a horizon: when it rises and sets behind mountains.

Azimuths are degrees from true north. The sun's position is PyEphem's (extra ``sun``).
"""

from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, date, datetime, time, timedelta

import numpy as np

from skyline.arrays import Float64Array, FloatArray
from skyline.errors import InputError, library

_FIRST_YEAR = 1583
"""PyEphem counts days of earlier years in the Julian calendar."""
_LAST_YEAR = 9998
"""Python's dates end a year later, and a day of UTC may end in the next year."""
_STEP = timedelta(minutes=1)
"""Step at which the day is searched: a shorter interval of sun may be missed."""
_RESOLUTION = timedelta(seconds=0.1)
"""Accuracy of the times at which the sun appears and disappears."""
_DISC = np.linspace(-1.0, 1.0, 9)
"""Positions across the sun's disc, in radii."""

Interval = tuple[datetime, datetime]
"""Beginning and end, in UTC."""


def day_of(given: date | str) -> date:
    """Return a date, given or in a text such as 2026-12-21.

    Raises `InputError` for anything else, and for years before 1583 or after 9998.
    """
    with suppress(ValueError):
        day = given if isinstance(given, date) else date.fromisoformat(str(given))
        if _FIRST_YEAR <= day.year <= _LAST_YEAR:
            return day
    raise InputError(
        f"the day is `{given}`; expected a day such as 2026-12-21, in the years "
        f"{_FIRST_YEAR} to {_LAST_YEAR}"
    )


def sun_above(
    day: date,
    *,
    lon: float,
    lat: float,
    eye_elevation_m: float,
    azimuth_deg: Float64Array,
    elevation_deg: FloatArray,
) -> list[Interval]:
    """Return when part of the sun's disc is above a horizon.

    The day is the 24 hours around noon of the mean sun at the eye. The standard atmosphere at the
    eye's elevation refracts the light. An interval shorter than a minute may be missed. Times are
    in UTC, to a tenth of a second.

    Parameters
    ----------
    day : date
    lon, lat : float
        The eye, degrees (WGS 84).
    eye_elevation_m : float
        Metres above sea level.
    azimuth_deg, elevation_deg : (A,) array
        The horizon: azimuths from true north and their elevation angles.

    Raises
    ------
    InputError
        PyEphem is not installed, or the horizon is unknown at some azimuth.
    """
    unknown = ~np.isfinite(elevation_deg)
    if unknown.any():
        raise InputError(
            f"the horizon is unknown at {unknown.sum()} of {len(elevation_deg)} azimuths; choose a "
            "place farther from the border of the DEM"
        )
    horizon_deg = elevation_deg.astype(np.float64)
    sun = _sun(lon, lat, eye_elevation_m)

    def above_deg(at: datetime) -> float:
        """Return the height of the disc's highest visible point above the horizon."""
        sun_azimuth_deg, sun_elevation_deg, radius_deg = sun(at)
        aside_deg = radius_deg * _DISC / np.cos(np.radians(sun_elevation_deg))
        edge_deg = sun_elevation_deg + radius_deg * np.sqrt(1.0 - _DISC**2)
        line_deg = np.interp(sun_azimuth_deg + aside_deg, azimuth_deg, horizon_deg, period=360.0)
        return float((edge_deg - line_deg).max())

    begin = datetime.combine(day, time(12), UTC) - timedelta(hours=12.0 + lon / 15.0)
    times = [begin + step * _STEP for step in range(timedelta(days=1) // _STEP + 1)]
    shines = np.array([above_deg(at) > 0.0 for at in times])
    changes = [
        _crossing(above_deg, times[index], times[index + 1])
        for index in np.flatnonzero(shines[1:] != shines[:-1])
    ]
    ends = [*times[:1] * bool(shines[0]), *changes, *times[-1:] * bool(shines[-1])]
    return list(zip(ends[::2], ends[1::2], strict=True))


def _crossing(above_deg: Callable[[datetime], float], low: datetime, high: datetime) -> datetime:
    """Return the time at which a function changes sign, by bisection."""
    before = above_deg(low) > 0.0
    while high - low > _RESOLUTION:
        middle = low + (high - low) / 2
        if (above_deg(middle) > 0.0) == before:
            low = middle
        else:
            high = middle
    return high


def _sun(lon: float, lat: float, elevation_m: float) -> Callable[[datetime], Float64Array]:
    """Return a function of time: the sun's azimuth, elevation and radius.

    They are in degrees; the elevation is refracted.
    """
    ephem = library("ephem", "the sun's position")
    observer = ephem.Observer()
    observer.lon = np.radians(lon)
    observer.lat = np.radians(lat)
    observer.elevation = elevation_m
    # The standard atmosphere: 15 degrees at sea level, 6.5 degrees less a kilometre.
    observer.temp = 15.0 - 0.0065 * elevation_m
    observer.compute_pressure()
    body = ephem.Sun()

    def position_deg(at: datetime) -> Float64Array:
        observer.date = at.replace(tzinfo=None)
        body.compute(observer)
        return np.degrees([body.az, body.alt, body.radius])

    return position_deg

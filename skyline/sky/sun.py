"""The sun and moon: where they stand, and when above a horizon.

Azimuths are degrees from true north. The positions are PyEphem's (extra ``sun``), which needs no
files of data: the theories VSOP87 and ELP 2000. Astropy's positions are at most 0.005 degrees off
theirs from 1850 to 2026. After 2026 the Earth's rotation is a forecast: the moon may be 0.03
degrees off in 2100.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from enum import StrEnum
from typing import Any

import numpy as np
from pyproj import CRS

from skyline.arrays import Float64Array, FloatArray
from skyline.errors import InputError, library
from skyline.geodesy.crs import is_of_earth, other_world_in_words

_FIRST_YEAR = 1583
"""PyEphem counts days of earlier years in the Julian calendar."""
_LAST_YEAR = 9998
"""Python's dates end a year later, and a day of UTC may end in the next year."""
_STEP = timedelta(minutes=1)
"""Step at which the day is searched: a shorter interval of light may be missed."""
_RESOLUTION = timedelta(seconds=0.1)
"""Accuracy of the times at which a body appears and disappears."""
_DISC = np.linspace(-1.0, 1.0, 9)
"""Positions across a body's disc, in radii."""

Interval = tuple[datetime, datetime]
"""Beginning and end, in UTC."""


class Body(StrEnum):
    """The sun or the moon."""

    SUN = "sun"
    MOON = "moon"


def check_is_earth(crs: CRS) -> None:
    """Raise `InputError` for a DEM of another world than the Earth."""
    if not is_of_earth(crs):
        raise InputError(
            f"the DEM is of {other_world_in_words(crs)}, and sun and moon are computed for the "
            "Earth; give a DEM of the Earth"
        )


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


def time_of(given: datetime | str) -> datetime:
    """Return a time in UTC, given or written like 2026-12-21T15:04+01:00.

    A `datetime` without a zone is in UTC. Raises `InputError` for anything else, such as a text
    without a zone, and for years before 1583 or after 9998.
    """
    with suppress(ValueError, OverflowError):
        at = given if isinstance(given, datetime) else datetime.fromisoformat(str(given))
        has_hour = isinstance(given, datetime) or "T" in str(given) or " " in str(given).strip()
        has_zone = at.tzinfo is not None or isinstance(given, datetime)
        at = at.astimezone(UTC) if at.tzinfo else at.replace(tzinfo=UTC)
        if has_hour and has_zone and _FIRST_YEAR <= at.year <= _LAST_YEAR:
            return at
    raise InputError(
        f"the time is `{given}`; expected a day and a time with its zone, such as "
        "2026-12-21T15:04Z (UTC) or 2026-12-21T16:04+01:00, in the years "
        f"{_FIRST_YEAR} to {_LAST_YEAR}"
    )


def minutes_of(day: date, lon: float) -> list[datetime]:
    """Return each minute, in UTC, of the day around mean solar noon."""
    begin = datetime.combine(day, time(12), UTC) - timedelta(minutes=round(720.0 + 4.0 * lon))
    return [begin + step * _STEP for step in range(timedelta(days=1) // _STEP + 1)]


def above(
    day: date,
    body: Body,
    *,
    lon: float,
    lat: float,
    eye_elevation_m: float,
    azimuth_deg: Float64Array,
    elevation_deg: FloatArray,
) -> list[Interval]:
    """Return when part of a body's disc is above a horizon.

    The day is the 24 hours around noon of the mean sun at the eye. The standard atmosphere at the
    eye's elevation refracts the light. An interval shorter than a minute may be missed. Times are
    in UTC, to a tenth of a second. The dark part of the moon's disc counts.

    Parameters
    ----------
    day : date
    body : Body
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
    sky = Sky(lon, lat, eye_elevation_m)

    def above_deg(at: datetime) -> float:
        """Return the height of the disc's highest visible point above the horizon."""
        seen = sky.look(body, at)
        aside_deg = seen.radius_deg * _DISC / np.cos(np.radians(seen.elevation_deg))
        edge_deg = seen.elevation_deg + seen.radius_deg * np.sqrt(1.0 - _DISC**2)
        line_deg = np.interp(seen.azimuth_deg + aside_deg, azimuth_deg, horizon_deg, period=360.0)
        return float((edge_deg - line_deg).max())

    times = minutes_of(day, lon)
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


@dataclass(frozen=True, slots=True)
class InSky:
    """Where a body appears in the sky, refracted.

    Attributes
    ----------
    azimuth_deg, elevation_deg : float
        The middle of its disc; the azimuth is from true north.
    radius_deg : float
        Angular radius of the disc.
    """

    azimuth_deg: float
    elevation_deg: float
    radius_deg: float


class Sky:
    """The sky over an eye.

    Parameters
    ----------
    lon, lat : float
        The eye, degrees (WGS 84).
    elevation_m : float
        Metres above sea level; the standard atmosphere there refracts.

    Raises `InputError` if PyEphem is not installed.
    """

    def __init__(self, lon: float, lat: float, elevation_m: float) -> None:
        ephem = library("ephem", "the sun's position")
        observer = ephem.Observer()
        observer.lon = np.radians(lon)
        observer.lat = np.radians(lat)
        observer.elevation = elevation_m
        # The standard atmosphere: 15 degrees at sea level, 6.5 degrees less a kilometre.
        observer.temp = 15.0 - 0.0065 * elevation_m
        observer.compute_pressure()
        self._observer = observer
        self._bodies: dict[Body, Any] = {Body.SUN: ephem.Sun(), Body.MOON: ephem.Moon()}

    def look(self, body: Body, at: datetime | str) -> InSky:
        """Return where a body stands at a time.

        The time is as in `time_of`, which raises the same errors.
        """
        self._observer.date = time_of(at).replace(tzinfo=None)
        seen = self._bodies[body]
        seen.compute(self._observer)
        return InSky(*np.degrees([seen.az, seen.alt, seen.radius]).tolist())

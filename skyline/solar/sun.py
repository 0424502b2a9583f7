"""When the sun is above a horizon (extra ``sun``: the positions are PyEphem's)."""

from collections.abc import Callable
from datetime import UTC, date, datetime, time, timedelta

import numpy as np
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.extras import library

_STEP = timedelta(minutes=1)
_TO_SECONDS = 0.1
_DISC = np.linspace(-1.0, 1.0, 9)
"""Across the sun's disc, in radii."""


def sun_above(
    azimuth_deg: ArrayLike, elevation_deg: ArrayLike, eye: tuple[float, float, float], day: date
) -> list[tuple[datetime, datetime]]:
    """Return when any of the sun's disc is above a horizon, from and to, on one day.

    The day is the 24 hours about noon of the mean sun at the eye. Air refracts the sun's light as
    in the standard atmosphere at the eye's elevation. What lasts less than a minute may be missed.
    Times are in UTC, to a tenth of a second.

    Raises `InputError` where PyEphem is not installed, or the horizon is not known at some azimuth.

    Parameters
    ----------
    azimuth_deg, elevation_deg : (A,) array_like
        The horizon by azimuths from true north, increasing.
    eye : (float, float, float)
        Longitude and latitude in degrees, metres above the sea.
    """
    azimuth = np.asarray(azimuth_deg, dtype=np.float64)
    elevation = np.asarray(elevation_deg, dtype=np.float64)
    if not np.isfinite(elevation).all():
        raise InputError(
            f"the horizon is not known at {(~np.isfinite(elevation)).sum()} of {len(elevation)} "
            "azimuths; stand farther from the border of the DEM"
        )
    sun = _sun(*eye)

    def above_deg(at: datetime) -> float:
        """Return how far the highest visible point of the disc is above the horizon."""
        sun_azimuth_deg, sun_elevation_deg, radius_deg = sun(at)
        aside_deg = radius_deg * _DISC / np.cos(np.radians(sun_elevation_deg))
        edge_deg = sun_elevation_deg + radius_deg * np.sqrt(1.0 - _DISC**2)
        line_deg = np.interp(sun_azimuth_deg + aside_deg, azimuth, elevation, period=360.0)
        return float((edge_deg - line_deg).max())

    begin = datetime.combine(day, time(12), UTC) - timedelta(hours=12.0 + eye[0] / 15.0)
    times = [begin + step * _STEP for step in range(timedelta(days=1) // _STEP + 1)]
    shines = np.array([above_deg(at) > 0.0 for at in times])
    turns = [
        _crossing(above_deg, times[index], times[index + 1])
        for index in np.flatnonzero(shines[1:] != shines[:-1])
    ]
    ends = [*times[:1] * bool(shines[0]), *turns, *times[-1:] * bool(shines[-1])]
    return list(zip(ends[::2], ends[1::2], strict=True))


def _crossing(above: Callable[[datetime], float], low: datetime, high: datetime) -> datetime:
    """Return when a function changes its sign between two times, by bisection."""
    before = above(low) > 0.0
    while (high - low).total_seconds() > _TO_SECONDS:
        middle = low + (high - low) / 2
        low, high = (middle, high) if (above(middle) > 0.0) == before else (low, middle)
    return high


def _sun(lon: float, lat: float, elevation_m: float) -> Callable[[datetime], Float64Array]:
    """Return what gives the sun's azimuth, refracted elevation and radius in degrees at a time."""
    ephem = library("ephem", "sun", "the sun's position")
    observer = ephem.Observer()
    observer.lon, observer.lat = np.radians(lon), np.radians(lat)
    observer.elevation, observer.temp = elevation_m, 15.0 - 0.0065 * elevation_m
    observer.compute_pressure()
    body = ephem.Sun()

    def position(at: datetime) -> Float64Array:
        observer.date = at.replace(tzinfo=None)
        body.compute(observer)
        return np.degrees([body.az, body.alt, body.radius])

    return position

"""The horizon round places that a person names: azimuths from true north, degrees, metres.

When the sun is above it (extra ``sun``: the positions are PyEphem's), and how much sky there is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float32Array, Float64Array, Rows
from skyline.errors import InputError, library

_STEP = timedelta(minutes=1)
_TO_SECONDS = 0.1
_DISC = np.linspace(-1.0, 1.0, 9)
"""Across the sun's disc, in radii."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalHorizons(Rows):
    """The horizons of N places in A equal steps of azimuth.

    Attributes
    ----------
    lon, lat : (N,) float64
        Degrees (WGS 84).
    eye_elevation_m : (N,) float64
        Metres above the DEM's datum.
    azimuth_deg : (N, A) float64
        Clockwise from true north; every place has the same.
    elevation_deg : (N, A) float32
        Elevation angle of the horizon; NaN where an azimuth meets no data.
    distance_m : (N, A) float32
        Horizontal distance of what makes the horizon; NaN where an azimuth meets no data.
    flags : (N, A) uint8
        Bits: 1, the horizon lies on the border of the data; 2, a hole may hide what is higher; 4,
        no data.
    surface_deg : (N, A) float32
        Elevation angle up to which trees and houses may rise, at least that of the horizon; NaN
        where no surface model was given.
    """

    lon: Float64Array
    lat: Float64Array
    eye_elevation_m: Float64Array
    azimuth_deg: Float64Array
    elevation_deg: Float32Array
    distance_m: Float32Array
    flags: NDArray[np.uint8]
    surface_deg: Float32Array

    @property
    def has_surface(self) -> bool:
        """Whether a surface model was given."""
        return not bool(np.isnan(self.surface_deg).all())

    def sky_view_factor(self, tilt_deg: float = 0.0, facing_deg: float = 180.0) -> Float64Array:
        """Return the sky view factors (N,) of a surface; see `sky_view_factor`."""
        return sky_view_factor(self.azimuth_deg[0], self.elevation_deg, tilt_deg, facing_deg)

    def sun_above(self, day: date, place: int = 0) -> list[tuple[datetime, datetime]]:
        """Return when any of the sun's disc is above the horizon of one place, from and to.

        The day is the 24 hours about noon of the mean sun at the eye. Air refracts the sun's light
        as in the standard atmosphere at the eye's elevation. What lasts less than a minute may be
        missed. Times are in UTC, to a tenth of a second.

        Raises `InputError` where PyEphem is not installed, or the horizon is not known at some
        azimuth.
        """
        azimuth, elevation = self.azimuth_deg[place], self.elevation_deg[place].astype(np.float64)
        if not np.isfinite(elevation).all():
            raise InputError(
                f"the horizon is not known at {(~np.isfinite(elevation)).sum()} of "
                f"{len(elevation)} azimuths; stand farther from the border of the DEM"
            )
        lon = float(self.lon[place])
        sun = _sun(lon, float(self.lat[place]), float(self.eye_elevation_m[place]))

        def above_deg(at: datetime) -> float:
            """Return how far the highest visible point of the disc is above the horizon."""
            sun_azimuth_deg, sun_elevation_deg, radius_deg = sun(at)
            aside_deg = radius_deg * _DISC / np.cos(np.radians(sun_elevation_deg))
            edge_deg = sun_elevation_deg + radius_deg * np.sqrt(1.0 - _DISC**2)
            line_deg = np.interp(sun_azimuth_deg + aside_deg, azimuth, elevation, period=360.0)
            return float((edge_deg - line_deg).max())

        begin = datetime.combine(day, time(12), UTC) - timedelta(hours=12.0 + lon / 15.0)
        times = [begin + step * _STEP for step in range(timedelta(days=1) // _STEP + 1)]
        shines = np.array([above_deg(at) > 0.0 for at in times])
        turns = [
            _crossing(above_deg, times[index], times[index + 1])
            for index in np.flatnonzero(shines[1:] != shines[:-1])
        ]
        ends = [*times[:1] * bool(shines[0]), *turns, *times[-1:] * bool(shines[-1])]
        return list(zip(ends[::2], ends[1::2], strict=True))

    def to_series(self, place: int = 0) -> Any:
        """Return the horizon of one place as pvlib has those of PVGIS.

        Returns
        -------
        pandas.Series
            ``horizon_elevation`` in degrees by ``horizon_azimuth`` in degrees from true north.

        Raises
        ------
        InputError
            Pandas is not installed.
        """
        pandas = library("pandas", "geo", "a Series")
        index = pandas.Index(self.azimuth_deg[place], name="horizon_azimuth")
        elevation = self.elevation_deg[place].astype(np.float64)
        return pandas.Series(elevation, index, name="horizon_elevation")

    def to_xarray(self) -> Any:
        """Return all as a dataset.

        Returns
        -------
        xarray.Dataset
            ``elevation_deg``, ``distance_m``, ``flags`` and, where a surface model was given,
            ``surface_deg`` by ``point`` and ``azimuth_deg``;
            ``sky_view_factor`` of a level surface, ``lon``, ``lat`` and ``eye_elevation_m`` by
            ``point``.

        Raises
        ------
        InputError
            Xarray is not installed.
        """
        xarray = library("xarray", "geo", "a Dataset")
        told = {
            "surface_deg": ("elevation angle up to which trees and houses may rise", "degrees"),
            "elevation_deg": ("elevation angle of the horizon", "degrees"),
            "distance_m": ("horizontal distance of the horizon", "m"),
        }
        if not self.has_surface:
            del told["surface_deg"]
        round_about = ("point", "azimuth_deg")
        true_north = {"long_name": "azimuth, clockwise from true north", "units": "degrees"}
        return xarray.Dataset(
            {
                **{
                    name: (round_about, getattr(self, name), {"long_name": what, "units": unit})
                    for name, (what, unit) in told.items()
                },
                "flags": (round_about, self.flags, {"long_name": "1 border, 2 hole, 4 no data"}),
                "sky_view_factor": ("point", self.sky_view_factor()),
            },
            {
                "lon": ("point", self.lon, {"standard_name": "longitude", "units": "degrees_east"}),
                "lat": ("point", self.lat, {"standard_name": "latitude", "units": "degrees_north"}),
                "eye_elevation_m": ("point", self.eye_elevation_m, {"units": "m"}),
                "azimuth_deg": ("azimuth_deg", self.azimuth_deg[0], true_north),
            },
        )


def sky_view_factor(
    azimuth_deg: ArrayLike,
    elevation_deg: ArrayLike,
    tilt_deg: float = 0.0,
    facing_deg: float = 180.0,
) -> Float64Array:
    """Return sky view factors: the sky's light on a surface, as a share of that of a free sky.

    Source: Dozier and Frew, Rapid calculation of terrain parameters for radiation modeling from
    digital elevation data, IEEE Transactions on Geoscience and Remote Sensing 28 (1990), equation
    7b: the mean over all azimuths a of cos S sin(H)^2 + sin S cos(a - A) (H - sin H cos H), where
    S and A are the surface's tilt and azimuth and H is the angle from the zenith down to what ends
    the sky: the horizon, or the surface's own plane where that is higher. The sky is equally bright
    everywhere.

    Parameters
    ----------
    azimuth_deg : (A,) array_like
        In equal steps all the way round.
    elevation_deg : (..., A) array_like
        Of horizons; what lies under the horizontal plane hides no sky.
    tilt_deg, facing_deg : float
        Of the surface, from the horizontal, and the azimuth it faces; level by default, where the
        factor is the mean of the cosine of the horizon's elevation, squared.

    Returns
    -------
    (...) float64
        0 to 1; NaN where the horizon is not known all the way round.
    """
    tilt = np.radians(tilt_deg)
    away = np.cos(np.radians(np.asarray(azimuth_deg, dtype=np.float64) - facing_deg))
    own_plane = np.arctan2(-np.sin(tilt) * away, np.cos(tilt))
    horizon = np.radians(np.asarray(elevation_deg, dtype=np.float64))
    zenith = 0.5 * np.pi - np.maximum(np.maximum(horizon, own_plane), 0.0)
    sine, cosine = np.sin(zenith), np.cos(zenith)
    light = np.cos(tilt) * sine**2 + np.sin(tilt) * away * (zenith - sine * cosine)
    return np.asarray(light.mean(axis=-1), dtype=np.float64)


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

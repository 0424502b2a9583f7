"""Horizons of named places, hours of sun above them, sky view factors, and files of horizons.

Azimuths are degrees from true north, distances metres. The sun's position is PyEphem's (extra
``sun``).
"""

import io
import json
import logging
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float32Array, Float64Array, Progress, Rows, UInt8Array
from skyline.errors import InputError, entry_named, library, numbers_of
from skyline.files import write_whole
from skyline.geodesy import Curvature, in_turn
from skyline.render.horizon import PanoramaRenderer
from skyline.skylines import MAX_WIDTH, Horizons
from skyline.tables import csv_lines
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_at

DEFAULT_STEP_DEG = 0.5
_AT_ONCE = 2048
"""Eyes rendered between two reports of progress."""
_LEAST_STEPS = 8
_SHOWN = 5
"""Places that a notebook shows."""

_YEARS = 1583, 9998
"""PyEphem counts earlier days in the Julian calendar, and later ones are beyond Python's dates."""
_STEP = timedelta(minutes=1)
_TO_SECONDS = 0.1
_DISC = np.linspace(-1.0, 1.0, 9)
"""Positions across the sun's disc, in radii."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class LocalHorizons(Rows):
    """Horizons of N places in A equal steps of azimuth.

    Attributes
    ----------
    lon, lat : (N,) float64
        Degrees (WGS 84).
    eye_elevation_m : (N,) float64
        Metres above the DEM's datum.
    azimuth_deg : (N, A) float64
        Clockwise from true north; the same for every place.
    elevation_deg : (N, A) float32
        Elevation angle of the horizon; NaN at azimuths without data.
    distance_m : (N, A) float32
        Horizontal distance of the horizon; NaN at azimuths without data.
    flags : (N, A) uint8
        Bits: 1, the horizon lies on the border of the data; 2, a hole may hide higher terrain; 4,
        no data.
    surface_deg : (N, A) float32
        Elevation angle up to which trees and houses may rise, at least that of the horizon; NaN
        without a surface model.
    id : (N,) str
        The ``id`` or ``name`` of each place in a file of places; else empty.
    """

    lon: Float64Array
    lat: Float64Array
    eye_elevation_m: Float64Array
    azimuth_deg: Float64Array
    elevation_deg: Float32Array
    distance_m: Float32Array
    flags: UInt8Array
    surface_deg: Float32Array
    id: NDArray[np.str_]

    @property
    def has_ids(self) -> bool:
        """True if the places have ids or names."""
        return bool((self.id != "").any())

    @property
    def has_surface(self) -> bool:
        """True if a surface model was given."""
        return not bool(np.isnan(self.surface_deg).all())

    def sky_view_factor(self, tilt_deg: float = 0.0, facing_deg: float = 180.0) -> Float64Array:
        """Return the sky view factors (N,) of a surface; see `sky_view_factor`."""
        return sky_view_factor(self.azimuth_deg[0], self.elevation_deg, tilt_deg, facing_deg)

    def sun_above(
        self, day: date | str, place: int | None = None
    ) -> list[tuple[datetime, datetime]]:
        """Return the intervals during which part of the sun's disc is above one place's horizon.

        ``place`` is its index, which may be left out if there is only one place. The day is the 24
        hours around noon of the mean sun at the eye. Refraction is that of the standard atmosphere
        at the eye's elevation. An interval shorter than a minute may be missed. Times are in UTC,
        to a tenth of a second.

        Raises `InputError` if PyEphem is not installed, the horizon is unknown at some azimuth, one
        of several places is not chosen, or as `day_of`.
        """
        day = day_of(day)
        place = self._chosen(place)
        azimuth, elevation = self.azimuth_deg[place], self.elevation_deg[place].astype(np.float64)
        if not np.isfinite(elevation).all():
            raise InputError(
                f"the horizon is unknown at {(~np.isfinite(elevation)).sum()} of "
                f"{len(elevation)} azimuths; choose a place farther from the border of the DEM"
            )
        lon = float(self.lon[place])
        sun = _sun(lon, float(self.lat[place]), float(self.eye_elevation_m[place]))

        def above_deg(at: datetime) -> float:
            """Return the height of the highest visible point of the disc above the horizon."""
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

    def plot(self, place: int | None = None, ax: Any = None) -> Any:
        """Draw one place's horizon over azimuth, and return the matplotlib axes.

        ``place`` is its index, which may be left out if there is only one place. ``ax`` are axes to
        draw on; by default a new figure is made. A warning names an id that no installed font
        draws; the title then lacks it.

        Raises `InputError` if one of several places is not chosen.
        """
        from skyline.fonts import fonts_for  # noqa: PLC0415  (slow to load)

        place = self._chosen(place)
        if ax is None:
            from matplotlib import pyplot  # noqa: PLC0415  (slow to load)

            ax = pyplot.subplots(figsize=(9, 3), layout="constrained")[1]
        azimuth, up = self.azimuth_deg[place], self.elevation_deg[place]
        ax.fill_between(azimuth, up, min(0.0, float(np.nanmin(up))), color="0.75", linewidth=0.0)
        ax.plot(azimuth, up, color="black", linewidth=1.0)
        if self.has_surface:
            ax.plot(azimuth, self.surface_deg[place], color="green", linewidth=1.0)
        name, (families,) = str(self.id[place]), fonts_for([str(self.id[place])])
        if not families:
            _log.warning("no installed font draws %s; the title of its horizon lacks it", name)
            name = ""
        title = f"{name}: " if name else ""
        title += f"lon {self.lon[place]:.5f}, lat {self.lat[place]:.5f}, "
        title += f"eye {self.eye_elevation_m[place]:.0f} m"
        ax.set_title(title, fontfamily=families or None, parse_math=False)
        ax.set(xlim=(0.0, 360.0), xticks=range(0, 361, 45))
        ax.set(xlabel="azimuth from true north (degrees)", ylabel="elevation (degrees)")
        return ax

    def __repr__(self) -> str:
        return f"LocalHorizons(places={len(self)}, azimuths={self.azimuth_deg.shape[1]})"

    def _repr_html_(self) -> str:
        from matplotlib.figure import Figure  # noqa: PLC0415  (slow to load)

        shown = io.StringIO()
        for place in range(min(len(self), _SHOWN)):
            figure = Figure(figsize=(9, 3), layout="constrained")
            self.plot(place, figure.subplots())
            figure.savefig(shown, format="svg")
        more = len(self) - _SHOWN
        return shown.getvalue() + (f"<p>and {more} more places</p>" if more > 0 else "")

    def _chosen(self, place: int | None) -> int:
        """Return the index of a place; raises `InputError` unless it is there, or the only one."""
        if place is None and len(self) == 1:
            return 0
        if place is None or not -len(self) <= place < len(self):
            given = "none is chosen" if place is None else f"place is {place}"
            raise InputError(
                f"there are {len(self)} places and {given}; give place=0 to {len(self) - 1}, or "
                "take all with to_xarray()"
            )
        return place

    def to_series(self, place: int | None = None) -> Any:
        """Return the horizon of one place in the form of pvlib's `get_pvgis_horizon`.

        Parameters
        ----------
        place : int, optional
            Its index, which may be left out if there is only one place; `to_xarray` has all.

        Returns
        -------
        pandas.Series
            ``horizon_elevation`` in degrees by ``horizon_azimuth`` in degrees from true north.

        Raises
        ------
        InputError
            Pandas is not installed, or one of several places is not chosen.
        """
        place = self._chosen(place)
        pandas = library("pandas", "a Series")
        index = pandas.Index(self.azimuth_deg[place], name="horizon_azimuth")
        elevation = self.elevation_deg[place].astype(np.float64)
        return pandas.Series(elevation, index, name="horizon_elevation")

    def to_xarray(self) -> Any:
        """Return the horizons as a dataset.

        Returns
        -------
        xarray.Dataset
            ``elevation_deg``, ``distance_m``, ``flags`` and, with a surface model, ``surface_deg``
            by ``point`` and ``azimuth_deg``; ``sky_view_factor`` of a level surface, ``lon``,
            ``lat`` and ``eye_elevation_m`` by ``point``.

        Raises
        ------
        InputError
            Xarray is not installed.
        """
        xarray = library("xarray", "a Dataset")
        described = {
            "surface_deg": ("elevation angle up to which trees and houses may rise", "degrees"),
            "elevation_deg": ("elevation angle of the horizon", "degrees"),
            "distance_m": ("horizontal distance of the horizon", "m"),
        }
        dims = ("point", "azimuth_deg")
        true_north = {"long_name": "azimuth, clockwise from true north", "units": "degrees"}
        return xarray.Dataset(
            {
                **{
                    name: (dims, getattr(self, name), {"long_name": long_name, "units": unit})
                    for name, (long_name, unit) in described.items()
                    if name != "surface_deg" or self.has_surface
                },
                "flags": (dims, self.flags, {"long_name": "1 border, 2 hole, 4 no data"}),
                "sky_view_factor": ("point", self.sky_view_factor()),
            },
            {
                "lon": ("point", self.lon, {"standard_name": "longitude", "units": "degrees_east"}),
                "lat": ("point", self.lat, {"standard_name": "latitude", "units": "degrees_north"}),
                "eye_elevation_m": ("point", self.eye_elevation_m, {"units": "m"}),
                "id": ("point", self.id),
                "azimuth_deg": ("azimuth_deg", self.azimuth_deg[0], true_north),
            },
        )


def horizon(  # noqa: PLR0913  (independent conditions)
    terrain: Dem,
    *,
    lon: ArrayLike,
    lat: ArrayLike,
    eye_height_m: ArrayLike = DEFAULT_EYE_HEIGHT_M,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    surface: Dem | None = None,
    summit_within_m: float | None = None,
) -> LocalHorizons:
    """Return the horizons around places, exact on the DEM's surface to float32.

    Parameters
    ----------
    terrain : path, paths or HeightField
        The elevation model; read it once with `read_dem` for several calls.
    lon, lat : array_like, degrees (WGS 84), broadcast to N places
    eye_height_m : array_like, metres above ground
    step_deg : float
        Step between azimuths; the first azimuth is true north.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.
    surface : path, paths or HeightField, optional
        A surface or canopy model: the height to which trees and houses may rise above the horizon.
    summit_within_m : float, optional
        Move each eye to the highest point within this distance. By default eyes stay in place, and
        an eye within one sample's spacing of a summit of the model is raised to its height; 0
        leaves such an eye on the slope.

    Raises
    ------
    OffMapError
        A place is off the map or on a hole, or an eye height is below 0.
    InputError
        No place is given, coordinates are no numbers or do not fit together, the step does not
        divide a full turn, or the surface does not cover the DEM.
    ContextError
        No OpenGL context can be created.
    """
    steps_a_turn(step_deg)
    terrain = read_dem(terrain)
    eyes = stand_at(
        terrain, lon=lon, lat=lat, eye_height_m=eye_height_m, summit_within_m=summit_within_m
    )
    over = None if surface is None else read_surface(surface, terrain)
    return horizons_of(terrain, eyes, step_deg, curvature, surface=over)


def horizons_of(
    terrain: HeightField,
    eyes: Viewpoints,
    step_deg: float = DEFAULT_STEP_DEG,
    curvature: Curvature | None = None,
    progress: Progress | None = None,
    surface: HeightField | None = None,
    ids: Sequence[str] = (),
) -> LocalHorizons:
    """Return the horizons of eyes, as `horizon`; the surface is a height field."""
    steps = steps_a_turn(step_deg)
    if not len(eyes):
        raise InputError("no place was given; give the longitude and latitude of one or more")
    # The renderer needs a multiple of 8 steps per turn; the extra steps are dropped.
    every = 8 // math.gcd(steps, 8)
    lon, lat = terrain.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    to_grid_rad = -np.radians(
        terrain.frame.convergence_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    )

    def in_parts(field: HeightField) -> Horizons:
        """Render a field in parts, with a report of progress after each."""
        parts: list[Horizons] = []
        with PanoramaRenderer(field, steps * every, curvature) as renderer:
            for start in range(0, len(eyes), _AT_ONCE):
                part = slice(start, start + _AT_ONCE)
                parts.append(renderer.render(eyes[part], to_grid_rad[part]))
                if progress is not None:
                    progress(min(part.stop, len(eyes)), len(eyes))
        return Horizons.concatenate(parts)

    rendered = in_parts(terrain)
    elevation_deg = np.degrees(np.arctan(rendered.elevation_tan[:, ::every]))
    surface_deg = np.full_like(elevation_deg, np.nan)
    if surface is not None:
        over = in_parts(surface)
        # Rounding in the surface model must not put it below the terrain.
        surface_deg = np.degrees(np.arctan(over.elevation_tan[:, ::every]))
        surface_deg = np.maximum(surface_deg, elevation_deg)
    azimuth_deg = np.arange(steps) * (360.0 / steps)
    return LocalHorizons(
        lon,
        lat,
        eyes.eye_elevation_m,
        np.broadcast_to(azimuth_deg, (len(eyes), steps)),
        elevation_deg,
        rendered.distance_m[:, ::every],
        rendered.flags[:, ::every],
        surface_deg,
        np.array(ids or [""] * len(eyes), dtype=np.str_),
    )


def steps_a_turn(step_deg: float) -> int:
    """Return the number of steps in a turn; `InputError` for a step that does not divide it."""
    most, is_number = MAX_WIDTH // 2, isinstance(step_deg, Real)
    steps = round(360.0 / step_deg) if is_number and 0.0 < step_deg <= 360.0 else 0
    if not (_LEAST_STEPS <= steps <= most and math.isclose(steps * step_deg, 360.0, rel_tol=1e-6)):
        raise InputError(
            f"step is {step_deg!r} degrees; expected a divisor of 360, a number from "
            f"{360.0 / most:.3g} to {360.0 / _LEAST_STEPS:g}: 0.5, 1 or 7.5"
        )
    return steps


def sky_view_factor(
    azimuth_deg: ArrayLike,
    elevation_deg: ArrayLike,
    tilt_deg: float = 0.0,
    facing_deg: float = 180.0,
) -> Float64Array:
    """Return sky view factors: the sky's light on a surface as a share of an unobstructed sky's.

    Source: Dozier and Frew, Rapid calculation of terrain parameters for radiation modeling from
    digital elevation data, IEEE Transactions on Geoscience and Remote Sensing 28 (1990), equation
    7b: the mean over all azimuths a of cos S sin(H)^2 + sin S cos(a - A) (H - sin H cos H), where
    S and A are the surface's tilt and azimuth and H is the angle from the zenith down to the lower
    end of the sky: the horizon, or the surface's own plane where that is higher. A surface that
    overhangs hides the sky above its plane: the same term, of the angle down to the plane, is
    subtracted. The sky is assumed equally bright everywhere.

    Parameters
    ----------
    azimuth_deg : (A,) array_like
        Equal steps over a full turn.
    elevation_deg : (..., A) array_like
        Elevation of horizons; negative elevations count as 0.
    tilt_deg, facing_deg : float
        Tilt of the surface from the horizontal, 0 to 180, and the azimuth that it faces. For a
        level surface, the default, the factor is the mean of the squared cosine of the horizon's
        elevation; beyond 90 the surface overhangs, and at 180 it faces the ground.

    Returns
    -------
    (...) float64
        0 to 1; NaN if the horizon is unknown at some azimuth.

    Raises
    ------
    InputError
        The azimuths are not equal steps over a full turn, there is not one elevation for each, the
        tilt is not from 0 to 180, or the azimuth that the surface faces is not a number.
    """
    azimuth, elevation = (np.asarray(a, dtype=np.float64) for a in (azimuth_deg, elevation_deg))
    even = np.arange(azimuth.size) * (360.0 / max(azimuth.size, 1))
    if azimuth.ndim != 1 or not np.allclose(in_turn(azimuth - azimuth[:1] - even), 0.0, atol=1e-3):
        raise InputError("azimuths are not equal steps, in degrees, over a full turn")
    if elevation.shape[-1:] != azimuth.shape:
        raise InputError(
            f"elevations have shape {elevation.shape}; expected (..., {azimuth.size}), one for "
            "each azimuth"
        )
    error = (
        f"tilt and azimuth are {tilt_deg!r} and {facing_deg!r}; expected degrees, a tilt from 0 "
        "(level) to 180 (facing the ground)"
    )
    tilt_deg, facing_deg = numbers_of((tilt_deg, facing_deg), 2, error)
    if not (0.0 <= tilt_deg <= 180.0 and math.isfinite(facing_deg)):
        raise InputError(error)
    tilt = np.radians(tilt_deg)
    away = np.cos(np.radians(azimuth - facing_deg))
    own_plane = np.arctan2(-np.sin(tilt) * away, np.cos(tilt))
    horizon = np.radians(elevation)
    # Angles from the zenith down to the lower and the upper end of the sky.
    low = 0.5 * np.pi - np.clip(np.maximum(horizon, own_plane), 0.0, 0.5 * np.pi)
    zenith = np.stack([low, np.clip(-0.5 * np.pi - own_plane, 0.0, low)])
    sine, cosine = np.sin(zenith), np.cos(zenith)
    light = np.cos(tilt) * sine**2 + np.sin(tilt) * away * (zenith - sine * cosine)
    return np.asarray((light[0] - light[1]).mean(axis=-1), dtype=np.float64)


def day_of(given: date | str) -> date:
    """Return a date, or that of a text such as 2026-12-21; `InputError` unless 1583 to 9998."""
    with suppress(ValueError):
        day = given if isinstance(given, date) else date.fromisoformat(str(given))
        if _YEARS[0] <= day.year <= _YEARS[1]:
            return day
    raise InputError(
        f"the day is `{given}`; expected a day such as 2026-12-21, in the years "
        f"{_YEARS[0]} to {_YEARS[1]}"
    )


def _crossing(above: Callable[[datetime], float], low: datetime, high: datetime) -> datetime:
    """Return the time between two others at which a function changes sign, by bisection."""
    before = above(low) > 0.0
    while (high - low).total_seconds() > _TO_SECONDS:
        middle = low + (high - low) / 2
        low, high = (middle, high) if (above(middle) > 0.0) == before else (low, middle)
    return high


def _sun(lon: float, lat: float, elevation_m: float) -> Callable[[datetime], Float64Array]:
    """Return a function from time to the sun's azimuth, refracted elevation and radius, degrees."""
    ephem = library("ephem", "the sun's position")
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


def write_horizons(horizons: LocalHorizons, path: Path) -> None:
    """Write horizons to a file in the format of its suffix.

    ``.csv`` and ``.json`` hold any number of places; ``.txt`` (the horizon file of PVGIS: elevation
    angles clockwise from north, one per line, none below 0) holds one.

    Raises `InputError` where the suffix is unknown, the file cannot be written, or a ``.txt`` would
    hold several places, a surface, or an unknown value.
    """
    write_whole(path, entry_named("the suffix", path.suffix.lower(), KINDS)(horizons))


def horizon_csv(horizons: LocalHorizons) -> str:
    """Return horizons as CSV: one row per place and azimuth; unknown values are empty."""
    written, bins = _columns(horizons), horizons.azimuth_deg.shape[1]
    columns = [np.repeat(horizons.lon, bins), np.repeat(horizons.lat, bins)]
    columns += [getattr(horizons, name).ravel() for name in ("azimuth_deg", *written)]
    digits = ["%.7f", "%.7f", "%.9g", *(f"%.{digits}f" for digits in written.values())]
    text, header = io.StringIO(), ",".join(["lon", "lat", "azimuth_deg", *written])
    np.savetxt(text, np.column_stack(columns), ",".join(digits), header=header, comments="")
    lines = text.getvalue().replace("nan", "").splitlines(keepends=True)
    if horizons.has_ids:
        cells = [csv_lines([[one]]).rstrip("\n") for one in horizons.id.tolist()]
        ids = ["id", *np.repeat(cells, bins)]
        lines = [f"{one},{line}" for one, line in zip(ids, lines, strict=True)]
    return "".join(lines)


def _columns(horizons: LocalHorizons) -> dict[str, int]:
    """Return the columns written for each azimuth, with their number of decimals."""
    return {"elevation_deg": 5, "distance_m": 1} | (
        {"surface_deg": 5} if horizons.has_surface else {}
    )


def _json(horizons: LocalHorizons) -> str:
    factors = horizons.sky_view_factor()
    places = [
        {
            **({"id": str(horizons.id[index])} if horizons.has_ids else {}),
            "lon": round(float(horizons.lon[index]), 7),
            "lat": round(float(horizons.lat[index]), 7),
            "eye_elevation_m": round(float(horizons.eye_elevation_m[index]), 2),
            "sky_view_factor": _known(factors[index], 5),
            "azimuth_deg": [round(value, 9) for value in horizons.azimuth_deg[index].tolist()],
            **{
                name: [_known(value, digits) for value in getattr(horizons, name)[index]]
                for name, digits in _columns(horizons).items()
            },
        }
        for index in range(len(horizons))
    ]
    return json.dumps({"places": places}, allow_nan=False) + "\n"


def _known(value: Any, digits: int) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def _pvgis(horizons: LocalHorizons) -> str:
    if len(horizons) != 1:
        raise InputError(
            f"the file would hold {len(horizons)} horizons, but .txt holds one; give one place, or "
            "write .csv or .json"
        )
    if horizons.has_surface:
        raise InputError(
            "the file would hold two horizons, but .txt holds one; leave --surface out, or write "
            ".csv or .json"
        )
    elevation_deg = np.maximum(horizons.elevation_deg[0], 0.0)
    if not np.isfinite(elevation_deg).all():
        raise InputError(
            "the horizon is unknown at some azimuths; choose a place farther from the border of "
            "the DEM, or write .csv or .json"
        )
    return "".join(f"{value:.2f}\n" for value in elevation_deg)


KINDS: dict[str, Callable[[LocalHorizons], str]] = {
    ".csv": horizon_csv,
    ".json": _json,
    ".txt": _pvgis,
}
"""The formats of `write_horizons`, by their suffixes."""

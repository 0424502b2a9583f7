"""Horizons of named places: elevation angles and distances by azimuth.

Azimuths are degrees from true north.
"""

import io
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float32Array, Float64Array, Progress, Rows, UInt8Array
from skyline.errors import InputError, library
from skyline.geodesy.bounds import in_turn
from skyline.geodesy.earth import Curvature
from skyline.render.horizon import PanoramaRenderer
from skyline.sky_view import sky_view_factor
from skyline.skylines import MAX_WIDTH, Horizons
from skyline.sun import Body, Interval, Sky, above, day_of
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, stand_at

DEFAULT_STEP_DEG = 0.5
_AT_ONCE = 2048
"""Eyes rendered between two reports of progress."""
_LEAST_STEPS = 8
"""Fewest azimuths of a horizon; the renderer draws a multiple of them."""
_SHOWN = 5
"""Places that a notebook shows."""
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
        Elevation angle up to which trees and houses may rise, never below the horizon; NaN without
        a surface model.
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

    def sun_above(self, day: date | str, place: int | None = None) -> list[Interval]:
        """Return when part of the sun's disc is above one place's horizon.

        Parameters
        ----------
        day : date or str
            The 24 hours around noon of the mean sun at the eye; a text such as 2026-12-21.
        place : int, optional
            Index of the place; it may be left out if there is only one place.

        Returns
        -------
        list of (datetime, datetime)
            Beginnings and ends in UTC, to a tenth of a second. An interval shorter than a minute
            may be missed. Light is refracted as in the standard atmosphere at the eye's elevation.

        Raises
        ------
        InputError
            PyEphem is not installed, the horizon is unknown at some azimuth, one of several places
            is not chosen, or the day is not a date from 1583 to 9998.
        """
        return self._above(Body.SUN, day, place)

    def moon_above(self, day: date | str, place: int | None = None) -> list[Interval]:
        """Return when part of the moon's disc, dark or lit, is above one place's horizon.

        Parameters, times and errors as `sun_above`. The day is the sun's.
        """
        return self._above(Body.MOON, day, place)

    def sky(self, place: int | None = None) -> Sky:
        """Return the sky over one place.

        Raises `InputError` if PyEphem is not installed or one of several places is not chosen.
        """
        place = self._chosen(place)
        at = self.lon[place], self.lat[place], self.eye_elevation_m[place]
        return Sky(*map(float, at))

    def _above(self, body: Body, day: date | str, place: int | None) -> list[Interval]:
        day = day_of(day)
        place = self._chosen(place)
        return above(
            day,
            body,
            lon=float(self.lon[place]),
            lat=float(self.lat[place]),
            eye_elevation_m=float(self.eye_elevation_m[place]),
            azimuth_deg=self.azimuth_deg[place],
            elevation_deg=self.elevation_deg[place],
        )

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
        azimuth_deg = self.azimuth_deg[place]
        up_deg = self.elevation_deg[place]
        foot_deg = min(0.0, float(np.nanmin(up_deg)))
        ax.fill_between(azimuth_deg, up_deg, foot_deg, color="0.75", linewidth=0.0)
        ax.plot(azimuth_deg, up_deg, color="black", linewidth=1.0)
        if self.has_surface:
            ax.plot(azimuth_deg, self.surface_deg[place], color="green", linewidth=1.0)
        name = str(self.id[place])
        (families,) = fonts_for([name])
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
        """Return a place's index; raises `InputError` unless there is one to take."""
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
        """Return one place's horizon in the form of pvlib's `get_pvgis_horizon`.

        Parameters
        ----------
        place : int, optional
            Index of the place; it may be left out if there is only one place; `to_xarray` has all.

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


def with_photo(
    horizons: LocalHorizons, azimuth_deg: Float64Array, elevation_deg: Float64Array
) -> tuple[LocalHorizons, float]:
    """Return one place's horizon with a photo's skyline in it, and the photo's share of the turn.

    Parameters
    ----------
    horizons : LocalHorizons
        One place.
    azimuth_deg, elevation_deg : (N,) float64
        The photo's skyline, from true north. Azimuths within half a step of a point of it, or of a
        gap between two columns, have its elevation and no distance; the others keep the horizon
        that they have.
    """
    order = np.argsort(azimuth_deg % 360.0)
    known_deg, up_deg = azimuth_deg[order] % 360.0, elevation_deg[order]
    at_deg = horizons.azimuth_deg[0]
    after = np.searchsorted(known_deg, at_deg) % len(known_deg)
    nearest_deg = np.minimum(
        np.abs(in_turn(known_deg[after] - at_deg)), np.abs(in_turn(known_deg[after - 1] - at_deg))
    )
    reach_deg = max(180.0 / len(at_deg), 2.0 * float(np.median(np.diff(known_deg, append=360.0))))
    is_seen = nearest_deg <= reach_deg
    seen_deg = np.interp(at_deg, known_deg, up_deg, period=360.0)
    joined = replace(
        horizons,
        elevation_deg=np.where(is_seen, seen_deg, horizons.elevation_deg).astype(np.float32),
        distance_m=np.where(is_seen, np.float32(np.nan), horizons.distance_m),
        flags=np.where(is_seen, np.uint8(0), horizons.flags),
    )
    return joined, float(is_seen.mean())


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
        Defaults to `Frame.curvature`: the Earth's with k = 0.13, or another world's.
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
    """Return the horizons of eyes; see `horizon` for the arguments."""
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
    """Return the steps in a turn; raises `InputError` unless they are whole."""
    most = MAX_WIDTH // 2
    is_number = isinstance(step_deg, Real)
    steps = round(360.0 / step_deg) if is_number and 0.0 < step_deg <= 360.0 else 0
    if not (_LEAST_STEPS <= steps <= most and math.isclose(steps * step_deg, 360.0, rel_tol=1e-6)):
        raise InputError(
            f"step is {step_deg!r} degrees; expected a divisor of 360, a number from "
            f"{360.0 / most:.3g} to {360.0 / _LEAST_STEPS:g}: 0.5, 1 or 7.5"
        )
    return steps

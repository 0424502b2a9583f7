"""The horizons of places, and the sky above them.

Azimuths are degrees from true north.
"""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import date
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from skyline.arrays import Float32Array, Float64Array, UInt8Array, refuse_text
from skyline.errors import InputError, library
from skyline.files.cf import DEGREES, LAT, LON, METRES, TRUE_NORTH
from skyline.geodesy.bounds import are_degrees
from skyline.geodesy.crs import WGS84
from skyline.sky.sun import Body, Interval, Sky, above, check_is_earth, day_of
from skyline.sky.view_factor import sky_view_factor

if TYPE_CHECKING:
    from geopandas import GeoDataFrame
    from matplotlib.axes import Axes
    from pandas import DataFrame, Series
    from xarray import Dataset

_SHOWN = 5
"""Places that a notebook shows, and ids that an error names."""
_NAMED = 10
"""Most places that a legend can tell apart: Matplotlib's colours repeat after ten."""
_DIMS = {0: (), 1: ("point",), 2: ("y", "x")}
"""Names of the dimensions of places in datasets."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LocalHorizons:
    """The horizons of places, in A equal steps of azimuth.

    The places have the shape ``...`` of the longitudes and latitudes that were given: none for two
    numbers, (N,) for two lists, (R, C) for a grid. As in an array, ``horizons[2]`` is the third
    place or row of places, and a loop takes one after another.

    Attributes
    ----------
    lon, lat : (...) float64
        Degrees (WGS 84).
    eye_elevation_m : (...) float64
        Metres above the DEM's datum.
    azimuth_deg : (..., A) float64
        Clockwise from true north; the same for every place.
    elevation_deg : (..., A) float32
        Elevation angle of the horizon; NaN at azimuths without data.
    distance_m : (..., A) float32
        Horizontal distance of the horizon; NaN at azimuths without data.
    flags : (..., A) uint8
        Bits: 1, the horizon lies on the border of the data; 2, a hole may hide higher terrain; 4,
        no data.
    surface_deg : (..., A) float32
        Elevation angle up to which trees and houses may rise, never below the horizon; NaN without
        a surface model.
    id : (...) str
        The name of each place, from ``ids`` or a file of places; empty without one.
    crs : pyproj.CRS
        The CRS of the longitudes and latitudes: WGS 84, or degrees on another world.
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
    crs: CRS = field(default_factory=lambda: WGS84)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the places."""
        return np.shape(self.lon)

    @property
    def size(self) -> int:
        """Number of places."""
        return math.prod(self.shape)

    def __len__(self) -> int:
        if not self.shape:
            raise TypeError("the horizon of one place has no length; its size is 1")
        return self.shape[0]

    def __bool__(self) -> bool:
        return self.size > 0

    def __iter__(self) -> Iterator[LocalHorizons]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, index: Any) -> LocalHorizons:
        return self._taken(np.arange(self.size).reshape(self.shape)[index])

    def ravel(self) -> LocalHorizons:
        """Return the places in one dimension (N,), row by row."""
        return self.reshape(self.size)

    def reshape(self, *shape: int) -> LocalHorizons:
        """Return the places in another shape, row by row."""
        count = len(self.shape)
        columns: dict[str, Any] = {
            name: np.reshape(values, (*shape, *np.shape(values)[count:]))
            for name, values in self._columns().items()
        }
        return replace(self, **columns)

    def sel(
        self, place_id: str | None = None, *, lon: float | None = None, lat: float | None = None
    ) -> LocalHorizons:
        """Return the place with an id, or the one nearest a position.

        Parameters
        ----------
        place_id : str, optional
        lon, lat : float, optional
            Degrees (WGS 84), instead of the id.

        Raises
        ------
        InputError
            No place or several have the id, the position is not in degrees, or both or neither of
            them are given.
        """
        if place_id is None and lon is not None and lat is not None:
            return self._taken(self._nearest(lon, lat))
        if lon is not None or lat is not None:
            raise InputError("give either the id of a place, or both lon and lat")
        ids = np.ravel(self.id)
        found = np.flatnonzero(ids == place_id)
        if len(found) != 1:
            known = ", ".join(dict.fromkeys(ids[ids != ""].tolist()[:_SHOWN])) or "none"
            raise InputError(
                f"{len(found)} of {self.size} places have the id {place_id!r} (ids: {known}); give "
                "one of the ids, or lon and lat of a position near the place"
            )
        return self._taken(found[0])

    def _nearest(self, lon: float, lat: float) -> int:
        """Return the index of the place nearest to a position."""
        refuse_text(lon=lon, lat=lat)
        if np.size(lon) != 1 or np.size(lat) != 1 or not are_degrees(lon, lat):
            raise InputError(
                f"lon and lat are {lon} and {lat}; expected one position in degrees, a latitude "
                "from -90 to 90"
            )
        at = np.full(self.size, lon), np.full(self.size, lat)
        geod = self.crs.get_geod()
        assert geod is not None
        return int(np.argmin(geod.inv(*at, self.lon.ravel(), self.lat.ravel())[2]))

    def _taken(self, numbers: Any) -> LocalHorizons:
        """Return places by their indices, in the shape of the indices."""
        columns = self.ravel()._columns()
        return replace(self, **{name: values[numbers] for name, values in columns.items()})

    def _columns(self) -> dict[str, Any]:
        """Return the attributes that have a row for each place."""
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name != "crs"}

    @property
    def _azimuths_deg(self) -> Float64Array:
        """The azimuths (A,) of every place."""
        return azimuths_deg(np.shape(self.azimuth_deg)[-1])

    @property
    def has_ids(self) -> bool:
        """True if the places have ids or names."""
        return bool((self.id != "").any())

    @property
    def has_surface(self) -> bool:
        """True if a surface model was given."""
        return not bool(np.isnan(self.surface_deg).all())

    def sky_view_factor(self, tilt_deg: float = 0.0, facing_deg: float = 180.0) -> Float64Array:
        """Return the sky view factors (...) of a surface; see `sky_view_factor`."""
        return sky_view_factor(self._azimuths_deg, self.elevation_deg, tilt_deg, facing_deg)

    def sun_above(self, day: date | str) -> list[Interval]:
        """Return when part of the sun's disc is above the place's horizon.

        If there are several places, take one first: ``horizons[0].sun_above(day)``.

        Parameters
        ----------
        day : date or str
            The 24 hours around noon of the mean sun at the eye; a text such as 2026-12-21.

        Returns
        -------
        list of (datetime, datetime)
            Beginnings and ends in UTC, to a tenth of a second. An interval shorter than a minute
            may be missed. Light is refracted as in the standard atmosphere at the eye's elevation.

        Raises
        ------
        InputError
            PyEphem is not installed, the DEM is of another world than the Earth, the horizon is
            unknown at some azimuth, there are several places, or the day is not a date from 1583 to
            9998.
        """
        return self._above(Body.SUN, day)

    def moon_above(self, day: date | str) -> list[Interval]:
        """Return when part of the moon's disc is above the horizon.

        The part may be dark. Parameters, times and errors are as in `sun_above`; the day is the
        sun's.
        """
        return self._above(Body.MOON, day)

    def sky(self) -> Sky:
        """Return the sky over the place.

        Raises `InputError` if PyEphem is not installed, the DEM is of another world than the Earth,
        or there are several places.
        """
        check_is_earth(self.crs)
        one = self._only
        return Sky(float(one.lon), float(one.lat), float(one.eye_elevation_m))

    def _above(self, body: Body, day: date | str) -> list[Interval]:
        check_is_earth(self.crs)
        one = self._only
        return above(
            day_of(day),
            body,
            lon=float(one.lon),
            lat=float(one.lat),
            eye_elevation_m=float(one.eye_elevation_m),
            azimuth_deg=one.azimuth_deg,
            elevation_deg=one.elevation_deg,
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw each place's horizon as a line over azimuth; return the axes.

        ``ax`` are Matplotlib axes to draw on; by default a new figure is made. An id that no
        installed font can draw is left out of the title, and a warning names it.
        """
        if ax is None:
            from matplotlib import pyplot  # noqa: PLC0415  (slow to load)

            ax = pyplot.subplots(figsize=(9, 3), layout="constrained")[1]
        if self.size == 1:
            self.ravel()[0]._fill(ax)
        else:
            self._draw_lines(ax)
        ax.set(xlim=(0.0, 360.0), xticks=range(0, 361, 45))
        ax.set(xlabel="azimuth from true north (degrees)", ylabel="elevation (degrees)")
        return ax

    def _fill(self, ax: Axes) -> None:
        """Draw one place's horizon."""
        foot_deg = min(0.0, float(np.nanmin(self.elevation_deg)))
        ax.fill_between(self.azimuth_deg, self.elevation_deg, foot_deg, color="0.75", linewidth=0.0)
        ax.plot(self.azimuth_deg, self.elevation_deg, color="black", linewidth=1.0)
        if self.has_surface:
            ax.plot(self.azimuth_deg, self.surface_deg, color="green", linewidth=1.0)
        ((name, families),) = _drawable([str(self.id)])
        ax.set_title(
            f"{name}: {self._place}" if name else self._place,
            fontfamily=families or None,
            parse_math=False,
        )

    def _draw_lines(self, ax: Axes) -> None:
        """Draw a line for each place, with a legend for a few."""
        lines = [
            ax.plot(one.azimuth_deg, one.elevation_deg, linewidth=1.0)[0] for one in self.ravel()
        ]
        if len(lines) > _NAMED:
            return
        drawable = _drawable([str(one) for one in self._labels()])
        legend = ax.legend(lines, [name for name, _ in drawable])
        for text, (_, families) in zip(legend.get_texts(), drawable, strict=True):
            text.set(parse_math=False, **({"fontfamily": families} if families else {}))

    @property
    def _place(self) -> str:
        """Describe one place in words."""
        return f"lon {self.lon:.5f}, lat {self.lat:.5f}, eye {self.eye_elevation_m:.0f} m"

    def _labels(self) -> list[str | int]:
        """Return the places' labels: their ids, or else their indices."""
        return list(np.ravel(self.id).tolist() if self.has_ids else range(self.size))

    def __repr__(self) -> str:
        steps = np.shape(self.azimuth_deg)[-1]
        places = " x ".join(map(str, self.shape)) + " places" if self.shape else self._place
        return f"LocalHorizons({places}, {steps} azimuths, {360.0 / steps:g} degrees apart)"

    def _repr_html_(self) -> str:
        from matplotlib.figure import Figure  # noqa: PLC0415  (slow to load)

        shown = io.StringIO()
        for place in self.ravel()[:_SHOWN]:
            figure = Figure(figsize=(9, 3), layout="constrained")
            place.plot(figure.subplots())
            figure.savefig(shown, format="svg")
        more = self.size - _SHOWN
        return shown.getvalue() + (f"<p>and {more} more places</p>" if more > 0 else "")

    @property
    def _only(self) -> LocalHorizons:
        """The only place; raises `InputError` if there are several."""
        if self.size != 1:
            raise InputError(
                f"there are {self.size} places; take one by its number or its id, as in "
                "horizons[0] and horizons.sel(...)"
            )
        return self.ravel()[0]

    def to_series(self) -> Series:
        """Return the elevations in the form of pvlib's `get_pvgis_horizon`.

        Returns
        -------
        pandas.Series
            ``horizon_elevation`` in degrees by ``horizon_azimuth`` in degrees from true north.
            Several places are indexed by ``place``, an id or number, and ``horizon_azimuth``:
            ``to_series().unstack("place")`` has a column for each.

        Raises
        ------
        InputError
            Pandas is not installed.
        """
        pandas = library("pandas", "a Series")
        elevation = np.ravel(self.elevation_deg).astype(np.float64)
        index = pandas.Index(self._azimuths_deg, name="horizon_azimuth")
        if self.size != 1:
            both = self._labels(), self._azimuths_deg
            index = pandas.MultiIndex.from_product(both, names=("place", "horizon_azimuth"))
        return pandas.Series(elevation, index, name="horizon_elevation")

    def to_dataframe(self) -> DataFrame:
        """Return a row for each place and azimuth, as ``skyline horizon`` does.

        Returns
        -------
        pandas.DataFrame
            ``id`` if the places have ids; ``lon``, ``lat``, ``azimuth_deg``, ``elevation_deg`` and
            ``distance_m``; with a surface model ``surface_deg``.

        Raises
        ------
        InputError
            Pandas is not installed.
        """
        steps = np.shape(self.azimuth_deg)[-1]
        of_places: dict[str, NDArray[Any]] = {"id": self.id} if self.has_ids else {}
        of_places |= {"lon": self.lon, "lat": self.lat}
        columns = {name: np.repeat(values, steps) for name, values in of_places.items()}
        names = "azimuth_deg", "elevation_deg", "distance_m", "surface_deg"
        for name in names if self.has_surface else names[:3]:
            columns[name] = getattr(self, name).ravel()
        return library("pandas", "a DataFrame").DataFrame(columns)

    def to_geodataframe(self) -> GeoDataFrame:
        """Return the places as points, one row each.

        Returns
        -------
        geopandas.GeoDataFrame
            Points in `crs`, WGS 84 on the Earth, with ``id`` if the places have ids, ``lon``,
            ``lat``, ``eye_elevation_m`` and the ``sky_view_factor`` of a level surface.

        Raises
        ------
        InputError
            GeoPandas is not installed.
        """
        geopandas = library("geopandas", "a GeoDataFrame")
        columns = {"id": np.ravel(self.id)} if self.has_ids else {}
        for name in ("lon", "lat", "eye_elevation_m"):
            columns[name] = np.ravel(getattr(self, name))
        columns["sky_view_factor"] = np.ravel(self.sky_view_factor())
        points = geopandas.points_from_xy(columns["lon"], columns["lat"])
        return geopandas.GeoDataFrame(columns, geometry=points, crs=self.crs)

    def to_xarray(self) -> Dataset:
        """Return the horizons as a dataset.

        Returns
        -------
        xarray.Dataset
            ``elevation_deg``, ``distance_m``, ``flags`` and, with a surface model, ``surface_deg``
            by the places' dimensions and ``azimuth_deg``; ``sky_view_factor`` of a level surface,
            ``lon``, ``lat``, ``eye_elevation_m`` and ``id`` by the places' dimensions: ``point``
            for a list of places, ``y`` and ``x`` for a grid, none for one place.

        Raises
        ------
        InputError
            Xarray is not installed.
        """
        xarray = library("xarray", "a Dataset")
        described = {
            "surface_deg": ("elevation angle up to which trees and houses may rise", DEGREES),
            "elevation_deg": ("elevation angle of the horizon", DEGREES),
            "distance_m": ("horizontal distance of the horizon", METRES),
        }
        count = len(self.shape)
        place = _DIMS.get(count, tuple(f"dim_{number}" for number in range(count)))
        dims = (*place, "azimuth_deg")
        data: Dataset = xarray.Dataset(
            {
                **{
                    name: (dims, getattr(self, name), {"long_name": long_name, **unit})
                    for name, (long_name, unit) in described.items()
                    if name != "surface_deg" or self.has_surface
                },
                "flags": (dims, self.flags, {"long_name": "1 border, 2 hole, 4 no data"}),
                "sky_view_factor": (place, self.sky_view_factor(), {"units": "1"}),
            },
            {
                "lon": (place, self.lon, LON),
                "lat": (place, self.lat, LAT),
                "eye_elevation_m": (place, self.eye_elevation_m, METRES),
                "id": (place, self.id),
                "azimuth_deg": ("azimuth_deg", self._azimuths_deg, TRUE_NORTH),
            },
        )
        return data


def _drawable(names: Sequence[str]) -> list[tuple[str, tuple[str, ...]]]:
    """Return names, or "" with a warning where no font draws one."""
    from skyline.fonts import fonts_for  # noqa: PLC0415  (slow to load)

    drawable = []
    for name, families in zip(names, fonts_for(names), strict=True):
        if not families:
            _log.warning("no installed font draws %s; the title of its horizon lacks it", name)
        drawable.append((name if families else "", families))
    return drawable


def azimuths_deg(steps: int) -> Float64Array:
    """Return equal steps (A,) of azimuth, from north on."""
    return np.asarray(np.arange(steps) * (360.0 / steps))

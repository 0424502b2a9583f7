"""The horizon round places that a person names: azimuths from true north, degrees, metres."""

from dataclasses import dataclass
from datetime import date, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.extras import library
from skyline.rows import Rows
from skyline.solar.sky_view import sky_view_factor
from skyline.solar.sun import sun_above

_DEGREES = {"units": "degrees"}


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

    def __len__(self) -> int:
        return len(self.lon)

    def sky_view_factor(self, tilt_deg: float = 0.0, facing_deg: float = 180.0) -> Float64Array:
        """Return the sky view factors (N,) of a surface; `skyline.solar.sky_view`."""
        return sky_view_factor(self.azimuth_deg[0], self.elevation_deg, tilt_deg, facing_deg)

    def sun_above(self, day: date, place: int = 0) -> list[tuple[datetime, datetime]]:
        """Return when the sun is above the horizon of one place; `skyline.solar.sun`."""
        eye = (float(self.lon[place]), float(self.lat[place]), float(self.eye_elevation_m[place]))
        return sun_above(self.azimuth_deg[place], self.elevation_deg[place], eye, day)

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
        round_about = ("point", "azimuth_deg")
        true_north = {"long_name": "azimuth, clockwise from true north", **_DEGREES}
        up_to = "elevation angle up to which trees and houses may rise"
        surface = (round_about, self.surface_deg, {"long_name": up_to, **_DEGREES})
        return xarray.Dataset(
            {
                **({"surface_deg": surface} if self.has_surface else {}),
                "elevation_deg": (
                    round_about,
                    self.elevation_deg,
                    {"long_name": "elevation angle of the horizon", **_DEGREES},
                ),
                "distance_m": (
                    round_about,
                    self.distance_m,
                    {"long_name": "horizontal distance of the horizon", "units": "m"},
                ),
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

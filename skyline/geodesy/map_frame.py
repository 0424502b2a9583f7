"""Map frames: positions in metres and degrees, north, and true angles.

Inside the program a position is (easting, northing) in one metric frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Geod, Transformer

from skyline.arrays import BoolArray, Complex128Array, Float64Array, by_dimensions, refuse_text
from skyline.errors import InputError
from skyline.geodesy.bounds import Bounds, Circle, check_bounds, width_deg
from skyline.geodesy.crs import (
    half_axes_m,
    is_metric,
    is_of_earth,
    lonlat_of,
    parse_crs,
    transformer,
    without_vertical,
)
from skyline.geodesy.earth import Curvature

Rectangle = tuple[float, float, float, float]
"""West, south, east, north in metres of a frame."""

TRUE_DEG = 0.05
"""Greatest error of an angle on a map that is used as a frame, in degrees. The best answers claim
0.1 degrees, which is also the noise of a photo's skyline; errors add as squares, so half as much
widens that by an eighth. UTM is off by 0.03 degrees on its zone's border at the equator. Warping a
truer map would move its summits by more than it gains."""

_EDGE_POINTS = 63
"""Points along each side of a box that is transformed to coordinates in which it is curved."""

_LOCAL = "local transverse Mercator"
"""The beginning of the names of local frames."""

_WGS84 = Geod(ellps="WGS84")


@dataclass(frozen=True, repr=False)
class Frame:
    """A metric map frame: the DEM's own CRS or a local one."""

    wkt: str
    """The CRS as well-known text."""

    def __repr__(self) -> str:
        return f"Frame({self.name})"

    @classmethod
    def from_crs(cls, crs: object) -> Frame:
        """Return the frame of anything that pyproj understands as a metric CRS.

        The vertical axis of a compound or three-dimensional CRS is left out. Raises `InputError`
        for anything else.
        """
        parsed = without_vertical(parse_crs(crs))
        if not is_metric(parsed):
            raise InputError(
                f"frame {parsed.name!r} is not metric; expected a projected CRS in metres whose "
                "axes point east and north"
            )
        return cls(parsed.to_wkt())

    @classmethod
    def local(cls, *, lon: float, lat: float, world: CRS | None = None) -> Frame:
        """Return the conformal transverse Mercator frame through a point.

        It is on WGS 84, or on the ellipsoid of ``world``, a CRS of another body than the Earth.
        """
        refuse_text(lon=lon, lat=lat)
        datum = "+ellps=WGS84 +datum=WGS84"
        if world is not None and not is_of_earth(world):
            datum = "+a={!r} +b={!r}".format(*half_axes_m(world))
        definition = CRS.from_proj4(
            f"+proj=tmerc +lat_0={lat:.9f} +lon_0={lon:.9f} +k=1 +x_0=0 +y_0=0 {datum} "
            "+units=m +no_defs"
        ).to_json_dict()
        definition["name"] = f"{_LOCAL} at {lat:.4f}, {lon:.4f}"
        return cls(CRS.from_json_dict(definition).to_wkt())

    @property
    def is_local(self) -> bool:
        """Whether `Frame.local` made the frame: the best one for an area."""
        return str(self.crs.name).startswith(_LOCAL)

    @cached_property
    def crs(self) -> CRS:
        """The frame as a pyproj CRS."""
        return without_vertical(CRS.from_wkt(self.wkt))

    @property
    def name(self) -> str:
        """The frame's code, such as EPSG:32632, or its name."""
        authority = self.crs.to_authority()
        return ":".join(authority) if authority else str(self.crs.name)

    @property
    def is_of_earth(self) -> bool:
        """Whether the frame is a map of the Earth."""
        return is_of_earth(self.crs)

    @property
    def curvature(self) -> Curvature:
        """The curvature of the frame's world.

        Other worlds than the Earth have the mean radius of their ellipsoid, and no refraction.
        """
        if self.is_of_earth:
            return Curvature()
        geod = self._geod
        return Curvature(radius_m=(2.0 * geod.a + geod.b) / 3.0, refraction_k=0.0)

    def curvature_or(self, given: Curvature | None) -> Curvature:
        """Return a given curvature, or the frame's.

        Raises `InputError` for anything but a curvature or None.
        """
        if given is None:
            return self.curvature
        if not isinstance(given, Curvature):
            raise InputError(
                f"curvature is {given!r}; expected a Curvature, as Curvature(refraction_k=0.13)"
            )
        return given

    @cached_property
    def _geod(self) -> Geod:
        if self.is_of_earth:
            return _WGS84
        a_m, b_m = half_axes_m(self.crs)
        return Geod(a=a_m, b=b_m)

    @cached_property
    def lonlat_crs(self) -> CRS:
        """The CRS of the frame's degrees: WGS 84, or another world's."""
        return lonlat_of(self.crs)

    @cached_property
    def _to_lonlat(self) -> Transformer:
        return transformer(self.crs, self.lonlat_crs)

    def to_lonlat(
        self, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return longitude and latitude (WGS 84, degrees) of map coordinates.

        On another world than the Earth they are on its own ellipsoid.
        """
        refuse_text(easting_m=easting_m, northing_m=northing_m)
        easting_m, northing_m = by_dimensions(easting_m, northing_m)
        lon, lat = self._to_lonlat.transform(easting_m, northing_m)
        return np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64)

    def geocentric_m(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return map coordinates (M,) as geocentric points (M, 3).

        At 30 km, a chord is a millionth shorter than the ground below it.
        """
        lon, lat = map(np.radians, self.to_lonlat(easting_m, northing_m))
        geod = self._geod
        across_m = geod.a / np.sqrt(1.0 - geod.es * np.sin(lat) ** 2)
        flat_m = across_m * np.cos(lat)
        up_m = across_m * (1.0 - geod.es) * np.sin(lat)
        return np.stack([flat_m * np.cos(lon), flat_m * np.sin(lon), up_m], axis=-1)

    def box_deg(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Bounds:
        """Return the box in degrees around the map rectangle of positions.

        A box around a pole has all longitudes, -180 to 180.
        """
        west, south, east, north = self._to_lonlat.transform_bounds(
            np.min(easting_m),
            np.min(northing_m),
            np.max(easting_m),
            np.max(northing_m),
            densify_pts=_EDGE_POINTS,
        )
        # The antimeridian is -180 as a west side and 180 as an east side.
        return -180.0 if west == 180.0 else west, south, 180.0 if east == -180.0 else east, north

    def from_lonlat(self, lon: ArrayLike, lat: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return easting and northing, metres, of longitudes and latitudes (WGS 84)."""
        refuse_text(lon=lon, lat=lat)
        lon, lat = by_dimensions(lon, lat)
        easting, northing = self._to_lonlat.transform(lon, lat, direction="INVERSE")
        return np.asarray(easting, dtype=np.float64), np.asarray(northing, dtype=np.float64)

    def rectangle_m(self, bounds_deg: Bounds) -> Rectangle:
        """Return the map rectangle around a box in degrees; raises as `check_bounds`."""
        west, south, _, north = check_bounds(bounds_deg)
        rectangle: Rectangle = self._to_lonlat.transform_bounds(
            west,
            south,
            west + width_deg(bounds_deg),
            north,
            densify_pts=_EDGE_POINTS,
            direction="INVERSE",
        )
        return rectangle

    def circle_m(self, circle: Circle) -> tuple[float, float, float]:
        """Return easting, northing and radius, metres, of a circle in degrees."""
        lon, lat, radius_km = circle
        easting_m, northing_m = self.from_lonlat(lon, lat)
        return float(easting_m), float(northing_m), 1000.0 * radius_km

    def convergence_deg(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return the grid convergence, degrees: true azimuth minus grid azimuth."""
        _, to_north = self._steps(easting_m, northing_m)
        return np.degrees(np.arctan2(0.0 - to_north.real, to_north.imag))

    def angle_error_deg(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return the greatest error of an angle on the map, by position.

        The angle is level or upright. A scale k in some direction divides the tangents of elevation
        angles there by k, which changes an angle of 45 degrees most.
        """
        to_east, to_north = self._steps(easting_m, northing_m)
        # Sum and difference of the half axes of Tissot's ellipse (Snyder 1987, 4-12 and 4-13).
        sums = np.abs(to_east - 1j * to_north)
        differences = np.abs(to_east + 1j * to_north)
        scales = np.stack([sums + differences, sums - differences]) / 2.0
        with np.errstate(invalid="ignore"):  # off the map
            level = 2.0 * np.arcsin(differences / sums)
            upright = np.arcsin(np.abs(scales - 1.0) / (scales + 1.0)).max(axis=0)
        return np.asarray(np.degrees(np.maximum(level, upright)))

    def untrue_deg(self, rectangle_m: Rectangle) -> float:
        """Return an angle's greatest error in a rectangle; 0 if acceptable.

        It is acceptable up to `TRUE_DEG`, or up to the error of a local frame, which is greater
        over areas too wide for any map.
        """
        if self.is_local:
            return 0.0
        west, south, east, north = rectangle_m
        easting, northing = np.meshgrid(np.linspace(west, east, 9), np.linspace(south, north, 9))
        error_deg = self._greatest_error_deg(easting, northing)
        if error_deg <= TRUE_DEG:
            return 0.0
        lon, lat = self.to_lonlat(easting, northing)
        middle = lon.size // 2
        local = Frame.local(lon=lon.flat[middle], lat=lat.flat[middle], world=self.crs)
        is_truer = local._greatest_error_deg(*local.from_lonlat(lon, lat)) < error_deg
        return error_deg if is_truer else 0.0

    def untrue_in_words(self, rectangle_m: Rectangle) -> str:
        """Return how far off angles are in a rectangle, or "" if acceptable."""
        error_deg = self.untrue_deg(rectangle_m)
        if not error_deg:
            return ""
        return (
            f"on the map of {self.name} slopes and directions are wrong by up to {error_deg:.2f} "
            "degrees"
        )

    def _greatest_error_deg(self, easting_m: Float64Array, northing_m: Float64Array) -> float:
        error_deg = self.angle_error_deg(easting_m=easting_m, northing_m=northing_m)
        return float(np.nanmax(np.append(error_deg, 0.0)))

    def scale(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return map metres per metre of ground, averaged over directions."""
        to_east, to_north = self._steps(easting_m, northing_m)
        return np.sqrt(np.abs((to_east.conj() * to_north).imag))

    def _steps(
        self, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Complex128Array, Complex128Array]:
        """Return the map steps of a metre of ground east and north.

        They are easting + i northing, from differences of positions on the ellipsoid, and hold for
        any datum, prime meridian and axes.
        """
        lon, lat = self.to_lonlat(easting_m, northing_m)
        # Half of the differences from which a projection's derivatives are computed, 11 m.
        step_deg = 1e-4
        # A pole has no north, and takes the north of a position a kilometre away.
        lat = np.clip(lat, -89.99, 89.99)
        lat_rad = np.radians(lat)
        lon_step = step_deg / np.cos(lat_rad)

        def step(lon_deg: Float64Array | float, lat_deg: float) -> Complex128Array:
            start = self.from_lonlat(lon - lon_deg, lat - lat_deg)
            east, north = np.subtract(self.from_lonlat(lon + lon_deg, lat + lat_deg), start)
            return np.asarray((east + 1j * north) / math.radians(2.0 * step_deg))

        with np.errstate(invalid="ignore"):  # off the map
            eastward = step(lon_step, 0.0)
            northward = step(0.0, step_deg)
        # The radii of curvature across the meridian and along it.
        geod = self._geod
        root = 1.0 - geod.es * np.sin(lat_rad) ** 2
        across_m = geod.a / np.sqrt(root)
        along_m = across_m * (1.0 - geod.es) / root
        return eastward / across_m, northward / along_m


def in_rectangle(rectangle_m: Rectangle, easting_m: ArrayLike, northing_m: ArrayLike) -> BoolArray:
    """Return which positions lie in a rectangle or on its sides."""
    west, south, east, north = rectangle_m
    easting = np.asarray(easting_m)
    northing = np.asarray(northing_m)
    return (west <= easting) & (easting <= east) & (south <= northing) & (northing <= north)


def geodesic_m(lon: float, lat: float, other_lon: float, other_lat: float) -> float:
    """Return the distance of two places on the Earth, metres."""
    return float(_WGS84.inv(lon, lat, other_lon, other_lat)[2])

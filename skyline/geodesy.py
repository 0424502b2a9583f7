"""Map frames: which way is north, where is this in degrees, how far does the Earth drop.

Inside the program a location is (easting, northing) in one metric frame and azimuths are from
grid north. Whatever a person reads is in degrees of WGS 84 and from true north.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj, Transformer
from pyproj.exceptions import CRSError

from skyline.arrays import Float64Array
from skyline.errors import InputError

EARTH_RADIUS_M = 6371008.8
DEFAULT_REFRACTION_K = 0.13


@dataclass(frozen=True)
class Curvature:
    """How far the surface drops below the eye's tangent plane, refraction included.

    Attributes
    ----------
    radius_m : float
        Radius of the planet.
    refraction_k : float
        Fraction of the curvature that refraction takes back; 0.13 is usual by day.
    enabled : bool
        False leaves the plane flat.
    """

    radius_m: float = EARTH_RADIUS_M
    refraction_k: float = DEFAULT_REFRACTION_K
    enabled: bool = True

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius_m) and self.radius_m > 0.0):
            raise InputError(
                f"planet radius is {self.radius_m} m; expected a positive number of metres"
            )
        if not (np.isfinite(self.refraction_k) and -1.0 <= self.refraction_k < 1.0):
            raise InputError(
                f"refraction k is {self.refraction_k}; expected -1 <= k < 1 (0.13 is usual)"
            )

    @property
    def drop_per_m2(self) -> float:
        """The drop is ``drop_per_m2 * d**2``, d the horizontal distance: (1 - k) / (2 R)."""
        return (1.0 - self.refraction_k) / (2.0 * self.radius_m) if self.enabled else 0.0

    def drop_m(self, distance_m: ArrayLike) -> Float64Array:
        """Return the drop in metres at horizontal distances in metres, same shape."""
        return self.drop_per_m2 * np.square(np.asarray(distance_m, dtype=np.float64))


Rectangle = tuple[float, float, float, float]
"""West, south, east, north in metres of a frame."""

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees; west above east means a box across the antimeridian."""


def check_bounds(bounds_deg: Bounds) -> Bounds:
    """Return bounds; `InputError` where they are not W,S,E,N with S < N."""
    west, south, east, north = bounds_deg
    if not are_bounds(*bounds_deg):
        hint = ""
        if are_bounds(south, west, north, east):
            hint = f"; {swapped_in_words(*bounds_deg)}"
        raise InputError(
            f"bounds are {west},{south},{east},{north}; expected W,S,E,N in degrees with S < N"
            + hint
        )
    return bounds_deg


def are_bounds(west: float, south: float, east: float, north: float) -> bool:
    """Whether numbers can be the bounds of a box in degrees."""
    return bool(
        np.isfinite([west, south, east, north]).all()
        and -90.0 <= south < north <= 90.0
        and -180.0 <= west <= 180.0
        and -180.0 <= east <= 180.0
        and west != east
    )


def swapped_in_words(*given: float, names: str = "longitude and latitude") -> str:
    """Return the suspicion that the coordinates of places were given in the wrong order.

    The right order is shown: of each pair of numbers the second first.
    """
    right = ",".join(
        f"{second:.10g},{first:.10g}" for first, second in zip(given[::2], given[1::2], strict=True)
    )
    return f"{names} seem to be swapped: give {right}"


def degrees_in_words(value: float, names: str, decimals: int = 5) -> str:
    """Return a longitude or latitude without a sign, with one of two names such as EW instead."""
    return f"{abs(value):.{decimals}f}° {names[0] if value >= 0.0 else names[1]}"


def is_metric(crs: CRS) -> bool:
    """Whether a CRS is projected and in metres, so that it can be a frame."""
    units = [axis.unit_conversion_factor for axis in crs.axis_info[:2]]
    return bool(crs.is_projected and np.allclose(units, 1.0, rtol=0.0, atol=1e-9))


def parse_crs(crs: object) -> CRS:
    """Return the CRS of anything pyproj understands; raises `InputError` for what it does not."""
    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(
            f"coordinate reference system {crs!r} is not understood "
            f"({' '.join(str(error).split())}); give an EPSG code such as EPSG:32632 or WKT"
        ) from error


@dataclass(frozen=True)
class Frame:
    """A metric map frame: the DEM's own CRS, or a local conformal one centred on the area."""

    wkt: str

    @classmethod
    def from_crs(cls, crs: object) -> "Frame":
        """Make a frame of anything pyproj understands; raises `InputError` unless metric."""
        parsed = parse_crs(crs)
        if not is_metric(parsed):
            raise InputError(
                f"frame {parsed.name!r} is not metric; a projected CRS in metres is needed"
            )
        return cls(parsed.to_wkt())

    @classmethod
    def local(cls, lon_deg: float, lat_deg: float) -> "Frame":
        """Make the local conformal frame: transverse Mercator on WGS 84 through a point."""
        definition = CRS.from_proj4(
            f"+proj=tmerc +lat_0={lat_deg:.9f} +lon_0={lon_deg:.9f} +k=1 +x_0=0 +y_0=0 "
            "+ellps=WGS84 +datum=WGS84 +units=m +no_defs"
        ).to_json_dict()
        definition["name"] = f"local transverse Mercator at {lat_deg:.4f}, {lon_deg:.4f}"
        return cls(CRS.from_json_dict(definition).to_wkt())

    @cached_property
    def crs(self) -> CRS:
        """The frame as a pyproj CRS."""
        return CRS.from_wkt(self.wkt)

    @property
    def name(self) -> str:
        """The name a person knows the frame by."""
        authority = self.crs.to_authority()
        return ":".join(authority) if authority else str(self.crs.name)

    @cached_property
    def _to_lonlat(self) -> Transformer:
        return Transformer.from_crs(self.crs, "EPSG:4326", always_xy=True)

    @cached_property
    def _projection(self) -> Proj:
        return Proj(self.crs)

    def to_lonlat(
        self, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return longitude and latitude in degrees (WGS 84) of map coordinates in metres."""
        lon, lat = self._to_lonlat.transform(easting_m, northing_m)
        return np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64)

    def box_deg(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Bounds:
        """Return the box in degrees around places; none lies across the antimeridian."""
        lon, lat = self.to_lonlat(easting_m, northing_m)
        return float(lon.min()), float(lat.min()), float(lon.max()), float(lat.max())

    def from_lonlat(
        self, lon_deg: ArrayLike, lat_deg: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return easting and northing in metres of longitudes and latitudes (WGS 84)."""
        easting, northing = self._to_lonlat.transform(lon_deg, lat_deg, direction="INVERSE")
        return np.asarray(easting, dtype=np.float64), np.asarray(northing, dtype=np.float64)

    def rectangle_m(self, bounds_deg: Bounds) -> Rectangle:
        """Return west, south, east, north in metres of the rectangle around a box in degrees.

        The box W, S, E, N is a curved quadrangle on the map. West above east means a box across
        the antimeridian.

        Raises
        ------
        InputError
            Bounds that are not numbers in order.
        """
        west, south, east, north = check_bounds(bounds_deg)
        rectangle: Rectangle = self._to_lonlat.transform_bounds(
            west, south, west + (east - west) % 360.0, north, densify_pts=31, direction="INVERSE"
        )
        return rectangle

    def convergence_deg(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return grid convergence: true azimuth = grid azimuth + convergence, degrees."""
        return self._factor("meridian_convergence", easting_m, northing_m)

    def angular_distortion_deg(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return the greatest distortion of an angle at each location; 0 where conformal."""
        return self._factor("angular_distortion", easting_m, northing_m)

    def scale(self, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return map metres per metre on the ground at each location, mean over directions."""
        return np.sqrt(self._factor("areal_scale", easting_m, northing_m))

    def _factor(self, name: str, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        lon, lat = self._projection(easting_m, northing_m, inverse=True)
        factors = self._projection.get_factors(np.asarray(lon), np.asarray(lat))
        return np.asarray(getattr(factors, name), dtype=np.float64)

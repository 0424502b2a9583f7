"""Map frames: positions in metres and degrees, the direction of north, the Earth's curvature.

Inside the program a position is (easting, northing) in one metric frame and azimuths are from grid
north. People read degrees of WGS 84, and azimuths from true north.
"""

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Geod, Transformer
from pyproj.exceptions import CRSError, ProjError

from skyline.arrays import Complex128Array, Float64Array
from skyline.errors import InputError, numbers_of, swapped_in_words

EARTH_RADIUS_M = 6371008.8
"""The mean radius of the Earth."""

DEFAULT_REFRACTION_K = 0.13
"""The share of the Earth's curvature that refraction usually compensates by day."""

GROUND_M = (-500.0, 9000.0)
"""Lowest and highest ground on Earth, with a margin: Dead Sea -430 m, Everest 8849 m."""

TRUE_DEG = 0.05
"""Greatest error of an angle on a map that is used as a frame, in degrees. The best answers claim
0.1 degrees, as does the noise of a photo's skyline; errors add as squares, so half as much widens
that by an eighth. UTM is off by 0.03 degrees on its zone's border at the equator. Warping a map
that is nearer the truth would move its summits by more than it gains."""

_EDGE_POINTS = 63
"""Points along each side of a box that is transformed to other coordinates, where it is curved."""
_LOCAL = "local transverse Mercator"
"""The beginning of the names of local frames."""
_WGS84 = Geod(ellps="WGS84")
_STEP_DEG = 1e-4
"""Step of latitude, 11 m: half of the differences from which a projection's derivatives are
computed."""


@dataclass(frozen=True)
class Curvature:
    """Drop of the surface below the eye's tangent plane, refraction included.

    Attributes
    ----------
    radius_m : float
        Radius of the planet.
    refraction_k : float
        Fraction of the curvature that refraction compensates; 0.13 is usual by day.
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
        """The drop at a metre's distance, (1 - k) / (2 R).

        The drop grows with the square of the distance.
        """
        return (1.0 - self.refraction_k) / (2.0 * self.radius_m) if self.enabled else 0.0

    def drop_m(self, distance_m: ArrayLike) -> Float64Array:
        """Return the drop in metres at horizontal distances in metres, same shape."""
        return self.drop_per_m2 * np.square(np.asarray(distance_m, dtype=np.float64))


Rectangle = tuple[float, float, float, float]
"""West, south, east, north in metres of a frame."""

Bounds = tuple[float, float, float, float]
"""West, south, east, north in degrees; west above east means a box across the antimeridian."""


def check_bounds(bounds_deg: Bounds) -> Bounds:
    """Return bounds as floats.

    Raises `InputError` unless they are W,S,E,N with S < N.
    """
    error = f"bounds are {bounds_deg!r}; expected four numbers W,S,E,N in degrees"
    west, south, east, north = bounds_deg = numbers_of(bounds_deg, 4, error)  # type: ignore[assignment]
    if not are_bounds(*bounds_deg):
        is_swapped = are_bounds(south, west, north, east)
        hint = f"; {swapped_in_words(*bounds_deg)}" if is_swapped else ""
        raise InputError(
            f"bounds are {west},{south},{east},{north}; expected W,S,E,N in degrees, longitudes "
            f"from -180 to 180, S < N, and W > E only across the antimeridian{hint}"
        )
    return bounds_deg


def are_bounds(west: float, south: float, east: float, north: float) -> bool:
    """Return whether numbers can be the bounds of a box in degrees.

    A box with W > E crosses the antimeridian, and is at most half a turn wide: W and E of a wider
    one were swapped.
    """
    return (
        -90.0 <= south < north <= 90.0
        and -180.0 <= west <= 180.0
        and -180.0 <= east <= 180.0
        and 0.0 < width_deg((west, south, east, north)) <= (360.0 if west < east else 180.0)
    )


def are_degrees(lon: float, lat: float) -> bool:
    """Return whether two numbers can be a longitude and a latitude."""
    return -180.0 <= lon <= 360.0 and -90.0 <= lat <= 90.0


def width_deg(bounds_deg: Bounds) -> float:
    """Return the width of a box in degrees of longitude.

    The result is 360 where the box goes all the way round.
    """
    west, _, east, _ = bounds_deg
    return east - west if west <= east else east - west + 360.0


def in_turn(angle_deg: ArrayLike, about_deg: float = 0.0) -> Float64Array:
    """Return angles within half a turn of another angle.

    By default they are in [-180, 180).
    """
    least_deg = about_deg - 180.0
    return (np.asarray(angle_deg, dtype=np.float64) - least_deg) % 360.0 + least_deg


def degrees_in_words(value: float, names: str, decimals: int = 5) -> str:
    """Return a longitude or a latitude in words, without a sign.

    ``names`` are the letters, ``EW`` or ``NS``.
    """
    value = float(in_turn(value))
    return f"{abs(value):.{decimals}f}° {names[0] if value >= 0.0 else names[1]}"


def distance_in_words(distance_m: float) -> str:
    """Return a distance in metres, or in kilometres from 10 km on."""
    if distance_m < 10_000.0:
        return f"{distance_m:.0f} m"
    return f"{distance_m / 1000.0:,.0f} km"


def is_upright(crs: CRS) -> bool:
    """Return whether a CRS's map is neither mirrored nor upside down.

    Both axes of a polar projection point north, or both south.
    """
    directions = {axis.direction for axis in crs.axis_info[:2]}
    return directions in ({"east", "north"}, {"north"}, {"south"})


def is_metric(crs: CRS) -> bool:
    """Return whether a CRS can be a frame.

    It can if it is projected, in metres and upright.
    """
    units = [axis.unit_conversion_factor for axis in crs.axis_info[:2]]
    metres = np.allclose(units, 1.0, rtol=0.0, atol=1e-9)
    return bool(crs.is_projected and metres and is_upright(crs))


def without_vertical(crs: CRS) -> CRS:
    """Return a CRS without its vertical axis, if it has one."""
    return crs.to_2d() if len(crs.axis_info) > 2 else crs


def parse_crs(crs: object) -> CRS:
    """Return the CRS of anything that pyproj understands; raises `InputError` otherwise."""
    try:
        return CRS.from_user_input(crs)
    except CRSError as error:
        raise InputError(
            f"coordinate reference system {crs!r} is not understood "
            f"({' '.join(str(error).split())}); give an EPSG code such as EPSG:32632 or WKT"
        ) from error


def transformer(source: CRS, target: CRS) -> Transformer:
    """Return the transformation of x and y between two CRS.

    The order of x and y is the order in raster files. Raises `InputError` where PROJ knows none, as
    for the CRS of another planet.
    """
    try:
        return Transformer.from_crs(source, target, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"PROJ cannot transform coordinates of {source.name!r} to {target.name!r} "
            f"({' '.join(str(error).split())}); give a DEM in another CRS of the Earth"
        ) from error


def to_wgs84(crs: CRS, x: float, y: float) -> tuple[float, float, str]:
    """Return longitude, latitude and their accuracy in words.

    The point is given in a CRS, and the result is on WGS 84.
    """
    transformation = transformer(crs, CRS.from_epsg(4326))
    lon, lat = transformation.transform(x, y)
    with suppress(ProjError):  # There may be only one operation.
        transformation = transformation.get_last_used_operation()
    steps = transformation.description.split(" + ")
    how = " + ".join(step for step in steps if not step.startswith("axis order change"))
    if "Ballpark" in how:
        how += "; PROJ knows no better one here, and places may be off by some 100 m"
    elif transformation.accuracy >= 0.0:
        how += f"; good to {transformation.accuracy:g} m"
    return float(lon), float(lat), how


def off_area_deg(crs: CRS, lon_deg: float, lat_deg: float) -> float:
    """Return the degrees by which a position lies outside a CRS's area.

    It is 0 where the area is not known.
    """
    authority = crs.to_authority()
    area = CRS.from_authority(*authority).area_of_use if authority else None
    if area is None:
        return 0.0
    width = (area.east - area.west) % 360.0 or 360.0
    past_west = (lon_deg - area.west) % 360.0
    aside = max(0.0, min(past_west - width, 360.0 - past_west))
    aside *= math.cos(math.radians(lat_deg))
    return max(area.south - lat_deg, lat_deg - area.north, aside, 0.0)


@dataclass(frozen=True)
class Frame:
    """A metric map frame: the DEM's own CRS, or a local conformal one centred on the area."""

    wkt: str
    """The CRS as well-known text."""

    @classmethod
    def from_crs(cls, crs: object) -> "Frame":
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
    def local(cls, *, lon: float, lat: float) -> "Frame":
        """Return the transverse Mercator frame on WGS 84 through a point.

        The frame is conformal.
        """
        definition = CRS.from_proj4(
            f"+proj=tmerc +lat_0={lat:.9f} +lon_0={lon:.9f} +k=1 +x_0=0 +y_0=0 "
            "+ellps=WGS84 +datum=WGS84 +units=m +no_defs"
        ).to_json_dict()
        definition["name"] = f"{_LOCAL} at {lat:.4f}, {lon:.4f}"
        return cls(CRS.from_json_dict(definition).to_wkt())

    @property
    def is_local(self) -> bool:
        """Whether the frame is one of `Frame.local`, the best there is for an area."""
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

    @cached_property
    def _to_lonlat(self) -> Transformer:
        return transformer(self.crs, CRS.from_epsg(4326))

    def to_lonlat(
        self, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Float64Array, Float64Array]:
        """Return longitude and latitude (WGS 84, degrees) of map coordinates."""
        lon, lat = self._to_lonlat.transform(easting_m, northing_m)
        return np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64)

    def box_deg(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Bounds:
        """Return the box in degrees around the map rectangle of positions.

        Around a rectangle that holds a pole, the box has all longitudes, -180 to 180.
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
        """Return easting and northing in metres of longitudes and latitudes (WGS 84)."""
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

    def convergence_deg(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return grid convergence: true azimuth = grid azimuth + convergence, degrees."""
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
        """Return the greatest error of an angle in a rectangle.

        The result is 0 where the frame may be used. A frame may be used where its error is at most
        `TRUE_DEG`, or no greater than the error of a local frame, as over areas that are too wide
        for any map.
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
        local = Frame.local(lon=lon.flat[middle], lat=lat.flat[middle])
        is_truer = local._greatest_error_deg(*local.from_lonlat(lon, lat)) < error_deg
        return error_deg if is_truer else 0.0

    def _greatest_error_deg(self, easting_m: Float64Array, northing_m: Float64Array) -> float:
        error_deg = self.angle_error_deg(easting_m=easting_m, northing_m=northing_m)
        return float(np.nanmax(np.append(error_deg, 0.0)))

    def scale(self, *, easting_m: ArrayLike, northing_m: ArrayLike) -> Float64Array:
        """Return map metres per metre of ground at each position.

        The scale is the mean over directions.
        """
        to_east, to_north = self._steps(easting_m, northing_m)
        return np.sqrt(np.abs((to_east.conj() * to_north).imag))

    def _steps(
        self, easting_m: ArrayLike, northing_m: ArrayLike
    ) -> tuple[Complex128Array, Complex128Array]:
        """Return the map steps of a metre of ground east, and north.

        A step is easting + i northing. They are differences of positions on WGS 84, and hold for
        any datum, prime meridian and axes.
        """
        lon, lat = self.to_lonlat(easting_m, northing_m)
        # A pole has no north, and takes the north of a position a kilometre away.
        lat = np.clip(lat, -89.99, 89.99)
        lat_rad = np.radians(lat)
        lon_step = _STEP_DEG / np.cos(lat_rad)

        def step(lon_deg: Float64Array | float, lat_deg: float) -> Complex128Array:
            start = self.from_lonlat(lon - lon_deg, lat - lat_deg)
            east, north = np.subtract(self.from_lonlat(lon + lon_deg, lat + lat_deg), start)
            return np.asarray((east + 1j * north) / math.radians(2.0 * _STEP_DEG))

        with np.errstate(invalid="ignore"):  # off the map
            eastward = step(lon_step, 0.0)
            northward = step(0.0, _STEP_DEG)
        # The radii of curvature across the meridian and along it.
        root = 1.0 - _WGS84.es * np.sin(lat_rad) ** 2
        across_m = _WGS84.a / np.sqrt(root)
        along_m = across_m * (1.0 - _WGS84.es) / root
        return eastward / across_m, northward / along_m


def lonlat_rings(outline_m: Float64Array, frame: Frame) -> list[Float64Array]:
    """Return an outline in degrees as rings cut at the antimeridian.

    RFC 7946 (3.1.9) requires the cut; without it a map draws the shape around the world. The
    outline (P, 2) is closed, without a pole inside. The rings (Q, 2) are closed and oriented as the
    outline is; longitudes are from -180 to 180.
    """
    lon, lat = frame.to_lonlat(*outline_m.T)
    lon = np.unwrap(lon, period=360.0)
    lon[-1] = lon[0]  # to the bit
    # A corner on the antimeridian, up to rounding, is moved to one side of it.
    rounding_deg = 1e-9
    on_edge = np.abs((lon % 360.0) - 180.0) < rounding_deg
    ring = np.stack([lon + 2.0 * rounding_deg * on_edge, lat], axis=1)
    rings = _cut_at(ring, float(np.copysign(180.0, lon[0])))
    for ring in rings:
        middle = 0.5 * (ring[:, 0].min() + ring[:, 0].max())
        ring[:, 0] -= 360.0 * round(middle / 360.0)
    return rings


def _cut_at(ring: Float64Array, edge: float) -> list[Float64Array]:
    """Return the parts of a ring on both sides of a longitude.

    A ring on one side is the only part.
    """
    count = len(ring) - 1
    is_east = ring[:-1, 0] > edge
    crossed = np.flatnonzero(is_east != np.roll(is_east, -1))
    if not len(crossed):
        return [ring]
    start = ring[crossed]
    step = ring[crossed + 1] - start
    on_edge = start + step * ((edge - start[:, :1]) / step[:, :1])
    on_edge[:, 0] = edge
    # Crossings split the ring into chains. From south to north, the edge lies inside between each
    # pair of crossings, so a chain continues along it to the chain that begins at the other one.
    after = np.roll(np.arange(len(crossed)), -1)
    chains = []
    for at, to in enumerate(after):
        inner = np.arange(crossed[at] + 1, crossed[to] + 1 + (count if to <= at else 0)) % count
        chains.append(np.concatenate([on_edge[[at]], ring[inner], on_edge[[to]]]))
    order = np.argsort(on_edge[:, 1])
    goes_on = np.empty_like(order)
    goes_on[order[::2]] = order[1::2]
    goes_on[order[1::2]] = order[::2]
    parts = []
    left = set(range(len(chains)))
    while left:
        chain = first = min(left)
        joined = []
        while chain in left:
            left.remove(chain)
            joined.append(chains[chain])
            chain = int(goes_on[after[chain]])
        parts.append(np.concatenate([*joined, chains[first][:1]]))
    # A part narrower than 2 cm is dropped.
    return [part for part in parts if np.ptp(part[:, 0]) > 2e-7]

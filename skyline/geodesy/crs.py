"""Coordinate reference systems (CRS), and transformations between them."""

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from skyline.errors import InputError, one_line, printable
from skyline.geodesy.earth import EQUATOR_RADIUS_M

WGS84 = CRS.from_epsg(4326)
_MODERN_M = 10.0
"""Greatest difference between the axes of WGS 84 and those of other ellipsoids round the middle of
the Earth. Bessel's, Clarke's and others, whose datums lie 100 m and more aside, differ by more."""


def is_upright(crs: CRS) -> bool:
    """Return whether a CRS's map is neither mirrored nor upside down.

    In a polar projection, both axes may point north, or both south.
    """
    directions = {axis.direction for axis in crs.axis_info[:2]}
    return directions in ({"east", "north"}, {"north"}, {"south"})


def is_metric(crs: CRS) -> bool:
    """Return whether a CRS is projected, in metres and upright."""
    units = [axis.unit_conversion_factor for axis in crs.axis_info[:2]]
    metres = np.allclose(units, 1.0, rtol=0.0, atol=1e-9)
    return bool(crs.is_projected and metres and is_upright(crs))


def without_vertical(crs: CRS) -> CRS:
    """Return a CRS without its vertical axis, if it has one."""
    return crs.to_2d() if len(crs.axis_info) > 2 else crs


def half_axes_m(crs: CRS) -> tuple[float, float]:
    """Return the semi-axes of a CRS's ellipsoid, by default WGS 84's."""
    ellipsoid = crs.ellipsoid or WGS84.ellipsoid
    assert ellipsoid is not None
    return float(ellipsoid.semi_major_metre), float(ellipsoid.semi_minor_metre)


def other_world_in_words(crs: CRS) -> str:
    """Return how a message names a world that is not the Earth."""
    return f"another world, of {half_axes_m(crs)[0] / 1e3:.0f} km radius"


def is_of_earth(crs: CRS) -> bool:
    """Return whether a CRS is of the Earth, or names no ellipsoid.

    Ellipsoids and spheres of the Earth differ by less than 0.2 %; no other body has one so similar.
    """
    return abs(half_axes_m(crs)[0] / EQUATOR_RADIUS_M - 1.0) < 0.005


def lonlat_of(crs: CRS) -> CRS:
    """Return the CRS of longitudes and latitudes on another CRS's body.

    It is WGS 84 for the Earth. Longitudes count to the east from the prime meridian of the body.
    """
    if is_of_earth(crs):
        return WGS84
    a_m, b_m = half_axes_m(crs)
    return CRS.from_dict({"proj": "longlat", "a": a_m, "b": b_m, "no_defs": True})


def parse_crs(crs: object) -> CRS:
    """Return the CRS of anything that pyproj understands; raises `InputError` otherwise."""
    try:
        return CRS.from_user_input(crs)
    except (CRSError, UnicodeEncodeError) as error:
        raise InputError(
            f"coordinate reference system {crs!r} is not understood "
            f"({one_line(error)}); give an EPSG code such as EPSG:32632 or WKT"
        ) from error


def crs_of_positions(path: object, named: Any) -> CRS:
    """Return the CRS that a file of positions names, or WGS 84.

    The name may stand alone, or in GeoJSON's member ``crs`` of 2008: ``name`` with the CRS's name,
    or ``EPSG`` with its code. Raises `InputError` for any other, and for a CRS that is neither
    geographic nor projected.
    """
    if named is None:
        return WGS84
    about = named.get("properties") if isinstance(named, Mapping) else {"name": named}
    about = about if isinstance(about, Mapping) else {}
    name = about.get("name", f"EPSG:{about['code']}" if "code" in about else None)
    try:
        crs = CRS.from_user_input(str(name))
    except (CRSError, UnicodeEncodeError):
        raise InputError(
            f"{path} names the CRS {printable(str(name or named))[:60]}, which is not known; write "
            "the coordinates in degrees (WGS 84)"
        ) from None
    if not (crs.is_geographic or crs.is_projected):
        raise InputError(
            f"{path} names {printable(crs.name)}, a {crs.type_name}; expected a geographic or "
            "projected CRS: write the coordinates in degrees (WGS 84)"
        )
    return crs


def transformer(source: CRS, target: CRS) -> Transformer:
    """Return the transformation between two CRS.

    Coordinates are x and y, in the order of raster files. Raises `InputError` if PROJ knows none,
    as between the Earth and another world.
    """
    try:
        return Transformer.from_crs(source, target, always_xy=True)
    except ProjError as error:
        raise InputError(
            f"PROJ cannot transform coordinates of {source.name!r} to {target.name!r} "
            f"({one_line(error)}); give a DEM in another CRS of the Earth"
        ) from error


def is_unplaced(crs: CRS, to_wgs84: str) -> bool:
    """Return whether PROJ knows no way from a CRS to WGS 84.

    ``to_wgs84`` is the way in words. PROJ takes a datum that it does not know for WGS 84. That is
    right for modern ellipsoids and for the spheres of weather models; others are some 100 m off.
    """
    off_m = np.abs(np.subtract(half_axes_m(crs), half_axes_m(WGS84)))
    is_sphere = len(set(half_axes_m(crs))) == 1
    return "Ballpark" in to_wgs84 and not is_sphere and bool(off_m.max() > _MODERN_M)


def to_wgs84(crs: CRS, x: float, y: float) -> tuple[float, float, str]:
    """Return a point's longitude, latitude and accuracy in words.

    They are in WGS 84, or on the CRS's own body.
    """
    transformation = transformer(crs, lonlat_of(crs))
    lon, lat = transformation.transform(x, y)
    if not is_of_earth(crs):
        return float(lon), float(lat), "none: positions are on the ellipsoid of another world"
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
    """Return how far a position lies outside a CRS's area, in degrees.

    The result is 0 where the area is not known.
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

"""Units, datums, axes and prime meridian of a raster of heights.

Conventions that a file names are used; others are assumed, or asked for where that matters.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from pyproj import CRS
from pyproj.database import get_units_map

from skyline.errors import InputError
from skyline.geodesy.bounds import degrees_in_words
from skyline.geodesy.crs import half_axes_m, is_of_earth

GEOID = "geoid"
ELLIPSOID = "ellipsoid"

_UNSAID = {"", "no", "none", "unknown", "unspecified"}
"""Band units that name no unit; ``NO`` is ArcInfo's."""

SAME_UNIT = 1e-4
"""Units whose lengths differ by a smaller share are the same: the feet of all surveys, and the
German legal metre."""

UNNAMED = "metre, assumed: neither the band nor the CRS names a unit"
"""`Vertical.unit` where nothing names a unit."""

_WORDS = {
    "ft": ["foot"],
    "feet": ["foot"],
    "inches": ["inch"],
    "survey": ["us"],
    "ftus": ["us", "foot"],
    "usft": ["us", "foot"],
    "legal": [],
    "statute": [],
    "international": [],
    "intl": [],
}
"""Words in the names of units and their replacements; none for a word without meaning."""

_DATUM = re.compile(r"\(|\babove\b|a\.?m?\.?s\.?l\b|ü|\b(?:msl|navd|ngvd|nhn|nap|egm)")
"""Where the datum begins after a unit, as in ``m (NAVD88)`` and ``metres above sea level``."""


@dataclass(frozen=True, slots=True)
class Vertical:
    """The unit, the direction and the datum of a raster's heights."""

    metres_per_unit: float
    """A value times this is a height in metres; it is negative for depths."""
    unit: str
    """Name of the unit, and where it comes from."""
    datum: str
    """Name of the vertical CRS, or of the datum of an ellipsoid; empty if none is named."""
    reference: str
    """`GEOID` or `ELLIPSOID`, from which heights are measured; empty if no datum is named."""
    assumed: str
    """The surface from which heights are assumed to be measured if no datum is named, in words."""
    notes: tuple[str, ...]
    """Sentences on what was assumed, to follow the name of the file and a colon."""

    @property
    def conventions(self) -> dict[str, str]:
        """The unit and the datum by name, in words."""
        datum = f"{self.datum} ({self.reference})"
        assumed = f"{self.assumed}, assumed: none is named"
        return {"height_unit": self.unit, "vertical_datum": datum if self.datum else assumed}


def metres_per(unit: str) -> float | None:
    """Return the metres of a length unit, or None if unknown.

    The unit is one of PROJ or EPSG, in the spelling of GDAL, ESRI or CF.
    """
    for name in (unit, _DATUM.split(unit.casefold())[0]):
        metres = _units().get(_key(name))
        if metres is not None:
            return metres
    return None


@cache
def _units() -> Mapping[frozenset[str], float]:
    """Return the metres of PROJ's length units by their names' words."""
    metres = {
        _key(name): unit.conv_factor
        for unit in get_units_map(category="linear").values()
        for name in filter(None, (unit.proj_short_name, unit.name))
    }
    # PROJ takes a decimetre for 0.01 m.
    return metres | {_key("decimetre"): 0.1, _key("dm"): 0.1}


def _key(name: str) -> frozenset[str]:
    """Return the words of a unit's name, whatever their order and spelling."""
    text = name.casefold().replace("meter", "metre").replace("'s", "").replace("u.s.", "us ")
    words = re.findall(r"[^\W\d_]+|\d+", text)
    singular = (re.sub(r"(?<=...)s$", "", word) for word in words if word not in _WORDS)
    return frozenset(singular).union(*(_WORDS[word] for word in words if word in _WORDS))


def vertical_of(source: str, crs: CRS, band_unit: str, positive: str) -> Vertical:
    """Return the unit, direction and datum of a raster's heights.

    The unit is ``band_unit``, else the unit of the vertical axis of ``crs``, else the metre.
    ``positive`` is ``"down"`` for depths, as CF writes it; an axis that points down has the same
    effect. ``source`` is the raster's name in errors.

    Raises `InputError` if the band names an unknown unit of length, if the band and the axis name
    different units, and if neither names one and the map is not in metres.
    """
    axis = next((axis for axis in crs.axis_info if axis.direction in ("up", "down")), None)
    notes = []
    if band_unit.strip().casefold() not in _UNSAID:
        metres = metres_per(band_unit)
        if metres is None:
            raise InputError(
                f"the heights of {source} are in {band_unit!r}; expected a unit of length such as "
                "metre, foot or US survey foot: correct it (rio edit-info --bidx 1 --units m)"
            )
        unit = f"{band_unit}, by the band"
        if axis and abs(axis.unit_conversion_factor / metres - 1.0) > SAME_UNIT:
            raise InputError(
                f"{source} has heights in {band_unit} by the band and in {axis.unit_name} by the "
                "vertical axis of its CRS; compare them with a map, and correct the band (rio "
                f"edit-info --bidx 1 --units '{axis.unit_name}') or the CRS (gdal_edit.py -a_srs)"
            )
    elif axis:
        metres = axis.unit_conversion_factor
        unit = f"{axis.unit_name}, by the CRS's vertical axis"
    else:
        metres = 1.0
        unit = UNNAMED
        _check_map_in_metres(source, crs)
    if positive.strip().casefold() == "down" or (axis and axis.direction == "down"):
        metres = -metres
        notes.append("values are depths, positive downward; heights are taken as their negatives")
    assumed = GEOID if is_of_earth(crs) else _figure_of(crs)
    return Vertical(metres, unit, *_datum_of(crs), assumed, tuple(notes))


def _check_map_in_metres(source: str, crs: CRS) -> None:
    """Raise `InputError` if a projected map is not in metres.

    Heights without a unit may then be in the unit of the map or in metres.
    """
    axis = crs.axis_info[0] if crs.is_projected else None
    if axis is None or abs(axis.unit_conversion_factor - 1.0) <= SAME_UNIT:
        return
    code = ":".join(crs.to_authority() or ("EPSG", "2263"))
    raise InputError(
        f"the map of {source} is in {axis.unit_name}, and nothing names the unit of its heights, "
        "which may be the same or the metre; name it in the file (rio edit-info --bidx 1 --units "
        f"'{axis.unit_name}', or m) or give a CRS with a vertical part (--crs {code}+6360 for US "
        f"feet, {code}+5703 for metres)"
    )


def _figure_of(crs: CRS) -> str:
    """Return the sphere or the ellipsoid of a CRS in words."""
    long_m, short_m = half_axes_m(crs)
    if long_m == short_m:
        return f"sphere of {long_m / 1000.0:.7g} km"
    return f"ellipsoid of {long_m / 1000.0:.7g} by {short_m / 1000.0:.7g} km"


def _datum_of(crs: CRS) -> tuple[str, str]:
    """Return `Vertical.datum` and `Vertical.reference`; empty if unnamed."""
    for part in crs.sub_crs_list:
        if part.is_vertical:
            name = str(part.name)
            return name, ELLIPSOID if ELLIPSOID in name.casefold() else GEOID
    return (str(crs.datum and crs.datum.name), ELLIPSOID) if len(crs.axis_info) > 2 else ("", "")


@cache
def map_conventions(crs: CRS) -> Mapping[str, str]:
    """Return a horizontal CRS's datum, axes and meridian in words."""
    authority = crs.to_authority()
    found = {"crs": f"{crs.name} ({':'.join(authority)})" if authority else str(crs.name)}
    if crs.datum and crs.ellipsoid:
        found["horizontal_datum"] = f"{crs.datum.name}, ellipsoid {crs.ellipsoid.name}"
    axes = (f"{axis.name} {axis.direction} in {axis.unit_name}" for axis in crs.axis_info)
    found["axes"] = ", ".join(axes)
    meridian = crs.prime_meridian
    if meridian:
        deg = math.degrees(float(meridian.longitude) * float(meridian.unit_conversion_factor))
        place = f", {degrees_in_words(deg, 'EW')} of Greenwich" if deg else ""
        found["prime_meridian"] = f"{meridian.name}{place}"
    return found


def merged_conventions(conventions: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the conventions of several files; where they differ, all are listed."""
    names = dict.fromkeys(name for one in conventions for name in one)
    return {
        name: "; ".join(dict.fromkeys(one[name] for one in conventions if name in one))
        for name in names
    }

"""Conventions of a raster of heights: units, datums, axes, prime meridian, and its kind of surface.

Conventions that a file names are used; the others are assumed, with a warning where that matters.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import rasterio
from pyproj import CRS
from pyproj.database import get_units_map
from rasterio.errors import RasterioError

from skyline.errors import InputError
from skyline.geodesy import degrees_in_words

GEOID, ELLIPSOID = "geoid", "ellipsoid"

SURFACE, GROUND, UNKNOWN = "surface (DSM)", "bare ground (DTM)", "not known"

_PRODUCTS = (
    (r"fabdem", "FABDEM", GROUND),
    (r"copernicus|glo-?[39]0|eu-?dem", "Copernicus", SURFACE),
    (r"aw3d|alpsmlc30", "AW3D", SURFACE),
    (r"nasadem", "NASADEM", SURFACE),
    (r"srtm", "SRTM", SURFACE),
    (r"astgtm|aster[ _-]?gdem", "ASTER GDEM", SURFACE),
    (r"tdm1_dem|tandem-?x", "TanDEM-X", SURFACE),
    (r"3dep|usgs_(13|1|1m|one_meter)_", "3DEP", GROUND),
    (r"swissalti3d", "swissALTI3D", GROUND),
    (r"arcticdem", "ArcticDEM", SURFACE),
    (r"(?<![a-z])dsm(?![a-z])", "", SURFACE),
    (r"(?<![a-z])(dtm|dgm|dem_bare)(?![a-z])", "", GROUND),
)
"""Patterns in the names and tags of files, the product that each shows, and its kind of surface;
the first pattern that is found counts."""

_UNSAID = {"", "no", "none", "unknown", "unspecified"}
"""Band units that name no unit; ``NO`` is ArcInfo's."""

_SAME_UNIT = 1e-4
"""Units that differ by less are one: the feet of all surveys, and the German legal metre."""

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
"""Words in the names of units, and the words by which they are replaced; a word without meaning has
none."""

_DATUM = re.compile(r"\(|\babove\b|a\.?m?\.?s\.?l\b|ü|\b(?:msl|navd|ngvd|nhn|nap|egm)")
"""The beginning of the words on the datum that follow a unit: ``m (NAVD88)``, ``metres above sea
level``."""


@dataclass(frozen=True, slots=True)
class Vertical:
    """The unit, the direction and the datum of a raster's heights."""

    metres: float
    """A value times this is a height in metres; it is negative for depths."""
    unit: str
    """Name of the unit, and where it comes from."""
    datum: str
    """Name of the vertical CRS, or of the datum of an ellipsoid; empty if none is named."""
    surface: str
    """`GEOID` or `ELLIPSOID`, from which heights are measured; empty if no datum is named."""
    notes: tuple[str, ...]
    """Sentences on what was assumed, which follow the name of the file and a colon."""

    @property
    def conventions(self) -> dict[str, str]:
        """The unit and the datum by name, in words."""
        datum = f"{self.datum} ({self.surface})" if self.datum else "geoid, assumed: none is named"
        return {"height_unit": self.unit, "vertical_datum": datum}


def metres_per(unit: str) -> float | None:
    """Return the metres in a unit of length of PROJ or EPSG, however GDAL, ESRI or CF spell it.

    None for an unknown name.
    """
    for name in (unit, _DATUM.split(unit.casefold())[0]):
        metres = _units().get(_key(name))
        if metres is not None:
            return metres
    return None


@cache
def _units() -> Mapping[frozenset[str], float]:
    metres = {
        _key(name): unit.conv_factor
        for unit in get_units_map(category="linear").values()
        for name in filter(None, (unit.proj_short_name, unit.name))
    }
    # PROJ gives 0.01 for it.
    return metres | {_key("decimetre"): 0.1, _key("dm"): 0.1}


def _key(name: str) -> frozenset[str]:
    """Return the words of a unit's name, whatever their order and spelling."""
    text = name.casefold().replace("meter", "metre").replace("'s", "").replace("u.s.", "us ")
    words = re.findall(r"[^\W\d_]+|\d+", text)
    singular = (re.sub(r"(?<=...)s$", "", word) for word in words if word not in _WORDS)
    return frozenset(singular).union(*(_WORDS[word] for word in words if word in _WORDS))


def vertical_of(source: str, crs: CRS, band_unit: str, positive: str) -> Vertical:
    """Return the conventions of a raster's heights, in a CRS with its vertical part.

    The unit is the band's, else that of the CRS's vertical axis, else the metre; the band's may be
    empty. ``positive`` is ``"down"`` for depths, as CF writes it; an axis that points down has the
    same effect. ``source`` is the raster's name in errors.

    Raises `InputError` where the unit of the band is not a known unit of length.
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
        if axis and abs(axis.unit_conversion_factor / metres - 1.0) > _SAME_UNIT:
            notes.append(
                f"heights are in {band_unit} by the band and in {axis.unit_name} by the vertical "
                "axis of the CRS; the band's unit is used"
            )
    elif axis:
        metres, unit = axis.unit_conversion_factor, f"{axis.unit_name}, by the CRS's vertical axis"
    else:
        metres, unit = 1.0, "metre, assumed: neither the band nor the CRS names a unit"
        map_unit = crs.axis_info[0] if crs.is_projected else None
        if map_unit and abs(map_unit.unit_conversion_factor - 1.0) > _SAME_UNIT:
            notes.append(
                f"the unit of the map is the {map_unit.unit_name} and none is named for heights; "
                "metres are assumed. If that is wrong, name the unit in the file (rio edit-info "
                f"--bidx 1 --units '{map_unit.unit_name}')"
            )
    if positive.strip().casefold() == "down" or (axis and axis.direction == "down"):
        metres = -metres
        notes.append("values are depths, positive downward; heights are taken as their negatives")
    return Vertical(metres, unit, *_datum_of(crs), tuple(notes))


def _datum_of(crs: CRS) -> tuple[str, str]:
    """Return the name and the surface of a vertical datum, both empty if none is named."""
    for part in crs.sub_crs_list:
        if part.is_vertical:
            name = str(part.name)
            return name, ELLIPSOID if ELLIPSOID in name.casefold() else GEOID
    return (str(crs.datum and crs.datum.name), ELLIPSOID) if len(crs.axis_info) > 2 else ("", "")


@cache
def conventions_of(crs: CRS) -> Mapping[str, str]:
    """Return the conventions of a horizontal CRS by name, in words."""
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


def merged(conventions: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Return the conventions of several files as one; those that differ are listed."""
    names = dict.fromkeys(name for one in conventions for name in one)
    return {
        name: "; ".join(dict.fromkeys(one[name] for one in conventions if name in one))
        for name in names
    }


def model_of(files: Sequence[str]) -> str:
    """Return `SURFACE` or `GROUND` and the product, as far as a DEM's files show by name and tags.

    `UNKNOWN` too where files differ.
    """
    models = {_model_of_file(file) for file in files}
    return models.pop() if len(models) == 1 else UNKNOWN


def _model_of_file(file: str) -> str:
    for text in (Path(file).name, *_tags(file)):
        for pattern, product, model in _PRODUCTS:
            if re.search(pattern, text.lower()):
                return f"{model}, {product}" if product else model
    return UNKNOWN


def _tags(file: str) -> list[str]:
    if file.lower().endswith(".gz"):  # an .hgt, which has none
        return []
    try:
        with rasterio.open(file) as dataset:
            return [*map(str, dataset.tags().values()), *filter(None, dataset.descriptions)]
    except RasterioError:
        return []

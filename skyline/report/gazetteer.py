"""Gazetteers: named summits and places in CSV, or in GeoJSON as OpenStreetMap has them."""

import json
import logging
import math
import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError, printable
from skyline.files import read_bytes
from skyline.geodesy import Frame
from skyline.tables import Row, read_table

_GEOJSON = (".geojson", ".json")
_FOOT_M, _INCH_M = 0.3048, 0.0254
_METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("km", "kilometre", "kilometres", "kilometer", "kilometers"), 1000.0),
    **dict.fromkeys(("mi", "mile", "miles"), 1609.344),
    **dict.fromkeys(("ft", "foot", "feet"), _FOOT_M),
}
"""Units of length that OpenStreetMap documents (wiki, Map features/Units), in metres."""
_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_WITH_UNIT = re.compile(rf"([-+]?{_NUMBER})\s?([a-z]*)")
_FEET_INCHES = re.compile(rf"""({_NUMBER})['\u2019\u2032](?:\s?({_NUMBER})["\u201d\u2033])?""")
_HEIGHTS_M = -500.0, 9000.0
"""Lowest and highest ground on Earth, with a margin: the Dead Sea at -430 m, Everest at 8849 m."""
_COLUMNS = (("name", "lon", "lat"), ("name", "easting", "northing"))
_HEIGHTS = dict.fromkeys(("ele", "elevation", "elevation_m", "height"), "height_m")
_log = logging.getLogger(__name__)
_EXPECTED = (
    "expected a gazetteer: columns `name,lon,lat` or `name,easting,northing`, maybe `height_m`, or "
    "GeoJSON (.geojson, .json) of points with the property `name`"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Peaks:
    """N named summits in a metric frame.

    Attributes
    ----------
    names : tuple of str
        Characters that are not printable are escaped.
    easting_m, northing_m : (N,) float64
    height_m : (N,) float64
        Height in the gazetteer, for the label; NaN if it has none.
    """

    names: tuple[str, ...]
    easting_m: Float64Array
    northing_m: Float64Array
    height_m: Float64Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(map(printable, self.names)))

    def __len__(self) -> int:
        return len(self.names)


def read_peaks(path: str | Path, frame: Frame) -> Peaks:
    """Read a gazetteer.

    Parameters
    ----------
    path : str or Path
        GeoJSON (``.geojson``, ``.json``) of points with the properties ``name`` and, optionally,
        ``ele``, as in OpenStreetMap (`height_of_ele`); one warning counts the peaks whose ``ele``
        is no height. Any other file is CSV with the columns ``name`` and ``lon,lat`` (degrees, WGS
        84) or ``easting,northing`` (metres, in ``frame``), and optionally ``height_m``, which may
        be empty. Features and rows without a name are skipped, as are other columns.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The columns are wrong, a value is no number, or no point has a name.
    """
    names, (first, second, height_m), is_lonlat = _read(path)
    if is_lonlat:
        first, second = frame.from_lonlat(first, second)
    return Peaks(names=names, easting_m=first, northing_m=second, height_m=height_m)


def find_place(path: str | Path, name: str) -> tuple[float, float]:
    """Return longitude and latitude of a gazetteer's place; capitals in its name do not count.

    Raises `InputError` for a name that is not there or there several times, for a gazetteer in a
    frame's metres, and as `read_peaks`.
    """
    names, (lon, lat, _), is_lonlat = _read(path)
    if not is_lonlat:
        raise InputError(f"{path} has its places in metres; expected `lon` and `lat` in degrees")
    found = [k for k, known in enumerate(names) if known.casefold() == name.casefold()]
    if len(found) == 1:
        return float(lon[found[0]]), float(lat[found[0]])
    if found:
        places = " and ".join(f"{lon[k]:.4f},{lat[k]:.4f}" for k in found[:3])
        raise InputError(
            f"{path} has {len(found)} places named {name}, at {places}; give --near LON,LAT,KM"
        )
    close = get_close_matches(name, names, n=3)
    hint = f": {' or '.join(close)}?" if close else ""
    raise InputError(f"{path} has no place named {name}{hint}; give its name or LON,LAT,KM")


def _read(path: str | Path) -> tuple[tuple[str, ...], Float64Array, bool]:
    """Return names, (3, N) coordinates and heights of named points, and whether they are lonlat."""
    is_lonlat = True
    if Path(path).suffix.lower() in _GEOJSON:
        points = _of_geojson(path)
    else:
        table = read_table(path, _EXPECTED, _HEIGHTS)
        columns = table.first_in(*_COLUMNS, expected=_EXPECTED)
        points = [_row(row, *columns[1:]) for row in table.rows if row["name"]]
        is_lonlat = columns == _COLUMNS[0]
    if not points:
        raise InputError(f"gazetteer {path} has no named point; {_EXPECTED}")
    names, *numbers = zip(*points, strict=True)
    return names, np.array(numbers, dtype=np.float64), is_lonlat


def _row(row: Row, first: str, second: str) -> tuple[str, float, float, float]:
    height_m = row.number("height_m") if row["height_m"] else math.nan
    return " ".join(row["name"].split()), row.number(first), row.number(second), height_m


def _of_geojson(path: str | Path) -> list[tuple[str, float, float, float]]:
    try:
        read = json.loads(read_bytes(path, _EXPECTED).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"gazetteer {path} cannot be read ({error}); expected GeoJSON: a FeatureCollection of "
            "points with the property `name`"
        ) from None
    features = read.get("features") if isinstance(read, dict) else None
    found = [_named_point(feature) for feature in features] if isinstance(features, list) else []
    points, unread = [], []
    for name, lon, lat, ele in filter(None, found):
        height_m = math.nan if ele is None else height_of_ele(ele)
        points.append((name, lon, lat, height_m))
        if ele is not None and math.isnan(height_m):
            unread.append((ele, name))
    if unread:
        _log.warning(
            "gazetteer %s: `ele` of %d of %d peaks is no height (the first is `%.40s` of %s), so "
            "these are shown without one; expected metres, such as 4421, or a unit, such as "
            "4421 m, 14505 ft or 14505'3\"",
            path,
            len(unread),
            len(points),
            *unread[0],
        )
    return points


def _named_point(feature: Any) -> tuple[str, float, float, object] | None:
    """Return name, longitude, latitude and ``ele`` of a feature, None unless it is a named point.

    ``ele`` is the value in the file, None if it is empty.
    """
    try:
        properties, geometry = feature["properties"], feature["geometry"]
        lon, lat = (float(degrees) for degrees in geometry["coordinates"][:2])
        name = " ".join(str(properties["name"] or "").split())
        ele = properties.get("ele")
    except (TypeError, KeyError, ValueError, AttributeError):
        return None
    if not name or geometry.get("type") != "Point" or not (abs(lon) <= 360.0 and abs(lat) <= 90.0):
        return None
    return name, lon, lat, None if ele == "" else ele


def height_of_ele(ele: object) -> float:
    """Return the height in metres of OpenStreetMap's ``ele``; NaN if it is no height.

    A number has a decimal point and no separator of thousands. It is in metres, or in the unit that
    follows it after an optional space; feet and inches are also written as 14505'3" (wiki, Key:ele
    and Map features/Units). Other forms are ambiguous, like 1,234, and are no height; neither is a
    height that no place on Earth has.
    """
    text, height_m = str(ele).strip().lower(), math.nan
    if (read := _WITH_UNIT.fullmatch(text)) and read[2] in _METRES:
        height_m = float(read[1]) * _METRES[read[2]]
    elif read := _FEET_INCHES.fullmatch(text):
        height_m = float(read[1]) * _FOOT_M + float(read[2] or 0.0) * _INCH_M
    return height_m if _HEIGHTS_M[0] <= height_m <= _HEIGHTS_M[1] else math.nan

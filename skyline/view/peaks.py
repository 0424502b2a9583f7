"""Gazetteers: named summits, read from files."""

import json
import logging
import math
import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Float64Array, ShortRepr
from skyline.errors import InputError, one_line, printable
from skyline.files.disk import read_bytes
from skyline.files.geojson import GEOJSON
from skyline.files.tables import Row, read_table
from skyline.geodesy.crs import WGS84, crs_of_positions, transformer
from skyline.geodesy.earth import GROUND_M
from skyline.geodesy.map_frame import Frame
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import is_on_map, swap_hint

_FOOT_M = 0.3048
_INCH_M = 0.0254
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
_Point = tuple[str, float, float, object]
"""Name, coordinates and height of a peak. The height is as in the file, or None."""
_COLUMNS = (("name", "lon", "lat"), ("name", "easting", "northing"))
_HEIGHTS = dict.fromkeys(("ele", "elevation", "elevation_m", "height"), "height_m")
_log = logging.getLogger(__name__)
_EXPECTED = (
    "expected a gazetteer: columns `name,lon,lat` or `name,easting,northing`, and optionally "
    "`height_m`, or GeoJSON (.geojson, .json) of points in degrees with the property `name`"
)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Peaks(ShortRepr):
    """N named summits in a metric frame.

    Attributes
    ----------
    names : tuple of str
    easting_m, northing_m : (N,) float64
    height_m : (N,) float64
        Height in the gazetteer, for the label; NaN if it has none.
    """

    names: tuple[str, ...]
    easting_m: Float64Array
    northing_m: Float64Array
    height_m: Float64Array

    def __len__(self) -> int:
        return len(self.names)


def read_peaks(path: str | Path, frame: Frame) -> Peaks:
    """Read a gazetteer.

    Parameters
    ----------
    path : str or Path
        GeoJSON (``.geojson``, ``.json``) of points with the properties ``name`` and, optionally,
        ``ele``. Any other file is CSV with the columns ``name`` and ``lon,lat`` (degrees, WGS 84)
        or ``easting,northing`` (metres, in ``frame``), and optionally ``height_m`` or ``ele``,
        which may be empty. Heights are read by `height_of_ele`; one warning counts the peaks whose
        height cannot be read. Features and rows without a name are skipped, and other columns are
        ignored.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        The columns are wrong, a coordinate is not a number, no point has a name, or a name is not
        UTF-8.
    """
    names, (first, second, height_m), is_lonlat = _read(path)
    if is_lonlat:
        first, second = frame.from_lonlat(first, second)
    return Peaks(names=names, easting_m=first, northing_m=second, height_m=height_m)


def check_on_map(peaks: Peaks, terrain: HeightField) -> None:
    """Log a warning if no peak lies on the map.

    Raises `InputError` if eastings and northings are degrees: in a frame around the model they
    would lie in its middle.
    """
    frame = terrain.frame
    places_m = peaks.easting_m, peaks.northing_m
    in_degrees = is_on_map(terrain, *frame.from_lonlat(*places_m))
    if in_degrees.any():
        raise InputError(
            f"the easting and northing of {peaks.names[int(np.argmax(in_degrees))]} are degrees; "
            "expected metres: name the columns lon,lat"
        )
    if not len(peaks) or is_on_map(terrain, *places_m).any():
        return
    lon, lat = frame.to_lonlat(*places_m)
    _log.warning(
        "none of %d peaks lies on the elevation model (the first is %s at %.4f,%.4f)%s",
        len(peaks),
        peaks.names[0],
        lon[0],
        lat[0],
        swap_hint(terrain, lon, lat),
    )


def find_place(path: str | Path, name: str) -> tuple[float, float]:
    """Return longitude and latitude of a place that a gazetteer names.

    Case is ignored.

    Raises `InputError` if no place or more than one has the name, or if the gazetteer is in a
    frame's metres; other errors are raised as by `read_peaks`.
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
    """Read a gazetteer's names, and its coordinates with heights (3, N).

    The third result says whether the coordinates are in degrees. Names are printable.
    """
    is_lonlat = True
    if Path(path).suffix.lower() in GEOJSON:
        points = _of_geojson(path)
    else:
        table = read_table(path, _EXPECTED, _HEIGHTS)
        columns = table.first_in(*_COLUMNS, expected=_EXPECTED)
        points = [_row(row, *columns[1:]) for row in table.rows if row["name"]]
        is_lonlat = columns == _COLUMNS[0]
    if not points:
        raise InputError(f"gazetteer {path} has no named point; {_EXPECTED}")
    names, first, second, heights = zip(*points, strict=True)
    try:
        "".join(names).encode()
    except UnicodeEncodeError:
        raise InputError(f"gazetteer {path} is not UTF-8; save it again as UTF-8") from None
    height_m = [math.nan if one is None else height_of_ele(one) for one in heights]
    unread = [k for k, one in enumerate(heights) if one is not None and math.isnan(height_m[k])]
    if unread:
        _log.warning(
            "gazetteer %s: %d of %d heights cannot be read (the first is `%.40s` of %s), so these "
            "peaks are shown without one; expected metres, such as 4421, or a unit, such as 4421 "
            "m, 14505 ft or 14505'3\"",
            path,
            len(unread),
            len(points),
            heights[unread[0]],
            names[unread[0]],
        )
    numbers = np.array([first, second, height_m], dtype=np.float64)
    return tuple(map(printable, names)), numbers, is_lonlat


def _row(row: Row, first: str, second: str) -> _Point:
    # A height that may be two stays as it is, and is no height.
    readings = row.readings("height_m")
    height = (readings[0] if len(readings) == 1 else row["height_m"]) or None
    return one_line(row["name"]), row.number(first), row.number(second), height


def _of_geojson(path: str | Path) -> list[_Point]:
    try:
        read = json.loads(read_bytes(path, _EXPECTED).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"gazetteer {path} cannot be read ({error}); expected GeoJSON: a FeatureCollection of "
            "points with the property `name`"
        ) from None
    crs = crs_of_positions(path, read.get("crs") if isinstance(read, dict) else None)
    if not crs.is_geographic:
        raise InputError(
            f"gazetteer {path} has the coordinate system {printable(crs.name)}; expected degrees "
            "of WGS 84: convert it, as with ogr2ogr -t_srs EPSG:4326"
        )
    to_wgs84 = transformer(crs, WGS84)
    features = read.get("features") if isinstance(read, dict) else None
    found = [_named_point(feature) for feature in features] if isinstance(features, list) else []
    points = [
        (name, *to_wgs84.transform(lon, lat), ele) for name, lon, lat, ele in filter(None, found)
    ]
    for name, lon, lat, _ in points:
        if not (abs(lon) <= 360.0 and abs(lat) <= 90.0):
            raise InputError(
                f"gazetteer {path} has {printable(name)} at {lon:g},{lat:g}; expected longitude "
                "and latitude in degrees: convert it, as with ogr2ogr -t_srs EPSG:4326"
            )
    return points


def _named_point(feature: Any) -> _Point | None:
    """Return a feature's name, longitude, latitude and ``ele``.

    Returns None if the feature is not a named point.
    """
    try:
        properties = feature["properties"]
        geometry = feature["geometry"]
        lon, lat = (float(degrees) for degrees in geometry["coordinates"][:2])
        name = one_line(properties["name"] or "")
        ele = properties.get("ele")
    except (TypeError, KeyError, ValueError, OverflowError, AttributeError):
        return None
    if not name or geometry.get("type") != "Point":
        return None
    return name, lon, lat, None if ele == "" else ele


def height_of_ele(ele: object) -> float:
    """Return the metres of OpenStreetMap's ``ele``; NaN if it is no height.

    A number has a decimal point and no separator of thousands. It is in metres, or in the unit that
    follows it after an optional space; feet and inches are also written as 14505'3" (wiki, Key:ele
    and Map features/Units). Other forms are ambiguous, like 1,234, and are no height; neither is a
    height that no place on Earth has.
    """
    text = str(ele).strip().lower()
    height_m = math.nan
    if (read := _WITH_UNIT.fullmatch(text)) and read[2] in _METRES:
        height_m = float(read[1]) * _METRES[read[2]]
    elif read := _FEET_INCHES.fullmatch(text):
        height_m = float(read[1]) * _FOOT_M + float(read[2] or 0.0) * _INCH_M
    return height_m if GROUND_M[0] <= height_m <= GROUND_M[1] else math.nan

"""Named summits: a gazetteer, as CSV or as GeoJSON of OpenStreetMap."""

import csv
import json
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError, MissingFileError
from skyline.geodesy import Frame

_GEOJSON = (".geojson", ".json")
_PLACES = (("lon", "lat"), ("easting", "northing"))
_EXPECTED = "expected a header `name,lon,lat` or `name,easting,northing`, and optionally `height_m`"


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """N named summits in a metric frame.

    Attributes
    ----------
    easting_m, northing_m : (N,) float64
    height_m : (N,) float64
        As the gazetteer has it, for its label; NaN where it does not say.
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
        ``ele``, as OpenStreetMap has them; features without a name or a point are left out. Else
        CSV: header ``name,lon,lat`` (degrees, WGS 84) or ``name,easting,northing`` (metres, in
        ``frame``), and optionally ``height_m``, which may be empty.

    Raises
    ------
    MissingFileError
        There is no such file.
    InputError
        Wrong columns, a row without a name, a value that is not a number, or no named point.
    """
    path = Path(path)
    if not path.is_file():
        raise MissingFileError(f"gazetteer {path} does not exist; {_EXPECTED}")
    if path.suffix.lower() in _GEOJSON:
        return _read_geojson(path, frame)
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if any(cell.strip() for cell in row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"gazetteer {path} cannot be read as CSV ({error}); {_EXPECTED}") from None
    header = tuple(cell.strip() for cell in rows[0]) if rows else ()
    columns = ("name", "height_m")
    places = next((pair for pair in _PLACES if {"name", *pair} <= set(header)), None)
    if places is None or set(header) - {*columns, *places} or len(set(header)) < len(header):
        raise InputError(f"gazetteer {path} has the columns `{','.join(header)}`; {_EXPECTED}")
    records = [_record(path, number, header, row) for number, row in enumerate(rows[1:], 2)]
    first, second, height = (
        np.array([_number(path, record, name) for record in records])
        for name in (*places, "height_m")
    )
    if places == ("lon", "lat"):
        first, second = frame.from_lonlat(first, second)
    return Peaks(tuple(record["name"] for record in records), first, second, height)


def _read_geojson(path: Path, frame: Frame) -> Peaks:
    expected = "expected GeoJSON: a FeatureCollection of points with the property `name`"
    try:
        read = json.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"gazetteer {path} cannot be read ({error}); {expected}") from None
    features = read.get("features") if isinstance(read, dict) else None
    points = [_named_point(feature) for feature in features] if isinstance(features, list) else []
    named = [point for point in points if point is not None]
    if not named:
        raise InputError(f"gazetteer {path} has no named point; {expected}")
    names, lon, lat, height = zip(*named, strict=True)
    return Peaks(names, *frame.from_lonlat(lon, lat), np.array(height))


def _named_point(feature: Any) -> tuple[str, float, float, float] | None:
    """Return name, longitude, latitude and height of a feature, None where it is no named point."""
    try:
        properties, geometry = feature["properties"], feature["geometry"]
        lon, lat = (float(degrees) for degrees in geometry["coordinates"][:2])
        name = " ".join(str(properties["name"] or "").split())
        height = re.match(r"\s*-?\d+(\.\d+)?", str(properties.get("ele", "")))
    except (TypeError, KeyError, ValueError, AttributeError):
        return None
    if not name or geometry.get("type") != "Point" or not (abs(lon) <= 360.0 and abs(lat) <= 90.0):
        return None
    return name, lon, lat, float(height[0]) if height else math.nan


def _record(path: Path, number: int, header: tuple[str, ...], row: list[str]) -> dict[str, str]:
    if len(row) != len(header):
        raise InputError(
            f"gazetteer {path}, row {number} has {len(row)} cells; expected {len(header)} for "
            f"`{','.join(header)}`"
        )
    record = dict(zip(header, (" ".join(cell.split()) for cell in row), strict=True))
    if not record["name"]:
        raise InputError(f"gazetteer {path}, row {number} has no name; name the peak or remove it")
    return record


def _number(path: Path, record: dict[str, str], column: str) -> float:
    text = record.get(column, "")
    if column == "height_m" and not text:
        return math.nan
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    low, high = {"lon": (-180.0, 360.0), "lat": (-90.0, 90.0)}.get(column, (-1e9, 1e9))
    if not low <= value <= high:
        raise InputError(
            f"gazetteer {path}: {column} of {record['name']!r} is `{text}`; expected a number "
            f"from {low:g} to {high:g}"
        )
    return value

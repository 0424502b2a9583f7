"""Named summits: reading gazetteers, and finding which summits an eye sees.

The places of a gazetteer are accurate to about a hundred metres, and a grid of heights cuts summits
off. A peak therefore stands at the highest sample near its named place, with the terrain's height
there. It is visible if no ground rises above the straight line to it. Ground within 150 m of a peak
is the peak's own, and does not hide it.
"""

import json
import logging
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar
from unicodedata import bidirectional

import numpy as np

from skyline.arrays import Float64Array, ShortRepr
from skyline.errors import InputError, printable, swapped_in_words
from skyline.files import GEOJSON, read_bytes
from skyline.geodesy.crs import WGS84, crs_of_geojson, transformer
from skyline.geodesy.earth import GROUND_M, Curvature
from skyline.geodesy.map_frame import Frame
from skyline.tables import Row, read_table
from skyline.terrain.heightfield import HeightField
from skyline.terrain.ray_casting import edge_crossings_m
from skyline.terrain.summits import prominence_m
from skyline.terrain.viewpoints import Viewpoints, is_on_map

SUMMIT_RADIUS_M = 150.0
"""Greatest distance of a summit from its named place; terrain this near to a summit does not hide
it."""
UNDERFOOT_SAMPLES = 0.35
"""Ground nearer than this many samples hides nothing: the model is too coarse there."""
_OTHER_HEIGHT_M = 200.0
"""A gazetteer's height that differs by more from the terrain's at the summit is not its height in
metres: vertical datums differ by up to 100 m, and coarse models cut off as much."""
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
S = TypeVar("S", bound="Sighting")
_FROM_LEFT = "\N{LEFT-TO-RIGHT MARK}"
_FROM_RIGHT = ("R", "AL")
"""Bidirectional classes of letters that are written from right to left."""
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
    swapped = is_on_map(terrain, *frame.from_lonlat(lat, lon)).any()
    _log.warning(
        "none of %d peaks lies on the elevation model (the first is %s at %.4f,%.4f)%s",
        len(peaks),
        peaks.names[0],
        lon[0],
        lat[0],
        f"; {swapped_in_words(lon[0], lat[0])}" if swapped else "",
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
    return " ".join(row["name"].split()), row.number(first), row.number(second), height


def _of_geojson(path: str | Path) -> list[_Point]:
    try:
        read = json.loads(read_bytes(path, _EXPECTED).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"gazetteer {path} cannot be read ({error}); expected GeoJSON: a FeatureCollection of "
            "points with the property `name`"
        ) from None
    crs = crs_of_geojson(path, read.get("crs") if isinstance(read, dict) else None)
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
        name = " ".join(str(properties["name"] or "").split())
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """A peak as an eye would see it without other terrain."""

    name: str
    easting_m: float
    northing_m: float
    surface_m: float
    """Height of the summit on the terrain."""
    grid_azimuth_deg: float
    elevation_tan: float
    """Tangent of the elevation angle: up over horizontal distance."""
    distance_m: float
    """Horizontal."""
    height_m: float = math.nan
    """Height in the gazetteer; NaN if it has none."""

    @property
    def label(self) -> str:
        """The name, with the height if the gazetteer has one.

        Marks enclose a name that is written from right to left, so that the height stays after it.
        """
        is_turned = any(bidirectional(letter) in _FROM_RIGHT for letter in self.name)
        name = f"{_FROM_LEFT}{self.name}{_FROM_LEFT}" if is_turned else self.name
        return name if math.isnan(self.height_m) else f"{name} {self.height_m:.0f} m"

    @property
    def elevation_m(self) -> float:
        """Height in the gazetteer, or else the summit's height on the terrain."""
        return self.surface_m if math.isnan(self.height_m) else self.height_m


def visible_peaks(
    terrain: HeightField, eye: Viewpoints, peaks: Peaks, curvature: Curvature
) -> list[Sighting]:
    """Return the peaks visible to one eye, in the gazetteer's order.

    Peaks off the terrain are left out, since the terrain that may hide them is unknown.
    """
    aimed = aimed_at(terrain, eye, peaks, curvature)
    return [one for one in aimed if one is not None and _is_seen(terrain, eye, one, curvature)]


def aimed_at(
    terrain: HeightField, eye: Viewpoints, peaks: Peaks, curvature: Curvature
) -> list[Sighting | None]:
    """Return where one eye would see each peak if nothing hid it.

    None stands for a peak off the terrain. A height that contradicts the terrain, such as one in
    feet, is left out, and one warning counts these heights.
    """
    aimed: list[Sighting | None] = []
    other: list[tuple[str, float, float]] = []
    for index, name in enumerate(peaks.names):
        summit = summit_near(terrain, peaks.easting_m[index], peaks.northing_m[index])
        if summit is None:
            aimed.append(None)
            continue
        easting_m, northing_m, surface_m = summit
        east_m = easting_m - float(eye.easting_m[0])
        north_m = northing_m - float(eye.northing_m[0])
        distance_m = math.hypot(east_m, north_m)
        up_m = surface_m - float(eye.eye_elevation_m[0]) - float(curvature.drop_m(distance_m))
        height_m = float(peaks.height_m[index])
        if abs(height_m - surface_m) > _OTHER_HEIGHT_M:
            other.append((name, height_m, surface_m))
            height_m = math.nan
        aimed.append(
            Sighting(
                name=name,
                easting_m=easting_m,
                northing_m=northing_m,
                surface_m=surface_m,
                grid_azimuth_deg=math.degrees(math.atan2(east_m, north_m)) % 360.0,
                # Of a summit just under the eye no direction is asked.
                elevation_tan=up_m / max(distance_m, 1.0),
                distance_m=distance_m,
                height_m=height_m,
            )
        )
    if other:
        _log.warning(
            "%d of %d peaks have heights that differ by more than %g m from the terrain (the first "
            "is %s, %.0f m high, on ground of %.0f m), so they are shown without one; expected "
            "metres, or a unit, such as 14505 ft",
            *(len(other), len(peaks), _OTHER_HEIGHT_M, *other[0]),
        )
    return aimed


def _is_seen(
    terrain: HeightField, eye: Viewpoints, sighting: Sighting, curvature: Curvature
) -> bool:
    """Return whether no terrain in front of a peak stands higher.

    A peak on which the eye stands is not seen.
    """
    if sighting.distance_m <= 2.0 * SUMMIT_RADIUS_M:
        return False
    (highest_deg,) = highest_between_deg(
        terrain,
        eye,
        curvature,
        np.radians([sighting.grid_azimuth_deg]),
        np.array([UNDERFOOT_SAMPLES * terrain.spacing_m]),
        np.array([sighting.distance_m - SUMMIT_RADIUS_M]),
    )
    return bool(highest_deg <= math.degrees(math.atan(sighting.elevation_tan)))


def most_prominent_first(terrain: HeightField, sightings: Sequence[S]) -> list[S]:
    """Return sightings in order of prominence on the terrain, then of height.

    Prominence is computed, since gazetteers seldom have it. Height alone misleads: a knoll on a
    high ridge is higher than a mountain that stands alone.
    """

    def rank(sighting: Sighting) -> tuple[float, float]:
        row, col = terrain.to_grid(easting_m=sighting.easting_m, northing_m=sighting.northing_m)
        prominent_m = prominence_m(terrain, round(float(row)), round(float(col)))
        return -prominent_m, -sighting.surface_m

    return sorted(sightings, key=rank)


def summit_near(
    terrain: HeightField, easting_m: float, northing_m: float
) -> tuple[float, float, float] | None:
    """Return easting, northing and height of the highest sample near a place.

    Returns None off the terrain, and where there is no sample.
    """
    row, col = (float(at) for at in terrain.to_grid(easting_m=easting_m, northing_m=northing_m))
    if not (0.0 <= row <= terrain.rows - 1 and 0.0 <= col <= terrain.cols - 1):
        return None
    reach_rows = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_north_m)
    reach_cols = max(1.0, SUMMIT_RADIUS_M / terrain.spacing_east_m)
    top = max(0, math.ceil(row - reach_rows))
    left = max(0, math.ceil(col - reach_cols))
    near = terrain.part(
        slice(top, math.floor(row + reach_rows) + 1), slice(left, math.floor(col + reach_cols) + 1)
    )
    if np.isnan(near).all():
        return None
    at_row, at_col = np.unravel_index(np.nanargmax(near), near.shape)
    east, north = terrain.to_map(top + at_row, left + at_col)
    return float(east), float(north), float(near[at_row, at_col])


def highest_between_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    near_m: Float64Array,
    far_m: Float64Array,
) -> Float64Array:
    """Return the highest elevation angle of the terrain on each ray.

    Each of one eye's K rays is followed along its grid azimuth between two distances (K,). The
    surface is a plane between two edges, so the highest angle is at an edge. It is -90 without
    data.
    """
    away_m, is_between = edge_crossings_m(terrain, eye, grid_rad, near_m, far_m)
    up_deg = ground_elevation_deg(terrain, eye, curvature, grid_rad, away_m)
    return np.asarray(np.where(is_between, up_deg, -90.0).max(axis=1))


def ground_elevation_deg(
    terrain: HeightField,
    eye: Viewpoints,
    curvature: Curvature,
    grid_rad: Float64Array,
    distance_m: Float64Array,
) -> Float64Array:
    """Return the ground's elevation angles (K, D) along one eye's rays.

    The rays have grid azimuths (K,); the horizontal distances are (D,) or (K, D). The angle is -90
    without data.
    """
    ground_m = terrain.height_at(
        easting_m=eye.easting_m[0] + distance_m * np.sin(grid_rad)[:, np.newaxis],
        northing_m=eye.northing_m[0] + distance_m * np.cos(grid_rad)[:, np.newaxis],
    )
    drop_m = eye.eye_elevation_m[0] + curvature.drop_m(distance_m)
    up_deg = np.degrees(np.arctan((ground_m - drop_m) / distance_m))
    return np.asarray(np.nan_to_num(up_deg, nan=-90.0))

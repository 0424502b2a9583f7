"""Matches and places as files that other programs read.

Candidates are points, views and ellipses in degrees of WGS 84 as GeoJSON (RFC 7946); places, views,
and the photo standing in the landscape as KML 2.2 (OGC 07-147r2); and waypoints, which navigation
devices and hiking maps read, as GPX 1.1. The places of a store are a GeoPackage.

``match --results`` writes a row for each photo as soon as it is done, so that a stopped search can
go on: to CSV (RFC 4180), or to a GeoPackage (OGC 12-128r18), whose points are the best candidates.
One process at a time writes such a file.
"""

import csv
import io
import json
import math
import os
import sqlite3
import struct
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote
from xml.etree import ElementTree as Xml

import cv2
import numpy as np

from skyline.arrays import Float64Array, UInt8Array
from skyline.camera import Projection
from skyline.errors import BusyError, InputError, SkylineError, printable, suffix_of
from skyline.files import STANDARD, has_locks, lock_file, write_whole, write_with_folders
from skyline.geodesy import Frame, lonlat_rings
from skyline.match.result import MatchResult, listed
from skyline.photo.read import read_picture
from skyline.photo.skyline import PhotoSkyline
from skyline.pose import Ellipse, Pose, view_wedge_m
from skyline.store.read import Store
from skyline.tables import csv_lines, unguarded

VIEW_REACH_M = 2000.0
"""Radius of the wedge drawn for a view; a camera sees farther, but longer wedges would overlap."""

_DECIMALS = 7
"""Decimals of degrees in files: a centimetre on the ground."""
_KML, _GPX = "http://www.opengis.net/kml/2.2", "http://www.topografix.com/GPX/1/1"
_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 90]
_OVERLAY = """<PhotoOverlay><name/><Camera>
<longitude>{at.lon:.7f}</longitude><latitude>{at.lat:.7f}</latitude>
<altitude>{at.eye_elevation_m:.2f}</altitude><heading>{at.heading_deg:.3f}</heading>
<tilt>{tilt_deg:.3f}</tilt><roll>{roll_deg:.3f}</roll><altitudeMode>absolute</altitudeMode>
</Camera><Icon><href/></Icon><ViewVolume><leftFov>-{side_deg:.3f}</leftFov>
<rightFov>{side_deg:.3f}</rightFov><bottomFov>-{up_deg:.3f}</bottomFov><topFov>{up_deg:.3f}</topFov>
<near>300</near></ViewVolume>
<Point><coordinates>{at.lon:.7f},{at.lat:.7f},{at.eye_elevation_m:.2f}</coordinates></Point>
<shape>rectangle</shape></PhotoOverlay>"""
"""A photo that stands 300 m before the camera; its name and address are set as texts."""
Json = dict[str, object]
Photos = Sequence[UInt8Array | None]
Row = Mapping[str, Any]

_COLUMN_TYPES: Mapping[str, str] = {
    "query": "TEXT", "id": "TEXT", "search": "TEXT", "answered": "INTEGER", "within_m": "REAL",
    "lon": "REAL", "lat": "REAL", "easting_m": "REAL", "northing_m": "REAL",
    "eye_elevation_m": "REAL", "radius_m": "REAL", "heading_deg": "REAL", "pitch_deg": "REAL",
    "roll_deg": "REAL", "fov_deg": "REAL", "confidence": "REAL", "confidence_1km": "REAL",
    "exif_distance_m": "REAL", "seconds": "REAL", "reason": "TEXT",
}  # fmt: skip
"""Columns of a file of results, and their types in SQLite."""
_WGS84 = (
    'GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433],AUTHORITY["EPSG","4326"]]'
)
_GEOPACKAGE = f"""
PRAGMA application_id = 1196444487;
PRAGMA user_version = 10300;
CREATE TABLE gpkg_spatial_ref_sys (srs_name TEXT NOT NULL, srs_id INTEGER PRIMARY KEY,
  organization TEXT NOT NULL, organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL,
  description TEXT);
INSERT INTO gpkg_spatial_ref_sys VALUES
  ('Undefined cartesian', -1, 'NONE', -1, 'undefined', NULL),
  ('Undefined geographic', 0, 'NONE', 0, 'undefined', NULL),
  ('WGS 84', 4326, 'EPSG', 4326, '{_WGS84}', NULL);
CREATE TABLE gpkg_contents (table_name TEXT PRIMARY KEY, data_type TEXT NOT NULL,
  identifier TEXT UNIQUE, description TEXT DEFAULT '',
  last_change DATETIME NOT NULL DEFAULT (strftime('%Y-%m-%dT%H:%M:%fZ','now')),
  min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
  srs_id INTEGER REFERENCES gpkg_spatial_ref_sys(srs_id));
INSERT INTO gpkg_contents (table_name, data_type, identifier, srs_id)
  VALUES ('photos', 'features', 'photos', 4326);
CREATE TABLE gpkg_geometry_columns (
  table_name TEXT PRIMARY KEY REFERENCES gpkg_contents(table_name),
  column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL, srs_id INTEGER NOT NULL,
  z TINYINT NOT NULL, m TINYINT NOT NULL);
INSERT INTO gpkg_geometry_columns VALUES ('photos', 'geom', 'POINT', 4326, 0, 0);
CREATE TABLE photos (fid INTEGER PRIMARY KEY AUTOINCREMENT, geom POINT,
  {", ".join(f'"{name}" {kind}' for name, kind in _COLUMN_TYPES.items())});
"""


def _geojson(results: Sequence[MatchResult], frame: Frame) -> str:
    """Return the candidates of results as a FeatureCollection.

    Each is a Point with the properties of the public JSON, a Polygon of the view out to 2 km, and
    where its covariance is known one of the ellipse; ``shape`` is ``candidate``, ``view`` or
    ``ellipse95``.
    """
    features = [
        feature
        for one in results
        for candidate in one.candidates
        for feature in _features(printable(one.name), candidate, frame)
    ]
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, indent=1, allow_nan=False) + "\n"


def _features(query: str, candidate: Pose, frame: Frame) -> list[Json]:
    """Return the point, the view and the ellipse of a candidate as GeoJSON features."""
    record: Json = {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in candidate.to_dict().items()
    }
    of_pose: Json = {"query": query, "rank": candidate.rank, "origin": candidate.origin}

    def feature(shape: str, geometry: Json, about: Json) -> Json:
        properties = of_pose | {"shape": shape} | about
        return {"type": "Feature", "geometry": geometry, "properties": properties}

    place = [round(candidate.lon, _DECIMALS), round(candidate.lat, _DECIMALS)]
    wedge = _polygon(view_wedge_m(candidate, VIEW_REACH_M), frame)
    shapes = [
        feature("candidate", {"type": "Point", "coordinates": place}, record),
        feature("view", wedge, {"reach_m": VIEW_REACH_M}),
    ]
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        axes: Json = {"semi_major_m": ellipse.semi_major_m, "semi_minor_m": ellipse.semi_minor_m}
        shapes.append(feature("ellipse95", _polygon(ellipse.outline_m, frame), axes))
    return shapes


def _polygon(outline_m: Float64Array, frame: Frame) -> Json:
    """Return an outline as a Polygon, or as a MultiPolygon where the antimeridian cuts it."""
    rings = _rings(outline_m, frame)
    if len(rings) == 1:
        return {"type": "Polygon", "coordinates": rings}
    return {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}


def _rings(outline_m: Float64Array, frame: Frame) -> list[list[list[float]]]:
    """Return the rings of an outline (P, 2), metres, in degrees to a centimetre."""
    return [np.round(ring, _DECIMALS).tolist() for ring in lonlat_rings(outline_m, frame)]


def _kml(results: Sequence[MatchResult], frame: Frame, hrefs: Sequence[str | None]) -> bytes:
    """Return results as KML, with a PhotoOverlay of each photo whose address is given.

    Each candidate is a place and a view of 2 km; the first of each photo has the PhotoOverlay.
    """
    root = Xml.Element("kml", xmlns=_KML)
    folder = _child(root, "Document")
    _child(folder, "name", "Where the photos were taken")
    for result, href in zip(results, hrefs, strict=True):
        name = Path(result.name).name
        for candidate in result.candidates:
            _add_candidate(folder, name, candidate, frame)
        is_flat = result.query.projection is Projection.PERSPECTIVE
        if href is not None and result.candidates and is_flat:
            _add_photo(folder, name, result.query, result.candidates[0], href)
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _linked_kml(
    path: Path, results: Sequence[MatchResult], frame: Frame, photos: Photos | None
) -> bytes:
    """Return KML that links to photos: by the path from its folder to the file (RFC 3986, 4.2).

    If ``photos`` are given, the address is the file's name: the file should lie beside the KML.
    """
    hrefs: list[str | None] = []
    for photo in (Path(one.name) for one in results):
        href = photo.name
        if photos is None:
            # Symbolic links are resolved first, since `..` would lead from a link's target.
            href = os.path.relpath(photo.parent.resolve() / photo.name, path.parent.resolve())
        has_picture = photo.name not in ("", STANDARD) and photo.suffix.lower() != ".csv"
        hrefs.append(quote(os.fsencode(href)) if has_picture else None)
    return _kml(results, frame, hrefs)


def _kmz(results: Sequence[MatchResult], frame: Frame, photos: Photos | None) -> bytes:
    """Return KML and its photos as a KMZ; photos that are not given are read from their files."""
    if photos is None:
        photos = [read_picture(one.name) if one.name else None for one in results]
    pictures = {f"files/{n:02d}.jpg": photo for n, photo in enumerate(photos, start=1)}
    hrefs = [None if photo is None else href for href, photo in pictures.items()]
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("doc.kml", _kml(results, frame, hrefs), zipfile.ZIP_DEFLATED)
        for href, photo in pictures.items():
            if photo is not None:
                jpeg = cv2.imencode(".jpg", photo[..., ::-1], _QUALITY)[1].tobytes()
                archive.writestr(href, jpeg)
    return file.getvalue()


def _add_candidate(folder: Xml.Element, name: str, candidate: Pose, frame: Frame) -> None:
    mark = _child(folder, "Placemark")
    _child(mark, "name", f"{name}: {candidate.name}")
    _child(mark, "description", _described(candidate))
    shapes = _child(mark, "MultiGeometry")
    place = f"{candidate.lon:.7f},{candidate.lat:.7f},{candidate.eye_elevation_m:.2f}"
    _child(_child(shapes, "Point"), "coordinates", place)
    for outline in _rings(view_wedge_m(candidate, VIEW_REACH_M), frame):
        ring = _child(_child(_child(shapes, "Polygon"), "outerBoundaryIs"), "LinearRing")
        _child(ring, "coordinates", " ".join(f"{lon},{lat}" for lon, lat in outline))


def _add_photo(
    folder: Xml.Element, name: str, query: PhotoSkyline, candidate: Pose, href: str
) -> None:
    """Add a PhotoOverlay: the photo standing before the camera at a candidate."""
    side_deg = candidate.fov_deg / 2.0
    up = math.tan(math.radians(side_deg)) * query.height_px / query.width_px
    # A tilt counts from straight down, a roll counter-clockwise as seen from behind.
    angles = {"tilt_deg": 90.0 + candidate.pitch_deg, "roll_deg": -candidate.roll_deg}
    up_deg = math.degrees(math.atan(up))
    text = _OVERLAY.format(at=candidate, side_deg=side_deg, up_deg=up_deg, **angles)
    overlay = Xml.fromstring(text)
    overlay[0].text, overlay[2][0].text = printable(name), href
    folder.append(overlay)


def _described(candidate: Pose) -> str:
    """Return in words the origin of a pose, the attitude of its camera and its confidence."""
    sure = "" if candidate.confidence is None else f"; confidence {candidate.confidence:.2f}"
    return (
        f"{candidate.origin.capitalize()}. Heading {candidate.heading_deg:.1f}° from true north, "
        f"pitch {candidate.pitch_deg:.1f}°, "
        f"roll {candidate.roll_deg:.1f}°, field of view {candidate.fov_deg:.1f}°, eye "
        f"{candidate.eye_elevation_m:.0f} m above the datum{sure}"
    )


def _gpx(results: Sequence[MatchResult]) -> bytes:
    root = Xml.Element("gpx", xmlns=_GPX, version="1.1", creator="skyline")
    for result in results:
        name = Path(result.name).name
        for candidate in result.candidates:
            place = {"lat": f"{candidate.lat:.7f}", "lon": f"{candidate.lon:.7f}"}
            point = _child(root, "wpt", **place)
            _child(point, "ele", f"{candidate.eye_elevation_m:.1f}")
            _child(point, "name", f"{name}: {candidate.name}")
            _child(point, "desc", _described(candidate))
    return bytes(Xml.tostring(root, encoding="utf-8", xml_declaration=True))


def _child(parent: Xml.Element, tag: str, text: str = "", **attributes: str) -> Xml.Element:
    element = Xml.SubElement(parent, tag, attributes)
    if text:
        element.text = printable(text)
    return element


EXPORTS: Mapping[
    str, Callable[[Path, Sequence[MatchResult], Frame, Photos | None], str | bytes]
] = {
    ".geojson": lambda _, results, frame, __: _geojson(results, frame),
    ".kml": _linked_kml,
    ".kmz": lambda _, results, frame, photos: _kmz(results, frame, photos),
    ".gpx": lambda _, results, *__: _gpx(results),
}
"""The function that returns the content of a file of each suffix."""


def export_matches(
    path: str | Path, results: Sequence[MatchResult], frame: Frame, photos: Photos | None = None
) -> None:
    """Write the candidates of results by the suffix: GeoJSON, KML, KMZ or GPX.

    Parameters
    ----------
    path : str or Path
        Missing folders are made.
    results : sequence of MatchResult
        Each is named after its photo's file.
    frame : Frame
        Frame of the candidates: `Matcher.frame`.
    photos : sequence of (H, W, 3) uint8 or None, optional
        RGB of each result's photo, which a KMZ holds. By default the photos are read from the files
        that the results are named after.

    Raises
    ------
    InputError
        The suffix is not known, a photo cannot be read or is missing, or the file cannot be
        written.
    """
    path, results = Path(path), listed(results)
    if photos is not None and len(photos) != len(results):
        raise InputError(f"{len(photos)} photos are given for {len(results)} results")
    content = EXPORTS[suffix_of(path, EXPORTS)](path, results, frame, photos)
    write_with_folders(path, content)


def write_geopackage(store: Store, path: Path) -> int:
    """Write the places of a store as points, with spacing and tolerance; return their number.

    Raises `InputError` for a store of renderings, for a path that cannot be written or does not end
    in ``.gpkg``, and without GeoPandas; `StoreError` for damaged data.
    """
    suffix_of(path, [".gpkg"])
    table = store.to_geodataframe()
    # The file is made in memory: SQLite needs file locks, which some network folders lack.
    held = io.BytesIO()
    table.to_file(held, layer="places", driver="GPKG")
    write_whole(path, held.getvalue())
    return len(table)


class ResultsFile:
    """A file with the results of one search, made if there is none; a context manager.

    A lock file beside it keeps other processes out until the end of the block.

    Parameters
    ----------
    path : Path
    search : str
        Identifies the store and the options.

    Attributes
    ----------
    photos : dict
        By photo and its own settings: the error that it could not be used for, or None.

    Raises
    ------
    BusyError
        Another process has the file in use.
    InputError
        The suffix is unknown, the file holds other data or the results of another search, or it
        cannot be written.
    """

    def __init__(self, path: Path, search: str) -> None:
        self.path, self._search = path, search
        kind = RESULTS.get(path.suffix.lower())
        if kind is None:
            raise InputError(
                f"--results {path}: the suffix is {path.suffix!r}; expected {' or '.join(RESULTS)}"
            )
        read, self._append = kind
        with ExitStack() as held, self._input_errors():
            held.enter_context(_alone(path))
            rows = read(path)
            if any(of_search != search for (of_search, _), _ in rows):
                raise InputError(
                    f"--results {path} has results of another store or other options; name "
                    "another file"
                )
            self._held = held.pop_all()
        self.photos = {photo: error for (_, photo), error in rows}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._held.close()

    def add(self, row: Row, photo: str) -> None:
        """Write a photo's row, of `MatchResult.to_row`, unless there is one.

        It is kept whatever happens afterwards.
        """
        if photo in self.photos:
            return
        values = {name: row.get(name) for name in _COLUMN_TYPES}
        with self._input_errors():
            self._append(self.path, values | {"search": f"{self._search}-{photo}"})
        self.photos[photo] = _error_of(values)

    @contextmanager
    def _input_errors(self) -> Iterator[None]:
        try:
            yield
        except SkylineError:
            raise
        except (OSError, sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(
                f"--results {self.path} cannot be used ({error}); name another one"
            ) from error


@contextmanager
def _alone(path: Path) -> Iterator[None]:
    """Keep other processes from writing a file; raises `BusyError` while one does."""
    target = Path(os.path.realpath(path))
    lock = target.with_name(f".{target.name}.lock")
    file = lock_file(lock)
    if file is None:
        raise BusyError(
            f"--results {path} is in use by another skyline; wait for its end, or name another file"
        )
    with file:
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)


def _error_of(row: Row) -> str | None:
    """Return the error in a row; only the row of a photo that could not be used has no time."""
    return row["reason"] if row["seconds"] in (None, "") else None


_Known = tuple[tuple[str, str], str | None]
"""The search and the photo of a row, and its error."""


def _known(row: Row) -> _Known:
    search, _, photo = row["search"].partition("-")
    return (search, photo), _error_of(row)


def _read_csv(path: Path) -> list[_Known]:
    """Return what is known of each row; cut off a row whose writing was interrupted."""
    held = path.read_bytes() if path.exists() else b""
    header = ",".join(_COLUMN_TYPES).encode() + b"\n"
    whole = held[: held.rfind(b"\n") + 1] or header
    rows = csv.DictReader(io.StringIO(whole.decode()))
    if rows.fieldnames != list(_COLUMN_TYPES) or not (b"\n" in held or header.startswith(held)):
        raise InputError(f"--results {path} is no file of results; name another one")
    if whole != held:
        path.write_bytes(whole)
    return [_known({name: unguarded(cell) for name, cell in row.items()}) for row in rows]


def _append_csv(path: Path, row: Row) -> None:
    line = csv_lines([[row[name] for name in _COLUMN_TYPES]])
    with path.open("a", encoding="utf-8") as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def _read_points(path: Path) -> list[_Known]:
    """Return what is known of each row of a GeoPackage, made if there is none."""
    if not path.exists():
        with closing(sqlite3.connect(":memory:")) as made:
            made.executescript(_GEOPACKAGE)
            write_whole(path, made.serialize())
    with closing(_connection(path)) as opened:
        opened.row_factory = sqlite3.Row
        return [_known(row) for row in opened.execute("SELECT * FROM photos")]


def _append_point(path: Path, row: Row) -> None:
    """Add a row to a GeoPackage; SQLite writes it as a whole."""
    names = ", ".join(f'"{name}"' for name in ("geom", *_COLUMN_TYPES))
    marks = ", ".join("?" * (len(_COLUMN_TYPES) + 1))
    point = None
    if row["lon"] is not None:
        # A GeoPackage's header without an envelope, then WKB.
        head = (b"GP", 0, 1, 4326, 1, 1)
        point = struct.pack("<2sBBiBIdd", *head, row["lon"], row["lat"])
    values = (point, *(row[name] for name in _COLUMN_TYPES))
    with closing(_connection(path)) as opened, opened:
        opened.execute(f"INSERT INTO photos ({names}) VALUES ({marks})", values)


def _connection(path: Path) -> sqlite3.Connection:
    """Open a GeoPackage, without locks in a folder that has none."""
    options = "" if has_locks(path) else "?nolock=1"
    return sqlite3.connect(f"{path.absolute().as_uri()}{options}", uri=True)


RESULTS = {".csv": (_read_csv, _append_csv), ".gpkg": (_read_points, _append_point)}
"""Files of results by suffix: the functions that read their queries, and append a row."""

"""Results of many photos in one file, a row each, that a search which was stopped goes on with.

A row is written as soon as its photo is done: to CSV (RFC 4180), or to a GeoPackage (OGC
12-128r18), whose points are the best candidates.
"""

import csv
import io
import os
import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from skyline.errors import InputError, printable
from skyline.files import has_locks, write_whole

Row = dict[str, str | float | int | None]

_TYPES: Mapping[str, str] = {
    "query": "TEXT", "search": "TEXT", "answered": "INTEGER", "within_m": "REAL",
    "lon": "REAL", "lat": "REAL", "easting_m": "REAL", "northing_m": "REAL",
    "eye_elevation_m": "REAL", "radius_m": "REAL", "heading_deg": "REAL", "pitch_deg": "REAL",
    "roll_deg": "REAL", "fov_deg": "REAL", "confidence": "REAL", "confidence_1km": "REAL",
    "exif_distance_m": "REAL", "seconds": "REAL", "said": "TEXT",
}  # fmt: skip
_OF_CANDIDATE = tuple(_TYPES)[4:16]
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
  {", ".join(f'"{name}" {kind}' for name, kind in _TYPES.items())});
"""


def open_results(path: Path, search: str) -> "tuple[Results, set[str]]":
    """Open a file of results, which is made if need be; return it and the queries it has.

    Raises `InputError` for another suffix, a file that is none or of another search, or one that
    cannot be written.

    Parameters
    ----------
    path : Path
        Its suffix is ``.csv`` or ``.gpkg``.
    search : str
        What tells searches apart: a file holds the results of one.
    """
    kind = RESULTS.get(path.suffix.lower())
    if kind is None:
        raise InputError(
            f"--results {path}: the suffix is {path.suffix!r}; expected {' or '.join(RESULTS)}"
        )
    with _as_input_errors(path):
        results = kind(path)
    if any(of_search != search for _, of_search in results.had):
        raise InputError(
            f"--results {path} has results of another store or other options; name another file"
        )
    return results, {query for query, _ in results.had}


def row_of(record: Mapping[str, Any], search: str) -> Row:
    """Return a query's row: its best candidate, and why that is no answer.

    ``record`` is a `MatchRecord` or a `FailureRecord`.
    """
    row: Row = dict.fromkeys(_TYPES)
    said = record.get("error", record.get("refusal"))
    row |= {"query": printable(record["query"]), "search": search, "answered": 0}
    row |= {"said": said and printable(said)}
    if "error" in record:
        return row
    row["seconds"] = record["seconds"]
    for best in record["candidates"][:1]:
        row |= {name: best[name] for name in _OF_CANDIDATE}
        row["answered"] = int(record["answer"] is not None)
        row["within_m"] = record["answer_within_m"]
    if "exif" in record:
        row["exif_distance_m"] = record["exif"]["distance_m"]
    return row


class _Csv:
    """Rows appended to a CSV file; what a kill left of the last one is taken away."""

    def __init__(self, path: Path) -> None:
        self._path = path
        held = path.read_bytes() if path.exists() else b""
        whole = held[: held.rfind(b"\n") + 1]
        if not whole:
            whole = ",".join(_TYPES).encode() + b"\n"
        if whole != held:
            path.write_bytes(whole)
        rows = csv.DictReader(io.StringIO(whole.decode()))
        if rows.fieldnames != list(_TYPES):
            raise InputError(f"--results {path} is no file of results; name another one")
        self.had = [(row["query"], row["search"]) for row in rows]

    def add(self, row: Row) -> None:
        line = io.StringIO()
        csv.DictWriter(line, list(_TYPES), lineterminator="\n").writerow(row)
        with _as_input_errors(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(line.getvalue())
            file.flush()
            os.fsync(file.fileno())


class _GeoPackage:
    """Rows of a table of points; SQLite keeps each as a whole."""

    def __init__(self, path: Path) -> None:
        self._path = path
        if not path.exists():
            with closing(sqlite3.connect(":memory:")) as made:
                made.executescript(_GEOPACKAGE)
                write_whole(path, made.serialize())
        with self._opened() as opened:
            self.had = opened.execute("SELECT query, search FROM photos").fetchall()

    def add(self, row: Row) -> None:
        names = ", ".join(f'"{name}"' for name in ("geom", *_TYPES))
        marks = ", ".join("?" * (len(_TYPES) + 1))
        values = _point(row["lon"], row["lat"]), *(row[name] for name in _TYPES)
        with _as_input_errors(self._path), self._opened() as opened, opened:
            opened.execute(f"INSERT INTO photos ({names}) VALUES ({marks})", values)

    @contextmanager
    def _opened(self) -> Iterator[sqlite3.Connection]:
        """Open the table, without locks in a folder that has none."""
        options = "" if has_locks(self._path) else "?nolock=1"
        address = f"{self._path.absolute().as_uri()}{options}"
        with closing(sqlite3.connect(address, uri=True)) as opened:
            yield opened


Results = _Csv | _GeoPackage
"""A file of results: `had` is the query and the search of each row that was there, and a row that
`add` has written is kept."""

RESULTS: Mapping[str, type[_Csv] | type[_GeoPackage]] = {".csv": _Csv, ".gpkg": _GeoPackage}
"""Files of results by suffix."""


def _point(lon: object, lat: object) -> bytes | None:
    """Return a point as GeoPackage has it: a header without an envelope, then WKB."""
    if lon is None or lat is None:
        return None
    place = float(str(lon)), float(str(lat))
    return struct.pack("<2sBBiBIdd", b"GP", 0, 1, 4326, 1, 1, *place)


@contextmanager
def _as_input_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except (OSError, sqlite3.Error, UnicodeDecodeError) as error:
        raise InputError(f"--results {path} cannot be used ({error}); name another one") from error

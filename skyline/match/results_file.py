"""Files of ``match --results``: a row for each photo, with which a stopped search continues.

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

from skyline.errors import InputError
from skyline.files import has_locks, write_whole

Row = Mapping[str, Any]

_TYPES: Mapping[str, str] = {
    "query": "TEXT", "id": "TEXT", "search": "TEXT", "answered": "INTEGER", "within_m": "REAL",
    "lon": "REAL", "lat": "REAL", "easting_m": "REAL", "northing_m": "REAL",
    "eye_elevation_m": "REAL", "radius_m": "REAL", "heading_deg": "REAL", "pitch_deg": "REAL",
    "roll_deg": "REAL", "fov_deg": "REAL", "confidence": "REAL", "confidence_1km": "REAL",
    "exif_distance_m": "REAL", "seconds": "REAL", "reason": "TEXT",
}  # fmt: skip
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


class ResultsFile:
    """A file with the results of one search, made if there is none.

    ``search`` identifies the store and the options. ``queries`` are the names of the queries in the
    file. Raises `InputError` where the suffix is unknown, the file holds other data or the results
    of another search, or it cannot be written.
    """

    def __init__(self, path: Path, search: str) -> None:
        self.path, self._search = path, search
        kind = RESULTS.get(path.suffix.lower())
        if kind is None:
            raise InputError(
                f"--results {path}: the suffix is {path.suffix!r}; expected {' or '.join(RESULTS)}"
            )
        with self._input_errors():
            read, self._append = kind
            rows = read(path)
        if any(of_search != search for _, of_search in rows):
            raise InputError(
                f"--results {path} has results of another store or other options; name another file"
            )
        self.queries = {query for query, _ in rows}

    def add(self, row: Row) -> None:
        """Write a row, of `MatchResult.to_row`; it is kept whatever happens afterwards."""
        with self._input_errors():
            values = {name: row.get(name) for name in _TYPES}
            self._append(self.path, values | {"search": self._search})
        self.queries.add(str(row["query"]))

    @contextmanager
    def _input_errors(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error, UnicodeDecodeError) as error:
            raise InputError(
                f"--results {self.path} cannot be used ({error}); name another one"
            ) from error


def _read_csv(path: Path) -> list[tuple[str, str]]:
    """Return the query and the search of each row; cut off a row whose writing was interrupted."""
    held = path.read_bytes() if path.exists() else b""
    header = ",".join(_TYPES).encode() + b"\n"
    whole = held[: held.rfind(b"\n") + 1] or header
    rows = csv.DictReader(io.StringIO(whole.decode()))
    if rows.fieldnames != list(_TYPES) or not (b"\n" in held or header.startswith(held)):
        raise InputError(f"--results {path} is no file of results; name another one")
    if whole != held:
        path.write_bytes(whole)
    return [(row["query"], row["search"]) for row in rows]


def _append_csv(path: Path, row: Row) -> None:
    line = io.StringIO()
    csv.DictWriter(line, list(_TYPES), lineterminator="\n").writerow(row)
    with path.open("a", encoding="utf-8") as file:
        file.write(line.getvalue())
        file.flush()
        os.fsync(file.fileno())


def _read_points(path: Path) -> list[tuple[str, str]]:
    """Return the query and the search of each row of a GeoPackage, made if there is none."""
    if not path.exists():
        with closing(sqlite3.connect(":memory:")) as made:
            made.executescript(_GEOPACKAGE)
            write_whole(path, made.serialize())
    with closing(_connection(path)) as opened:
        return opened.execute("SELECT query, search FROM photos").fetchall()


def _append_point(path: Path, row: Row) -> None:
    """Add a row to a GeoPackage; SQLite writes it as a whole."""
    names = ", ".join(f'"{name}"' for name in ("geom", *_TYPES))
    marks = ", ".join("?" * (len(_TYPES) + 1))
    point = None
    if row["lon"] is not None:
        # A GeoPackage's header without an envelope, then WKB.
        head = (b"GP", 0, 1, 4326, 1, 1)
        point = struct.pack("<2sBBiBIdd", *head, row["lon"], row["lat"])
    values = (point, *(row[name] for name in _TYPES))
    with closing(_connection(path)) as opened, opened:
        opened.execute(f"INSERT INTO photos ({names}) VALUES ({marks})", values)


def _connection(path: Path) -> sqlite3.Connection:
    """Open a GeoPackage, without locks in a folder that has none."""
    options = "" if has_locks(path) else "?nolock=1"
    return sqlite3.connect(f"{path.absolute().as_uri()}{options}", uri=True)


RESULTS = {".csv": (_read_csv, _append_csv), ".gpkg": (_read_points, _append_point)}
"""Files of results by suffix: the functions that read their queries, and append a row."""

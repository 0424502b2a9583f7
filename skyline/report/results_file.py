"""Files of results of ``skyline match --results``: a row for each photo.

A row is written as soon as its photo is done, so that a stopped search can go on: to CSV (RFC
4180), or to a GeoPackage (OGC 12-128r18), whose points are the best candidates. One process at a
time writes such a file.
"""

import csv
import io
import os
import sqlite3
import struct
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, Self

from skyline.errors import BusyError, InputError, SkylineError
from skyline.files.disk import write_whole
from skyline.files.locks import has_locks, lock_file
from skyline.files.tables import csv_lines, unguarded

Values = Mapping[str, Any]
"""Values by column, as `skyline.match.result.MatchResult.to_row` returns them."""

_COLUMN_TYPES: Mapping[str, str] = {
    "photo": "TEXT", "id": "TEXT", "search": "TEXT", "answered": "INTEGER", "within_m": "REAL",
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


class ResultsFile:
    """The file with the results of one search; a context manager.

    It is made if there is none. A lock file beside it keeps other processes out until the end of
    the block.

    Parameters
    ----------
    path : Path
    search : str
        Identifies the store and the options.

    Attributes
    ----------
    photos : dict
        The error of each photo that could not be used, and None for the other photos. A key
        identifies a photo and its own settings.

    Raises
    ------
    BusyError
        Another process is using the file.
    InputError
        The suffix is unknown, the file holds other data or the results of another search, or it
        cannot be written.
    """

    def __init__(self, path: Path, search: str) -> None:
        self.path = path
        self._search = search
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

    def add(self, row: Values, photo: str) -> None:
        """Write a photo's row, unless the file has one.

        When this returns, the row is on the disk, and is kept whatever happens afterwards.
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
    """Keep other processes from writing a file; raise `BusyError` if one does."""
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


def _error_of(row: Values) -> str | None:
    """Return the error in the row of an unusable photo.

    Only such a row has no seconds. In all others the reason is why there is no answer.
    """
    is_unusable = row["seconds"] in (None, "")
    return (row["reason"] or None) if is_unusable else None


_Known = tuple[tuple[str, str], str | None]
"""The search and the photo of a row, and its error."""


_SURPLUS = ""
"""The key of cells beyond the last column."""


def _known(row: Values) -> _Known:
    search, _, photo = row["search"].partition("-")
    return (search, photo), _error_of(row)


def _read_csv(path: Path) -> list[_Known]:
    """Return what is known of each row of a CSV file.

    A row whose writing was interrupted is cut off. Cells that are missing are empty.
    """
    held = path.read_bytes() if path.exists() else b""
    header = ",".join(_COLUMN_TYPES).encode() + b"\n"
    whole = held[: held.rfind(b"\n") + 1] or header
    rows = csv.DictReader(io.StringIO(whole.decode()), restkey=_SURPLUS, restval="")
    # A file without a line end may be a header whose writing was interrupted.
    has_header = b"\n" in held or header.startswith(held)
    if rows.fieldnames != list(_COLUMN_TYPES) or not has_header:
        raise InputError(f"--results {path} is not a file of results; name another one")
    if whole != held:
        path.write_bytes(whole)
    known: list[_Known] = []
    for row in rows:
        if _SURPLUS in row:
            raise InputError(
                f"--results {path}, line {rows.line_num} has more than {len(_COLUMN_TYPES)} cells; "
                "remove them, or name another file"
            )
        known.append(_known({name: unguarded(cell) for name, cell in row.items()}))
    return known


def _append_csv(path: Path, row: Values) -> None:
    line = csv_lines([[row[name] for name in _COLUMN_TYPES]])
    with path.open("a", encoding="utf-8") as file:
        file.write(line)
        file.flush()
        os.fsync(file.fileno())


def _read_points(path: Path) -> list[_Known]:
    """Return what is known of each row of a GeoPackage.

    The file is made if there is none.
    """
    if not path.exists():
        with closing(sqlite3.connect(":memory:")) as made:
            made.executescript(_GEOPACKAGE)
            write_whole(path, made.serialize())
    with closing(_connection(path)) as opened:
        opened.row_factory = sqlite3.Row
        return [_known(row) for row in opened.execute("SELECT * FROM photos")]


def _append_point(path: Path, row: Values) -> None:
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
"""Functions by suffix that read what is known of rows, and that append a row."""

"""Files: folders of them, reading, writing whole or not at all, tables, locks, names for GDAL.

Viewpoints, gazetteers, lists of photos and traces are all read here as tables. Their cells are
separated by the most frequent of comma, semicolon and tab in the header. With semicolons or tabs,
numbers may have decimal commas, and points between thousands beside them. Lines before the header
that begin with # are notes. An apostrophe that keeps a text from being a formula is taken off.
"""

import csv
import fcntl
import io
import math
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path, PurePath
from typing import NoReturn, TextIO, TypeGuard
from uuid import uuid4

from skyline.errors import InputError, MissingFileError, printable

REPORT_PAGE = "index.html"
"""The page of a report's folder."""
PAGE_MARK = '<meta name="generator" content="Skyline">'
"""The mark of the pages that Skyline writes."""
STANDARD = "-"
"""The name of standard input and output among paths."""
GEOJSON = (".geojson", ".json")
"""Suffixes of GeoJSON."""

_SEPARATORS = ",;\t"
_LIMITS = {"lon": (-180.0, 360.0), "lat": (-90.0, 90.0)}
_OTHER_NAMES = {
    **dict.fromkeys(("longitude", "long", "lng", "@lon"), "lon"),
    **dict.fromkeys(("latitude", "@lat"), "lat"),
    "easting_m": "easting",
    "northing_m": "northing",
    "fid": "id",
}
_DECIMAL_COMMA = re.compile(r"[-+]?\d[\d.]*,\d+")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?(?![\d.,])")
_FORMULA = re.compile(r"'*[-=+@\uff0d\uff1d\uff0b\uff20]")
"""How a text begins that spreadsheets take for a formula, perhaps after apostrophes: with a sign,
which may have full width (OWASP, CSV injection)."""
_LONE_NUMBER = re.compile(r"[-+]?[0-9]+(?:[.,][0-9]+)?(?:[eE][-+]?[0-9]+)?")
_LONG = {"easting", "northing", "elevation", "height_m", "lowest_m", "highest_m"}
"""Columns of metres that may be thousands."""
_OF_FILES = {
    ".csv", ".geojson", ".gpkg", ".gpx", ".h5", ".hdf5", ".htm", ".html", ".jpeg", ".jpg", ".json",
    ".kml", ".kmz", ".npz", ".pdf", ".png", ".svg", ".tif", ".tiff", ".txt", ".zip",
}  # fmt: skip
"""Suffixes that no one gives to a folder."""
_BEGINNING_BYTES = 1024
_SHOWN = 80
"""Characters of a header that an error shows."""
_KINDS_SHOWN = 10
"""Endings of files that a message names."""

_OF_SYSTEMS = {
    "__macosx", "@eadir", "$recycle.bin", "system volume information", "lost+found",
}  # fmt: skip
"""Folders of systems beside a person's own, in small letters."""
_MEMBER = re.compile(r"/vsizip/\{(.+?\.zip)\}/(.+)", re.DOTALL | re.IGNORECASE)


def read_bytes(path: str | Path, expected: str) -> bytes:
    """Return a file's content, or that of standard input for ``-``, which may be read again.

    Raises `MissingFileError` and `InputError`, with what was ``expected``.
    """
    if str(path) == STANDARD:
        return _content(sys.stdin)
    if not Path(path).exists():
        raise MissingFileError(f"{path} does not exist; {expected}")
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {expected}") from error


@cache
def _content(stream: TextIO) -> bytes:
    return stream.buffer.read()


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file at once, or to standard output for ``-``; a failure leaves what was there.

    A link stays, and its target is written; so are devices and pipes. Raises `InputError` where the
    file cannot be written.
    """
    content = content.encode() if isinstance(content, str) else content
    if str(path) == STANDARD:
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
        return
    partial: Path | None = None
    try:
        if path.is_char_device() or path.is_fifo():
            path.write_bytes(content)
        else:
            target = Path(os.path.realpath(path))
            # A name of its own, since another process may write the same file now.
            partial = target.with_name(f".{target.name}.{uuid4().hex[:12]}.partial")
            partial.write_bytes(content)
            partial.replace(target)
    except OSError as error:
        if partial is not None:
            with suppress(OSError):
                partial.unlink()
        raise InputError(
            f"{path} cannot be written ({error.strerror}); name a file in a folder that exists and "
            "has room"
        ) from error


def write_with_folders(path: Path, content: bytes | str) -> None:
    """Write a file at once, and make missing folders; otherwise as `write_whole`."""
    with suppress(OSError):  # Then the file cannot be written either.
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)


def check_folder(path: Path) -> None:
    """Raise `InputError` for a file, and for a new folder whose name promises a file."""
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; name a folder")
    suffix = path.suffix.lower()
    if suffix in _OF_FILES and not path.exists():
        raise InputError(f"{path} would be a folder, and {suffix} promises a file; name a folder")


def has_mark(path: Path, mark: bytes) -> bool:
    """Return whether a mark is in the first kilobyte of a file."""
    try:
        with path.open("rb") as file:
            return mark in file.read(_BEGINNING_BYTES)
    except OSError:
        return False


def is_own_page(path: Path) -> bool:
    """Return whether a file is a page of Skyline's, by its mark."""
    return has_mark(path, PAGE_MARK.encode())


def files_in(folder: Path, is_skipped: Callable[[Path], bool] = lambda _: False) -> list[Path]:
    """Return the files in a folder and in the folders in it, in order of path.

    Hidden files and folders, folders that systems make, and those that ``is_skipped`` names are
    left out. Links are followed, each folder is listed once; a link without a target is a file.
    Raises `InputError` where a folder cannot be listed.
    """

    def refuse(error: OSError) -> NoReturn:
        raise InputError(f"{error.filename} cannot be read: {error.strerror}") from error

    found: list[Path] = []
    listed: set[str] = set()
    for here, folders, names in os.walk(folder, onerror=refuse, followlinks=True):
        if os.path.realpath(here) in listed or is_skipped(Path(here)):
            folders.clear()
            continue
        listed.add(os.path.realpath(here))
        folders[:] = [one for one in folders if not is_of_system(one)]
        files = (Path(here, name) for name in names if not is_of_system(name))
        found += (file for file in files if file.is_file() or not file.exists())
    return sorted(found)


def is_of_system(name: str) -> bool:
    """Return whether a file or folder is hidden, or made by a system beside a person's own."""
    return name.startswith(".") or name.lower() in _OF_SYSTEMS


def names_in_words(names: Sequence[str]) -> str:
    """Return names of files: one of each ending, and how many more have that ending."""
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(PurePath(name).suffix.lower(), []).append(name)
    shown = [
        some[0] if len(some) == 1 else f"{some[0]} and {len(some) - 1} more {kind}".rstrip()
        for kind, some in list(kinds.items())[:_KINDS_SHOWN]
    ]
    others = sum(map(len, list(kinds.values())[_KINDS_SHOWN:]))
    return ", ".join(shown + [f"{others} others"] * bool(others))


def left_out_in_words(names: Sequence[str], expected: str) -> str:
    """Return a clause on the files of a folder that are left out: their number and names."""
    one = len(names) == 1
    number, verb = ("1 file", "is") if one else (f"{len(names)} files", "are")
    return f"{number} {verb} left out, which {verb} no {expected}: {names_in_words(names)}"


def has_locks(path: Path) -> bool:
    """Return whether a file can be locked; in some network folders none can."""
    with path.open("rb") as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return True


def lock_file(path: Path, before_waiting: Callable[[], object] | None = None) -> TextIO | None:
    """Make a file if it is missing, and lock it; return it open, which holds the lock.

    None is returned while another process holds the lock. With ``before_waiting``, that is called
    instead, and the lock waited for. Where no file can be locked, the file is returned all the
    same. Who holds the lock may remove the file. Raises `OSError` where it cannot be made.
    """
    while True:
        with ExitStack() as opened:
            file = opened.enter_context(path.open("w"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if before_waiting is None:
                    return None
                before_waiting()
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:
                pass  # Some network folders have no locks.
            # A file that another process has removed meanwhile locks nothing.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    opened.pop_all()
                    return file


def for_gdal(name: str) -> str:
    """Return a path or address that GDAL is to open; `InputError` where it is not UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{name} cannot be opened by GDAL, since it is not UTF-8; rename the file or folder, "
            "or name a link to it"
        ) from None
    return name


def member_name(archive: str | Path, member: str) -> str:
    """Return the name by which GDAL opens a member of a zip archive."""
    return f"/vsizip/{{{archive}}}/{member}"


def archive_of(name: str) -> tuple[str, str] | None:
    """Return the archive and the member of a name of `member_name`; None for any other name."""
    parts = _MEMBER.fullmatch(name)
    return None if parts is None else (parts[1], parts[2])


def on_disk(name: str | Path) -> str | Path:
    """Return the file that holds what GDAL opens: the archive of a member, else the name."""
    parts = archive_of(str(name))
    return name if parts is None else parts[0]


def is_file(path: str | Path) -> bool:
    """Return whether there is a file of this name; an address may be too long to be one."""
    return os.path.isfile(path)  # noqa: PTH113  (`Path.is_file` raises an error for long names)


def version_of(path: str | Path) -> tuple[int, int, int] | None:
    """Return a file's size, modification time and status-change time; None without a file.

    Those of a member of an archive are the archive's. Times are in nanoseconds. Copying and
    unpacking may keep the modification time, but not the status-change time, which a change of
    permissions or of the name updates, too.
    """
    try:
        known = Path(on_disk(path)).stat()
    except (OSError, ValueError):
        return None
    is_file = stat.S_ISREG(known.st_mode)
    return (known.st_size, known.st_mtime_ns, known.st_ctime_ns) if is_file else None


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table: its line in the file, and its cells without spaces around them."""

    where: str
    cells: Mapping[str, str]
    has_decimal_commas: bool = False

    def __getitem__(self, column: str) -> str:
        return self.cells.get(column, "")

    @property
    def label(self) -> str:
        """The row's ``id``, else its ``name``; empty if it has neither."""
        return self["id"] or self["name"]

    def with_point(self, column: str) -> str:
        """Return a cell with a decimal point, and no points between thousands."""
        text = self[column]
        if not self.has_decimal_commas:
            return text
        if column in _LONG and _THOUSANDS.match(text):
            text = text.replace(".", "")
        return text.replace(",", ".")

    def number(self, column: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number within limits, which for ``lon`` and ``lat`` are those of degrees.

        Raises `InputError` for anything else.
        """
        low, high = _LIMITS.get(column, (low, high))
        text = self[column]
        try:
            value = float(self.with_point(column))
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and low <= value <= high):
            above = f" from {low:g}" if low > -math.inf else ""
            below = f" to {high:g}" if high < math.inf else ""
            raise InputError(f"{self.where}: {column} is `{text}`; expected a number{above}{below}")
        return value


@dataclass(frozen=True, slots=True)
class Table:
    """The rows of a CSV file, its header and the notes before it."""

    path: str | Path
    header: tuple[str, ...]
    """Names in lower case; other usual names of coordinates are replaced by Skyline's."""
    rows: list[Row]
    notes: list[str]

    def refuse_other(self, *known: str) -> None:
        """Raise `InputError` if the table has an unknown column."""
        other = [name for name in self.header if name not in known]
        if other:
            raise InputError(
                f"{self.path} has the column `{other[0][:_SHOWN]}`; expected some of "
                f"{', '.join(known)}"
            )

    def first_in(self, *choices: tuple[str, ...], expected: str) -> tuple[str, ...]:
        """Return the first set of columns that the table has; raises `InputError` for none."""
        for names in choices:
            if set(names) <= set(self.header):
                return names
        shown = ",".join(self.header)[:_SHOWN]
        raise InputError(f"{self.path} has the columns `{shown}`; {expected}")


def is_table(path: object) -> TypeGuard[str | Path]:
    """Return whether a query is a CSV file, by its suffix, or by its text on standard input."""
    if not isinstance(path, str | Path):
        return False
    if str(path) != STANDARD:
        return Path(path).suffix.lower() == ".csv"
    content = read_bytes(path, "expected CSV or a picture")
    with suppress(UnicodeDecodeError):
        return "\0" not in content.decode()
    return False


def read_table(
    path: str | Path, expected: str, other_names: Mapping[str, str] | None = None
) -> Table:
    """Read a CSV file, or standard input for ``-``.

    ``expected`` is the content that was expected, in errors: ``expected a header ...``.
    ``other_names`` maps further column names to the names that rows use.

    Raises `MissingFileError` where there is no such file, and `InputError` where it cannot be read,
    a column is there twice, or a row has more cells than the header.
    """
    content = read_bytes(path, expected)
    if b"\0" in content:
        raise InputError(f"{path} cannot be read as CSV (it is not UTF-8 text); {expected}")
    # Names of files are bytes, which need not be UTF-8.
    text = content.decode("utf-8-sig", errors="surrogateescape")
    lines = list(io.StringIO(text, newline=""))
    before = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
    heading = next((line for line in lines[before:] if line.strip()), "")
    separator = max(_SEPARATORS, key=heading.count)
    reader = csv.reader(lines[before:], delimiter=separator, skipinitialspace=True)
    header: tuple[str, ...] = ()
    found = []
    try:
        for record in reader:
            cells = [unguarded(cell.strip()) for cell in record]
            where = f"{path}, line {before + reader.line_num}"
            if not any(cells):
                continue
            if not header:
                header = tuple(_column(name, other_names or {}) for name in cells)
                continue
            if any(cells[len(header) :]):
                raise InputError(
                    f"{where} has {len(cells)} cells; expected {len(header)} for "
                    f"`{','.join(header)[:_SHOWN]}`: put text with a separator in quotes"
                )
            found.append((where, dict(zip(header, cells, strict=False))))
    except csv.Error as error:
        raise InputError(f"{path} cannot be read as CSV ({error}); {expected}") from None
    if not header:
        raise InputError(f"{path} is empty; {expected}")
    if twice := {name for name in header if name and header.count(name) > 1}:
        raise InputError(f"{path} has the column `{twice.pop()[:_SHOWN]}` twice; {expected}")
    # Without a comma in any number, points are decimal.
    has_commas = separator != "," and any(
        _DECIMAL_COMMA.fullmatch(cell)
        for _, cells in found
        for name, cell in cells.items()
        if name not in ("id", "name", "path")
    )
    rows = [Row(where, cells, has_commas) for where, cells in found]
    return Table(path, header, rows, lines[:before])


def csv_lines(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV (RFC 4180) of printable texts, none a formula to a spreadsheet.

    A text that would be one gets an apostrophe before it, which `read_table` takes off; a number
    stays a number.
    """
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerows([map(_cell, row) for row in rows])
    return lines.getvalue()


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    text = printable(value)
    is_formula = _FORMULA.match(text) and not _LONE_NUMBER.fullmatch(text)
    return f"'{text}" if is_formula else text


def unguarded(cell: str) -> str:
    """Return a cell without the apostrophe of `csv_lines`."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _column(name: str, other_names: Mapping[str, str]) -> str:
    name = name.lower()
    return other_names.get(name) or _OTHER_NAMES.get(name, name)

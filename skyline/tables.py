"""Reading CSV tables.

Viewpoints, gazetteers, lists of photos and traces are all such tables. Cells are separated by the
most frequent of comma, semicolon and tab in the header. With semicolons or tabs, numbers may have
decimal commas, and points between thousands beside them. Lines before the header that begin with #
are notes. The apostrophe that keeps a text from being a formula is removed.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

from skyline.errors import InputError, printable
from skyline.files import STANDARD, read_bytes

_LIMITS = {"lon": (-180.0, 360.0), "lat": (-90.0, 90.0)}
"""Least and greatest numbers in columns of degrees."""
_OTHER_NAMES = {
    **dict.fromkeys(("longitude", "long", "lng", "@lon"), "lon"),
    **dict.fromkeys(("latitude", "@lat"), "lat"),
    "easting_m": "easting",
    "northing_m": "northing",
    "fid": "id",
}
"""Other usual names of columns, and the names that Skyline uses instead."""
_DECIMAL_COMMA = re.compile(r"[-+]?\d[\d.]*,\d+")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:\.\d{3})+(?:,\d+)?(?![\d.,])")
"""A number with points between thousands."""
_FORMULA = re.compile(r"'*[-=+@\uff0d\uff1d\uff0b\uff20]")
"""The beginning of a text that spreadsheets take for a formula: a sign, perhaps of full width,
perhaps after apostrophes (OWASP, CSV injection)."""
_LONE_NUMBER = re.compile(r"[-+]?[0-9]+(?:[.,][0-9]+)?(?:[eE][-+]?[0-9]+)?")
"""A number, which is no formula although it may begin with a sign."""
_LONG = {"easting", "northing", "elevation", "height_m", "lowest_m", "highest_m"}
"""Columns of metres that may be thousands."""
_SHOWN = 80
"""Characters of a header that an error shows."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table."""

    where: str
    """The file and the line, for messages."""
    cells: Mapping[str, str]
    """Texts by column, without spaces around them."""
    has_decimal_commas: bool = False

    def __getitem__(self, column: str) -> str:
        return self.cells.get(column, "")

    @property
    def label(self) -> str:
        """The row's ``id``, else its ``name``; empty if it has neither."""
        return self["id"] or self["name"]

    def with_point(self, column: str) -> str:
        """Return a number's text with a decimal point and no thousands separators."""
        text = self[column]
        if not self.has_decimal_commas:
            return text
        if column in _LONG and _THOUSANDS.match(text):
            text = text.replace(".", "")
        return text.replace(",", ".")

    def number(self, column: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number from ``low`` to ``high``.

        Raises `InputError` for anything else. ``lon`` is from -180 to 360 and ``lat`` from -90 to
        90.
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
    """The notes, the header and the rows of a CSV file."""

    path: str | Path
    header: tuple[str, ...]
    """Names of columns in lower case; Skyline's names replace other usual ones."""
    rows: list[Row]
    notes: list[str]
    """Lines before the header that begin with #."""

    def refuse_other(self, *known: str) -> None:
        """Raise `InputError` if the table has an unknown column."""
        other = [name for name in self.header if name not in known]
        if other:
            raise InputError(
                f"{self.path} has the column `{other[0][:_SHOWN]}`; expected some of "
                f"{', '.join(known)}"
            )

    def first_in(self, *choices: tuple[str, ...], expected: str) -> tuple[str, ...]:
        """Return the first set of columns present, or raise `InputError`."""
        for names in choices:
            if set(names) <= set(self.header):
                return names
        shown = ",".join(self.header)[:_SHOWN]
        raise InputError(f"{self.path} has the columns `{shown}`; {expected}")


def is_table(path: object) -> TypeGuard[str | Path]:
    """Return whether a path is a CSV file.

    The suffix decides, or the text on standard input.
    """
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

    ``expected`` says in errors what was expected: ``expected a header ...``. ``other_names`` maps
    further names of columns to the names that rows use.

    Raises `MissingFileError` where there is no such file, and `InputError` where it cannot be read,
    a column occurs twice, or a row has more cells than the header.
    """
    content = read_bytes(path, expected)
    if b"\0" in content:
        raise InputError(f"{path} cannot be read as CSV (it is not UTF-8 text); {expected}")
    # Names of files are bytes, which need not be UTF-8.
    text = content.decode("utf-8-sig", errors="surrogateescape")
    lines = list(io.StringIO(text, newline=""))
    before = next((k for k, line in enumerate(lines) if not line.startswith("#")), len(lines))
    heading = next((line for line in lines[before:] if line.strip()), "")
    separator = max(",;\t", key=heading.count)
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
                # Spreadsheets write empty columns at the end.
                names = cells[: max(k for k, cell in enumerate(cells, start=1) if cell)]
                header = tuple(_column(name, other_names or {}) for name in names)
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
    """Return rows as CSV (RFC 4180) without formulas.

    All texts are printable. A text that a spreadsheet would take for a formula gets an apostrophe
    before it, which `read_table` takes off; a number stays a number.
    """
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerows([map(_cell, row) for row in rows])
    return lines.getvalue()


def _cell(value: object) -> object:
    """Return a text as written, with an apostrophe before a formula."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    is_formula = _FORMULA.match(text) and not _LONE_NUMBER.fullmatch(text)
    return f"'{text}" if is_formula else text


def unguarded(cell: str) -> str:
    """Return a cell without the apostrophe that `csv_lines` put before it."""
    return cell[1:] if cell.startswith("'") and _FORMULA.match(cell) else cell


def _column(name: str, other_names: Mapping[str, str]) -> str:
    """Return Skyline's name for a column."""
    name = name.lower()
    return other_names.get(name) or _OTHER_NAMES.get(name, name)

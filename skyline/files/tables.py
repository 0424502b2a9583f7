"""Reading CSV tables.

Viewpoints, gazetteers, lists of photos and traces are all such tables. Cells are separated by the
most frequent of comma, semicolon and tab in the header. With semicolons or tabs, numbers may have
decimal commas, and separators between thousands. The other numbers of the table tell which is
which; a number that may still be two is refused. Lines before the header that begin with # are
notes. The apostrophe that keeps a text from being a formula is removed.
"""

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

from skyline.errors import InputError, printable
from skyline.files.disk import STANDARD, read_bytes

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
_POINT_OR_COMMA = {".": ",", ",": "."}
"""The marks of decimals, and of thousands beside each."""
_DECIMAL = re.compile(r"[-+]?\d+([.,])\d+")
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:([.,])\d{3})(?:\1\d{3})*(?:(?!\1)[.,]\d+)?")
"""A number with points or commas between thousands."""
_TEXTS = ("id", "name", "path", "time")
"""Columns whose texts do not tell how a table writes its numbers."""
_FORMULA = re.compile(r"'*[-=+@\uff0d\uff1d\uff0b\uff20]")
"""The beginning of a text that spreadsheets take for a formula: a sign, perhaps of full width,
perhaps after apostrophes (OWASP, CSV injection)."""
_LONE_NUMBER = re.compile(r"[-+]?[0-9]+(?:[.,][0-9]+)?(?:[eE][-+]?[0-9]+)?")
"""A number, which is no formula although it may begin with a sign."""
_LONG = {
    "easting", "northing", "elevation", "elevation_m", "eye_elevation_m", "height_m", "lowest_m",
    "highest_m",
}  # fmt: skip
"""Columns of metres that are often thousands, and of which no one gives millimetres."""
_SHOWN = 80
"""Characters of a header that an error shows."""


@dataclass(frozen=True, slots=True)
class Row:
    """A row of a table."""

    where: str
    """The file and the line, for messages."""
    cells: Mapping[str, str]
    """Texts by column, without spaces around them."""
    marks: str = "."
    """The marks of decimals in the table's numbers: point, comma, or both."""
    has_thousands: bool = False
    """Whether its numbers may have separators between thousands."""

    def __getitem__(self, column: str) -> str:
        return self.cells.get(column, "")

    @property
    def label(self) -> str:
        """The row's ``id``, else its ``name``; empty if it has neither."""
        return self["id"] or self["name"]

    def readings(self, column: str) -> list[str]:
        """Return the numbers that a text may stand for.

        They are texts with decimal points. There are none for a text that the table's way of
        writing numbers does not explain.
        """
        text = self[column]
        if not self.has_thousands:
            return [text]
        read = _THOUSANDS.fullmatch(text)
        marks = self.marks
        # Elsewhere than in long columns, someone may have pasted a number with three decimals.
        if read and read[1] != marks and column not in _LONG:
            marks = "".join(_POINT_OR_COMMA)
        whole = [
            text.replace(_POINT_OR_COMMA[mark], "").replace(mark, ".")
            for mark in marks
            if _POINT_OR_COMMA[mark] not in text or (read and read[1] != mark)
        ]
        return list(dict.fromkeys(whole))

    def number(self, column: str, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number from ``low`` to ``high``.

        Raises `InputError` for anything else, and for a text that may be two such numbers, such as
        1.234 in a table with decimal commas. ``lon`` is from -180 to 360 and ``lat`` from -90 to
        90.
        """
        low, high = _LIMITS.get(column, (low, high))
        values = []
        for text in self.readings(column):
            with suppress(ValueError):
                values.append(float(text))
        possible = [one for one in values if math.isfinite(one) and low <= one <= high]
        # Limits decide only where the other numbers of the table do not.
        is_sure = len(values) == 1 or len(self.marks) == 2
        if len(possible) == 1 and is_sure:
            return possible[0]
        found = f"{self.where}: {column} is `{self[column]}`"
        if possible:
            few, many = sorted(values, key=abs)
            raise InputError(
                f"{found}, which may be {few:g} or {many:g}; write one more decimal, or no "
                "separator between thousands"
            )
        above = f" from {low:g}" if low > -math.inf else ""
        below = f" to {high:g}" if high < math.inf else ""
        raise InputError(f"{found}; expected a number{above}{below}")


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
    # A spreadsheet may put quotes around the first cell.
    is_note = [line.startswith(("#", '"#')) for line in lines]
    before = next((k for k, one in enumerate(is_note) if not one), len(lines))
    heading = next((line for line in lines[before:] if line.strip()), "")
    separator = max(",;\t", key=heading.count)
    records = _records(path, expected, lines, before, separator)
    _, names = next(records, ("", []))
    # Spreadsheets write empty columns at the end.
    last = max((k for k, name in enumerate(names, start=1) if name), default=0)
    header = tuple(_column(name, other_names or {}) for name in names[:last])
    found = [(where, _by_column(where, header, cells)) for where, cells in records]
    if not header:
        raise InputError(f"{path} is empty; {expected}")
    if twice := {name for name in header if name and header.count(name) > 1}:
        raise InputError(f"{path} has the column `{twice.pop()[:_SHOWN]}` twice; {expected}")
    marks = "."
    if separator != ",":
        marks = _marks_in(
            (name, cell) for _, cells in found for name, cell in cells.items() if name not in _TEXTS
        )
    rows = [Row(where, cells, marks, separator != ",") for where, cells in found]
    return Table(path, header, rows, list(map(_unquoted, lines[:before])))


def _records(
    path: str | Path, expected: str, lines: Sequence[str], before: int, separator: str
) -> Iterator[tuple[str, list[str]]]:
    """Yield the line and the cells of each record that is not empty.

    The first is the header; ``before`` lines of notes stand before it.
    """
    reader = csv.reader(lines[before:], delimiter=separator, skipinitialspace=True)
    try:
        for record in reader:
            cells = [unguarded(cell.strip()) for cell in record]
            if any(cells):
                yield f"{path}, line {before + reader.line_num}", cells
    except csv.Error as error:
        raise InputError(f"{path} cannot be read as CSV ({error}); {expected}") from None


def _by_column(where: str, header: Sequence[str], cells: Sequence[str]) -> dict[str, str]:
    """Return a row's cells by column; raises `InputError` for too many cells."""
    if any(cells[len(header) :]):
        raise InputError(
            f"{where} has {len(cells)} cells; expected {len(header)} for "
            f"`{','.join(header)[:_SHOWN]}`: put text with a separator in quotes"
        )
    return dict(zip(header, cells, strict=False))


def _unquoted(line: str) -> str:
    """Return a line of notes without the quotes of a spreadsheet."""
    return next(csv.reader([line]))[0] if line.startswith('"') else line


def _marks_in(cells: Iterable[tuple[str, str]]) -> str:
    """Return the marks of decimals in a table's cells.

    A cell is the name of its column, and its text. A mark before three digits tells nothing, except
    in degrees, which have no thousands: then points are taken for decimal ones, and commas may be
    either.
    """
    sure = set()
    seen = set()
    for name, text in cells:
        decimal = _DECIMAL.fullmatch(text)
        thousands = _THOUSANDS.fullmatch(text)
        if decimal and (not thousands or name in _LIMITS):
            sure.add(decimal[1])
        elif thousands and not decimal:
            # Two separators, or more than one mark: the first parts thousands.
            sure.add(_POINT_OR_COMMA[thousands[1]])
        elif decimal:
            seen.add(decimal[1])
    if not sure:
        sure = {"."} | seen
    return "".join(sorted(sure))


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

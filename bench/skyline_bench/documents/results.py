"""The records in a folder, and their values as pages show them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import InputError, MissingFileError
from skyline_bench.measuring import Row
from skyline_bench.records import read_record

Table = list[dict[str, str]]
"""The rows of a table by their headings."""


@dataclass(frozen=True, slots=True)
class Results:
    """The records in a folder.

    A record has the name of its file without ``.json``.
    """

    folder: Path
    _read: dict[str, list[Row]] = field(default_factory=dict)

    def rows(self, name: str, **about: object) -> list[Row]:
        """Return the rows of a record that have these values.

        Raises `MissingFileError` without the record, and `InputError` for no such row.
        """
        path = self.folder / f"{name}.json"
        if name not in self._read:
            if not path.is_file():
                raise MissingFileError(
                    f"{path} does not exist; make it first: skyline-bench --help"
                )
            self._read[name] = read_record(path)["rows"]
        found = [row for row in self._read[name] if about.items() <= row.items()]
        if not found:
            raise InputError(f"{path} has no row with {about}; make it again")
        return found

    def row(self, name: str, **about: object) -> Row:
        """Return the one row of a record that has these values.

        Raises as `rows`.
        """
        found = self.rows(name, **about)
        if len(found) > 1:
            raise InputError(
                f"{self.folder / name}.json has {len(found)} rows with {about}; one is expected"
            )
        return found[0]


def linked(words: str, record: str) -> str:
    """Return words with a link to a record.

    The link is from the root of the repository.
    """
    return f"[{words}](bench/results/{record}.json)"


def percent(share: float | None) -> str:
    """Return a share in percent, as text.

    ``all`` and ``0`` are exactly the whole and nothing.
    """
    if share is None:
        return ""
    if share in (0.0, 1.0):
        return "all" if share else "0"
    whole = math.floor(100.0 * share + 0.5)
    if whole in (0, 100):
        return f"{min(max(100.0 * share, 0.1), 99.9):.1f} %"
    return f"{whole} %"


def with_interval(row: Row) -> str:
    """Return the share within 200 m in percent, with its interval."""
    low, high = (100.0 * row[f"within_200m_{end}"] for end in ("low", "high"))
    return f"{percent(row['within_200m'])} ({low:.0f} to {high:.0f})"


def count(number: float) -> str:
    """Return a whole number, with commas between thousands."""
    return f"{number:,.0f}"


def digits(value: float, number: int = 2) -> str:
    """Return a value with ``number`` digits, never with an exponent."""
    if not value:
        return "0"
    return np.format_float_positional(value, number, unique=False, fractional=False).rstrip(".")


def metres(value: float) -> str:
    """Return a distance in metres, or from 5 km on in kilometres."""
    if not math.isfinite(value):
        return "-"
    return f"{value / 1e3:.1f} km" if value >= 5000.0 else f"{value:,.0f} m"


def answered_right(rows: Sequence[Row]) -> tuple[int, int]:
    """Return how many photographs are answered, and how many of these rightly."""
    answered = [row for row in rows if row.get("answered")]
    return len(answered), sum(row["error_m"] <= row["within_m"] for row in answered)


def median_of(rows: Sequence[Row], key: str) -> float:
    """Return the median of a column.

    A missing value counts as infinite.
    """
    values: list[Any] = [math.inf if row.get(key) is None else row[key] for row in rows]
    return float(np.median(values))

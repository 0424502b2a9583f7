"""Shared by the commands: options, checks of files to be written, tables and records."""

import json
import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from typer import Argument, CallbackParam, Option

from skyline.errors import InputError
from skyline_bench.measuring import Row, shown, write_record

_PIPED_WIDTH = 300


def in_a_folder(param: CallbackParam, path: Path | None) -> Path | None:
    """Refuse a file that could not be written, before the measurement and not after it."""
    if path is not None and not path.absolute().parent.is_dir():
        raise InputError(f"{param.opts[0]} {path}: there is no folder {path.parent}; make it first")
    return path


def new_file(words: str, *names: str) -> Any:
    """Return an option for a file that is written."""
    return Option(*names, metavar="FILE", help=words, callback=in_a_folder)


Floats = list[float] | None
Names = list[str] | None
"""Of options that may be repeated."""

Dems = Annotated[
    list[str], Argument(metavar="DEM...", help="Elevation files: one, or tiles of one grid.")
]
JsonFile = Annotated[Path | None, new_file("Write rows and machine as JSON.", "--json")]
PlotFile = Annotated[Path | None, new_file("Draw them: PNG, PDF or SVG.", "--plot")]
Seed = Annotated[int, Option(min=0, help="Of all random draws.")]
Quick = Annotated[bool, Option("--quick", help="Two minutes at most: much smaller.")]
Folder = Annotated[
    Path | None, Option(help="Keep stores here; those that are there are not built again.")
]
Crs = Annotated[str | None, Option(help="The DEM's CRS where its file has none, e.g. EPSG:32632.")]


@contextmanager
def store_folder(kept: Path | None) -> Iterator[Path]:
    """Give a folder for stores: the one named, made if need be, else a temporary one."""
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        yield kept
        return
    with tempfile.TemporaryDirectory(prefix="skyline-bench-") as passing:
        yield Path(passing)


def report(
    json_file: Path | None, bench: str, rows: Sequence[Row], columns: str | None = None
) -> None:
    """Print the table of a benchmark and write its record where one is asked for."""
    print_rows(rows, columns)
    write_record(json_file, bench, rows)


def rows_but(json_file: Path | None, key: str, value: str) -> list[Row]:
    """Return the rows of an existing record, but those of a value, which are measured anew.

    Raises `InputError` for a file that is no record of the same benchmark.
    """
    if json_file is None or not json_file.exists():
        return []
    try:
        rows = json.loads(json_file.read_text(encoding="utf-8"))["rows"]
        return [row for row in rows if row[key] != value]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"--json {json_file} is no record of this benchmark; name a new file, or remove it"
        ) from error


def print_rows(rows: Sequence[Row], columns: str | None = None) -> None:
    """Print rows as a table; ``columns`` are the keys shown, ``key`` or ``key=heading``, or all.

    Underscores become spaces. Bytes are shown as megabytes.
    """
    asked = columns.split() if columns else dict.fromkeys(key for row in rows for key in row)
    headings = {}
    for key, _, heading in (one.partition("=") for one in asked):
        headings[key] = re.sub("bytes$", "MB", heading or key).replace("_", " ")
    table = Table(box=SIMPLE_HEAD)
    for key, heading in headings.items():
        words = any(isinstance(row.get(key), str) for row in rows)
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    for row in rows:
        cells = ((row.get(key), heading.endswith("MB")) for key, heading in headings.items())
        table.add_row(*(shown(value / 1e6 if mega and value else value) for value, mega in cells))
    console = Console()
    # A file or a pipe has no width that figures would have to be cut to.
    (console if console.is_terminal else Console(width=_PIPED_WIDTH)).print(table)

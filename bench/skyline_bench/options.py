"""Options, checks of outputs, and tables that the commands share."""

import inspect
import io
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from typer import Argument, CallbackParam, Option

from skyline.errors import InputError, suffix_of
from skyline.files.disk import check_outputs
from skyline_bench.measuring import Row, shown
from skyline_bench.records import KEPT, READ, WRITTEN, Run, note_files, write_record

_WIDTH = 100
"""Columns of the widest table that is printed; a wider one is printed in parts."""
_DRAWN = ".png", ".pdf", ".svg"
_MOST_WORDS = 40
"""Columns of the widest words; longer ones are folded."""
_ABOUT = {"n", "km2", "queries", "kind", "group", "matcher"}
"""Columns in every part of a table: how many of what kind, in which area."""
_FIRST = 3
"""Columns at the beginning of a table that may say in words what a row is about."""


def read_here(context: typer.Context, param: CallbackParam, value: Any) -> Any:
    """Note files or folders that a command reads.

    Their digests are in the command's record.
    """
    note_files(context, param, READ)
    given = value if isinstance(value, list | tuple) else [value]
    _check_apart(context, read=[Path(one) for one in given if one is not None])
    return value


def written_here(context: typer.Context, param: CallbackParam, path: Path | None) -> Path | None:
    """Refuse a file that could not be written, before the measurement."""
    note_files(context, param, WRITTEN)
    if path is not None:
        if not path.absolute().parent.is_dir():
            raise InputError(
                f"{param.opts[0]} {path}: there is no folder {path.parent}; make it first"
            )
        _check_apart(context, written=[path])
    return path


def _check_apart(
    context: typer.Context, *, read: Sequence[Path] = (), written: Sequence[Path] = ()
) -> None:
    """Refuse an output that is an input, an output too, or a folder.

    Parameters are processed one by one: each is compared with those before it.
    """
    inputs, outputs = context.meta.setdefault("skyline_bench.paths", ([], []))
    inputs.extend(read)
    outputs.extend(written)
    check_outputs(outputs, inputs)


def _kept_here(context: typer.Context, param: CallbackParam, path: Path | None) -> Path | None:
    note_files(context, param, KEPT)
    return path


def _recorded(context: typer.Context, param: CallbackParam, path: Path | None) -> Run:
    return Run(context, written_here(context, param, path))


def read_argument(metavar: str, words: str) -> Any:
    """Return an argument for files or folders that are read."""
    return Argument(metavar=metavar, help=words, callback=read_here)


def read_option(metavar: str, words: str) -> Any:
    """Return an option for files or folders that are read."""
    return Option(metavar=metavar, help=words, callback=read_here)


def new_file(words: str, *names: str, suffixes: Sequence[str] = ()) -> Any:
    """Return an option for a file that is written.

    It has one of ``suffixes``, if any are given.
    """

    def written(context: typer.Context, param: CallbackParam, path: Path | None) -> Path | None:
        if path is not None and suffixes:
            suffix_of(path, suffixes)
        return written_here(context, param, path)

    return Option(*names, metavar="FILE", help=words, callback=written)


def quick_with(**smaller: Any) -> Any:
    """Return the option ``--quick``, which gives other options smaller defaults.

    The value of an option that is given on the command line stays as it is given.
    """

    def shrink(context: typer.Context, is_quick: bool) -> bool:
        if is_quick:
            context.default_map = {**(context.default_map or {}), **smaller}
        return is_quick

    values = ", ".join(
        f"--{name.replace('_', '-')} {one}"
        for name, value in smaller.items()
        for one in (value if isinstance(value, list) else [value])
    )
    words = "Much smaller: two minutes at most, unless other options ask for more"
    about = f"{words}; by default {values}." if values else f"{words}."
    return Option("--quick", help=about, is_eager=True, callback=shrink)


Floats = list[float] | None
Names = list[str] | None
"""The values of an option that may be repeated."""

Dems = Annotated[
    list[str],
    read_argument("DEM...", "Elevation files: one, or tiles of one grid."),
]
Record = Annotated[
    Run | None,
    Option(
        "--json",
        metavar="FILE",
        help="Write rows, command, data and machine as JSON.",
        parser=Path,
        callback=_recorded,
    ),
]
PlotFile = Annotated[
    Path | None, new_file("Draw them: PNG, PDF or SVG.", "--plot", suffixes=_DRAWN)
]
Seed = Annotated[int, Option(min=0, help="Of all random draws.")]
Quick = Annotated[bool, quick_with()]
Folder = Annotated[
    Path | None,
    Option(help="Keep stores here; those that are there are not built again.", callback=_kept_here),
]
Crs = Annotated[str | None, Option(help="The DEM's CRS where its file has none, e.g. EPSG:32632.")]


def add_command(
    app: typer.Typer, command: Callable[..., None], takes: str, subject: str | None = None
) -> None:
    """Add a command with its docstring and the time it takes.

    The time is on 2 cores without a GPU. Help lists the command under its subject.
    """
    about = inspect.getdoc(command) or ""
    app.command(
        command.__name__.replace("_", "-"),
        help=f"{about}\n\nOn 2 cores without a GPU it takes {takes}.",
        short_help=f"{about.splitlines()[0].rstrip('.')} ({takes}).",
        rich_help_panel=subject,
    )(command)


@contextmanager
def store_folder(kept: Path | None) -> Iterator[Path]:
    """Yield a folder for stores.

    It is the named folder, which is made if necessary, else a temporary one.
    """
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        yield kept
        return
    with tempfile.TemporaryDirectory(prefix="skyline-bench-") as passing:
        yield Path(passing)


def report(
    record: Run | None, rows: Sequence[Row], columns: str | None = None, **about: Any
) -> None:
    """Print the table of a benchmark, and write its record.

    ``about`` is as in `write_record`.
    """
    print_rows(rows, columns)
    write_record(record, rows, **about)


def print_rows(rows: Sequence[Row], columns: str | None = None) -> None:
    """Print rows as a table, or as several that fit 100 columns.

    ``columns`` are the keys shown, as ``key`` or ``key=heading``; by default all. Underscores
    become spaces. Bytes are shown as megabytes, and values with their intervals, which rows have as
    ``key_low`` and ``key_high``; a row of one measurement (``n``) is shown without. Each part of a
    wide table begins with the words and has the columns of `_ABOUT`.
    """
    console = Console()
    wide = min(console.width, _WIDTH) if console.is_terminal else _WIDTH
    _print(Console(width=wide), rows, columns)


def print_tables(rows: Sequence[Row], columns: Mapping[str, str]) -> None:
    """Print one table for each value of ``measured`` in the rows.

    ``columns`` holds, for each of these values, the columns as in `print_rows`.
    """
    for measured, its_columns in columns.items():
        some = [row for row in rows if row["measured"] == measured]
        if some:
            print_rows(some, its_columns)


def table_text(rows: Sequence[Row], columns: str | None = None) -> str:
    """Return rows as text, as `print_rows` prints them."""
    text = io.StringIO()
    _print(Console(file=text, width=_WIDTH), rows, columns)
    return "\n".join(line.rstrip() for line in text.getvalue().strip("\n").splitlines())


def _print(console: Console, rows: Sequence[Row], columns: str | None) -> None:
    headings = _headings(rows, columns)
    repeated = _repeated(rows, headings)

    def width_of(keys: Iterable[str]) -> int:
        table = _table(rows, {key: headings[key] for key in keys})
        return Measurement.get(console, console.options.update(max_width=9999), table).maximum

    parts: list[list[str]] = [[]]
    for key in headings:
        if key in repeated:
            continue
        if parts[-1] and width_of([*repeated, *parts[-1], key]) > console.width:
            parts.append([])
        parts[-1].append(key)
    for part in parts:
        console.print(_table(rows, {k: headings[k] for k in headings if k in {*repeated, *part}}))


def _headings(rows: Sequence[Row], columns: str | None) -> dict[str, str]:
    """Return the columns to show, with their headings."""
    known = dict.fromkeys(key for row in rows for key in row)
    ends = {f"{key}_{end}" for key in known for end in ("low", "high")}
    asked = columns.split() if columns else [key for key in known if key not in ends]
    headings = {}
    for key, _, heading in (one.partition("=") for one in asked):
        headings[key] = re.sub("bytes$", "MB", heading or key).replace("_", " ")
    return headings


def _repeated(rows: Sequence[Row], headings: Mapping[str, str]) -> list[str]:
    """Return the columns that say what a row is about."""
    first = list(headings)[:_FIRST]
    words = max((at for at, key in enumerate(first, start=1) if _is_words(rows, key)), default=0)
    about = [key for key, name in headings.items() if {key, name} & _ABOUT]
    return [*dict.fromkeys([*first[:words], *about])]


def _is_words(rows: Sequence[Row], key: str) -> bool:
    return any(isinstance(row.get(key), str | Mapping) for row in rows)


def _table(rows: Sequence[Row], headings: Mapping[str, str]) -> Table:
    """Return a table of columns, with their headings."""
    table = Table(box=SIMPLE_HEAD)
    for key, heading in headings.items():
        if _is_words(rows, key):
            table.add_column(heading, max_width=_MOST_WORDS, overflow="fold")
        else:
            table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(row, key, heading) for key, heading in headings.items()))
    return table


def _cell(row: Row, key: str, heading: str) -> str:
    value, low, high = (row.get(name) for name in (key, f"{key}_low", f"{key}_high"))
    if low is not None and high is not None and row.get("n") != 1:
        return f"{shown(value)} ({shown(low)} to {shown(high)})"
    return shown(value / 1e6 if heading.endswith("MB") and value else value)

"""What the commands share: options, checks of what is to be written, and tables."""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from skyline.errors import InputError
from skyline_bench.measuring.record import Row

_PLOT_SUFFIXES = (".png", ".pdf", ".svg")
_PIPED_WIDTH = 200

Dems = Annotated[
    list[str], typer.Argument(metavar="DEM...", help="Elevation files: one, or tiles of one grid.")
]
JsonFile = Annotated[
    Path | None, typer.Option("--json", metavar="FILE", help="Write rows and machine as JSON.")
]
PlotFile = Annotated[
    Path | None, typer.Option("--plot", metavar="FILE", help="Draw them: PNG, PDF or SVG.")
]
Seed = Annotated[int, typer.Option(help="Of whatever is drawn at random.")]
Quick = Annotated[bool, typer.Option("--quick", help="A much smaller version.")]
Crs = Annotated[
    str | None, typer.Option(help="The DEM's CRS where its file has none, e.g. EPSG:32632.")
]


def check_outputs(json_file: Path | None, plot: Path | None) -> None:
    """Refuse files that could not be written, before the measurement and not after it."""
    for option, path in (("--json", json_file), ("--plot", plot)):
        check_folder(option, path)
    if plot is not None and plot.suffix.lower() not in _PLOT_SUFFIXES:
        raise InputError(
            f"--plot {plot}: cannot draw {plot.suffix!r}; expected {', '.join(_PLOT_SUFFIXES)}"
        )


def check_folder(option: str, path: Path | None) -> None:
    """Refuse a file in a folder that is not there."""
    if path is not None and not path.absolute().parent.is_dir():
        raise InputError(f"{option} {path}: there is no folder {path.parent}; make it first")


def check_report(folder: Path | None) -> None:
    """Make the folder of a report, and refuse one that nothing can be written to."""
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(
            f"--report {folder}: cannot be written to ({error.strerror}); name another folder"
        ) from error


@contextmanager
def store_folder(kept: Path | None) -> Iterator[Path]:
    """Give a folder for stores: the one named, made where it is not there, else one for now."""
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        yield kept
        return
    with tempfile.TemporaryDirectory(prefix="skyline-bench-") as passing:
        yield Path(passing)


def print_rows(rows: Sequence[Row], columns: dict[str, str]) -> None:
    """Print rows as a table; ``columns`` are the keys shown, with their headings."""
    table = Table(box=SIMPLE_HEAD)
    for key, heading in columns.items():
        words = any(isinstance(row.get(key), str) for row in rows)
        table.add_column(heading, justify="left" if words else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(_cell(row.get(key)) for key in columns))
    console = Console()
    # A file or a pipe has no width that figures would have to be cut to.
    (console if console.is_terminal else Console(width=_PIPED_WIDTH)).print(table)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)

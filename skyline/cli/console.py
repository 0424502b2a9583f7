"""Printing, progress and errors of all commands, and the options that several of them have.

An error is one line and an exit code; progress is a bar.
"""

import logging
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar
from typer import Argument, Option
from typer.core import TyperGroup

from skyline import __version__
from skyline.errors import (
    InputError,
    SkylineError,
    numbers_of,
    printable,
    start_logging,
    swapped_in_words,
)
from skyline.files import STANDARD, is_file

if TYPE_CHECKING:
    from skyline.arrays import Progress
    from skyline.terrain.heightfield import HeightField

# Typer's versions bring click under different names; this name is public in all of them.
_UsageError: Any = typer.BadParameter.__base__

_INTERRUPTED = 130
"""Exit code of a command stopped with Ctrl-C, which newer typers return instead of raising."""
_SLOW_S = 5.0
"""Time after which a message names the step that is taking long."""
_NOTE_EVERY_S = 60.0
"""Time between messages on how far a step is, where no bar is shown."""

_on_interrupt: ContextVar[tuple[str, Callable[[], bool]]] = ContextVar("on_interrupt")
_quiet = threading.Event()
"""Whether a command was given ``--quiet``."""


def panel(title: str) -> Callable[..., Any]:
    """Return a function that makes options listed under a title in the help."""
    return partial(Option, rich_help_panel=title)


def output_option(about: str, metavar: str = "FILE") -> Any:
    """Return the option that names the file or the folder that a command writes."""
    return Option("--output", "-o", metavar=metavar, help=about)


of_terrain, _spread = panel("Terrain and rendering"), panel("Many processors")

StoreFile = Annotated[Path, Argument(metavar="STORE.h5", help="A store, as `build` writes it.")]
AsJson = Annotated[bool, Option("--json", help="Print JSON.")]
StoreDem = Annotated[
    list[str] | None,
    Option(
        metavar="DEM",
        help="The store's DEM, if it has moved: a file or a folder of them; may be repeated.",
    ),
]
Workers = Annotated[
    str | None,
    _spread(
        metavar="N|ADDRESS",
        help="Spread the work over N processes of this machine, or over the dask cluster whose "
        "scheduler has this address, e.g. tcp://host:8786.",
    ),
]

Dems = Annotated[
    list[str],
    Argument(metavar="DEM...", help="Elevation files of one grid, or folders or zips of them."),
]
Surfaces = Annotated[
    list[str] | None,
    of_terrain(
        "--surface",
        metavar="FILE",
        help="A surface or canopy model, which gives the heights of trees and houses: a file, or a "
        "folder of them; may be repeated.",
    ),
]
RefractionK = Annotated[
    float,
    of_terrain(
        "--k",
        metavar="K",
        help="Refraction coefficient: the share of the Earth's curvature that refraction undoes.",
    ),
]
Crs = Annotated[
    str | None,
    of_terrain(metavar="CRS", help="CRS of a DEM whose files name none, e.g. EPSG:32632."),
]
PEAKS = Option(metavar="FILE", help="Peaks to name: GeoJSON, or CSV: name,lon,lat[,height_m].")


def command_line(name: str, about: str, commands: type[TyperGroup] | None = None) -> typer.Typer:
    """Return a command line that prints its help or, with ``--version``, its version.

    ``about`` is the first line of the help; ``commands`` the class of the group of commands.
    """
    app = typer.Typer(name=name, cls=commands, pretty_exceptions_enable=False)

    @app.callback(invoke_without_command=True, help=about)
    def options(
        context: typer.Context,
        version: Annotated[bool, Option("--version", help="Print the version.")] = False,
    ) -> None:
        if version:
            typer.echo(f"skyline {__version__}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            typer.echo(context.get_help())
            raise typer.Exit(2)

    return app


def with_quiet(command: Any) -> Any:
    """Give a command, or all commands of a group, the option ``--quiet``; return it."""
    group = getattr(command, "commands", {})
    for one in group.values():
        with_quiet(one)
    if not group:
        alone = typer.Typer(add_completion=False)
        alone.command()(_with_option)
        command.params += typer.main.get_command(alone).params
    return _without_types(command)


def _without_types(command: Any) -> Any:
    """Return a command whose flags show no type; Typer would show ``--json <bool>``."""
    for option in command.get_params(typer.Context(command)):
        if getattr(option, "is_flag", False):
            option.metavar = ""
    return command


def _be_quiet(quiet: bool) -> None:
    if quiet:
        _quiet.set()
    logging.getLogger().setLevel(logging.ERROR if quiet else logging.WARNING)


def _with_option(
    quiet: Annotated[
        bool,
        Option(
            "--quiet",
            "-q",
            help="Print results and errors only: no progress, notes or warnings.",
            callback=_be_quiet,
            expose_value=False,
        ),
    ] = False,
) -> None:
    """Do nothing: Typer takes the option of every command from this signature."""


def on_interrupt(message: str, is_kept: Callable[[], bool] = lambda: True) -> None:
    """Set the advice that the error after Ctrl-C gives if work of this command was kept."""
    _on_interrupt.set((message, is_kept))


def run_app(app: typer.Typer) -> None:
    """Run a command line; every error is one line, exit code 2 for bad input, 1 for failure.

    A command whose output has no reader any more, as after ``| head``, ends with exit code 0.
    """
    _open_streams()
    start_logging()
    on_interrupt("")
    _quiet.clear()
    # Heights in HDF5 and NetCDF are only read, also in folders without file locks.
    os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
    try:
        code = _without_types(typer.main.get_command(app))(standalone_mode=False)
        if code == _INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(code)
    except SystemExit as stop:
        # Typer and rich would turn this into exit code 1.
        sys.exit(0 if isinstance(stop.__context__, BrokenPipeError) else stop.code)
    except SkylineError as error:
        _fail(str(error), error.exit_code)
    except _UsageError as error:
        if not error.format_message():
            sys.exit(2)  # A group of commands without a command has printed its help.
        _fail(error.format_message(), 2)
    except (KeyboardInterrupt, typer.Abort):
        message, is_kept = _on_interrupt.get()
        _fail(f"stopped; {message}" if message and is_kept() else "stopped", _INTERRUPTED)
    except MemoryError:
        _fail("out of memory; choose a smaller area or a larger spacing", 1)
    except OSError as error:
        _fail(f"the system reports: {error}", 1)
    finally:
        _flush_streams()


@contextmanager
def progress_bar(doing: str) -> "Iterator[Progress]":
    """Show a bar on standard error from the first step on; yields a function of done and total.

    Without a terminal, a line names a step that takes more than five seconds, and one a minute says
    how far it is, and how long the rest takes at the rate since its first step.
    """
    if _quiet.is_set() or not sys.stderr.isatty():
        noted_s = time.monotonic()
        first: tuple[float, int] | None = None

        def note(done: int, total: int) -> None:
            nonlocal noted_s, first
            now_s = time.monotonic()
            started_s, before = first = first or (now_s, done)
            if now_s - noted_s > _NOTE_EVERY_S and before < done < total:
                noted_s = now_s
                left_min = (now_s - started_s) * (total - done) / (done - before) / 60.0
                print_note(f"{doing}: {done} of {total}, about {left_min:.0f} min left")

        with note_if_slow(doing.partition(",")[0]):
            yield note
        return
    bar = ProgressBar(
        TextColumn(doing),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
    with bar:
        task = bar.add_task(doing, total=None, visible=False)
        yield lambda done, total: bar.update(task, completed=done, total=total, visible=True)


@contextmanager
def note_if_slow(doing: str) -> Iterator[None]:
    """Print a note on standard error if the block takes more than five seconds."""
    timer = threading.Timer(_SLOW_S, print_note, [f"{doing} takes a while ..."])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def read_terrain(dem: Sequence[str], crs: str | None) -> "HeightField":
    """Read a command's elevation model; a line names the step if it takes more than 5 seconds."""
    from skyline.terrain.dem import read_dem  # noqa: PLC0415  (slow to load)
    from skyline.terrain.provenance import DemOptions  # noqa: PLC0415  (slow to load)

    with note_if_slow("reading the elevation model"):
        return read_dem(dem, DemOptions(crs=crs))


def parse_bounds(text: str) -> tuple[float, float, float, float]:
    """Return W, S, E, N in degrees from ``W,S,E,N``; raises `InputError` for anything else."""
    error = f"bounds are `{text}`; expected four numbers W,S,E,N in degrees, e.g. 9.8,46.7,9.9,46.8"
    west, south, east, north = numbers_of(text.split(","), 4, error)
    return west, south, east, north


def parse_place(text: str) -> tuple[float, float]:
    """Return longitude and latitude from ``LON,LAT``; raises `InputError` for anything else."""
    error = f"the place is `{text}`; expected LON,LAT in degrees (WGS 84), e.g. 9.84,46.80"
    lon, lat = numbers_of(text.split(","), 2, error)
    if not are_degrees(lon, lat):
        swapped = f"; {swapped_in_words(lon, lat)}" if are_degrees(lat, lon) else ""
        raise InputError(error + swapped)
    return lon, lat


def are_degrees(lon: float, lat: float) -> bool:
    """Return whether two numbers can be a longitude and a latitude."""
    return -180.0 <= lon <= 360.0 and -90.0 <= lat <= 90.0


def print_line(text: str) -> None:
    """Print one line to standard output; characters that cannot be shown are escaped."""
    typer.echo(printable(text))


def print_error(message: str) -> None:
    """Print an error as one line to standard error."""
    _print_aside("error: " + " ".join(message.split()))


def print_note(message: str) -> None:
    """Print a message as one line to standard error, unless ``--quiet`` is given."""
    if not _quiet.is_set():
        _print_aside(message)


def print_written(output: Path, text: str) -> None:
    """Print a line about a written file, or a note if the file is standard output."""
    (print_note if str(output) == STANDARD else print_line)(f"{output}: {text}")


def _print_aside(message: str) -> None:
    # Work goes on if standard error has no reader any more.
    with suppress(BrokenPipeError):
        print(printable(message), file=sys.stderr, flush=True)


def _open_streams() -> None:
    """Open the streams that the shell has closed (``>&-``): no other file must get their number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # The lowest number that is free is this one.
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115, PTH123  (for as long as we run)
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115, PTH123


def _flush_streams() -> None:
    """Discard output that cannot be written, for which Python would print an error at its end."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)


def _fail(message: str, code: int) -> None:
    print_error(message)
    sys.exit(code)


def lies_in_any(output: Path, folders: Iterable[str]) -> bool:
    """Return whether an output is one of some folders, or lies in one or in a folder of it."""
    place = output.resolve()
    return not {Path(one).resolve() for one in folders}.isdisjoint([place, *place.parents])


def check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path]) -> None:
    """Raise `InputError` for an output that is an input or another output, or cannot be made."""
    read = [path for path in inputs if is_file(path)]
    named = [path for path in outputs if path is not None]
    places = [path.resolve() for path in named]
    for path in named:
        if places.count(path.resolve()) > 1:
            raise InputError(f"{path} is the name of two outputs; choose another name for one")
        if path.exists() and any(path.samefile(one) for one in read):
            raise InputError(f"{path} is an input; choose another name for the output")
        folder = next(one for one in path.resolve().parents if one.exists())
        if str(path) != STANDARD and not os.access(folder, os.W_OK | os.X_OK):
            raise InputError(f"{path} cannot be written: there are no rights to write in {folder}")

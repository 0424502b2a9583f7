"""Command lines: their help, their option ``--quiet``, and how their runs end."""

import inspect
import logging
import os
import sys
from collections.abc import Callable
from typing import Annotated, Any, NoReturn

import typer
from typer import Option
from typer.core import TyperGroup

from skyline import __version__
from skyline.cli.terminal import Terminal
from skyline.errors import SkylineError, start_logging

# Typer's versions bring click under different names; this name is public in all of them.
_UsageError: Any = typer.BadParameter.__base__

_INTERRUPTED = 130
"""Exit code of a command stopped with Ctrl-C, which newer typers return instead of raising."""
_HELP = ["-h", "--help"]


def command_line(name: str, about: str, commands: type[TyperGroup] | None = None) -> typer.Typer:
    """Return a command line that prints its help or its version.

    The version is printed with ``--version``. ``about`` is the first line of the help, and
    ``commands`` the class of the group of commands.
    """
    app = typer.Typer(
        name=name,
        cls=commands,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": _HELP},
    )

    @app.callback(invoke_without_command=True, help=about)
    def options(
        context: typer.Context,
        version: Annotated[bool, Option("--version", "-v", help="Print the version.")] = False,
    ) -> None:
        if version:
            typer.echo(f"skyline {__version__}")
            raise typer.Exit
        if context.invoked_subcommand is None:
            typer.echo(context.get_help())
            raise typer.Exit(2)

    return app


def command_of(found: Callable[..., Any] | typer.Typer, name: str) -> Any:
    """Return a command, or a group of them, with the option ``--quiet``."""
    if isinstance(found, typer.Typer):
        return _tidy(_with_quiet(typer.main.get_group(found)))
    alone = typer.Typer(add_completion=False)
    alone.command(name)(found)
    return _tidy(_with_quiet(typer.main.get_command(alone)))


def _with_quiet(command: Any) -> Any:
    """Return a command, or a group, with the option ``--quiet``.

    In a group, all commands get the option.
    """
    group = getattr(command, "commands", {})
    for one in group.values():
        _with_quiet(one)
    if not group:
        alone = typer.Typer(add_completion=False)
        alone.command()(_with_option)
        command.params += typer.main.get_command(alone).params
    return command


def _tidy(command: Any) -> Any:
    """Return a command, or a group of them, with a tidy help.

    Typer would show ``--json <bool>``, and break lines of the help where the docstring does.
    """
    for one in getattr(command, "commands", {}).values():
        _tidy(one)
    if command.help:
        paragraphs = inspect.cleandoc(command.help).split("\n\n")
        command.help = "\n\n".join(" ".join(one.split()) for one in paragraphs)
    for option in command.get_params(typer.Context(command, help_option_names=_HELP)):
        if getattr(option, "is_flag", False):
            option.metavar = ""
    return command


def _be_quiet(context: typer.Context, quiet: bool) -> None:
    if quiet:
        Terminal.of(context).is_quiet = True
    logging.getLogger().setLevel(logging.ERROR if quiet else logging.WARNING)


def _with_option(
    quiet: Annotated[
        bool,
        Option(
            "--quiet",
            "-q",
            envvar="SKYLINE_QUIET",
            help="Print results and errors only: no progress, notes or warnings.",
            callback=_be_quiet,
            expose_value=False,
        ),
    ] = False,
) -> None:
    """Do nothing: Typer takes the option of every command from this signature."""


def run_app(app: typer.Typer, terminal: Terminal | None = None) -> None:
    """Run a command line, and exit with its code.

    Every error is one line. The exit code is 2 for bad input and 1 for a failure. A command whose
    output has no reader any more, as after ``| head``, ends with exit code 0.
    """
    terminal = terminal or Terminal()
    _open_streams()
    start_logging()
    # Heights in HDF5 and NetCDF are only read, also in folders without file locks.
    os.environ.setdefault("HDF5_USE_FILE_LOCKING", "FALSE")
    try:
        with terminal.interruptible():
            command = _tidy(typer.main.get_command(app))
            code = command(standalone_mode=False, obj=terminal)
        if code == _INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(code)
    except SystemExit as stop:
        # Typer and rich would turn this into exit code 1.
        sys.exit(0 if isinstance(stop.__context__, BrokenPipeError) else stop.code)
    except SkylineError as error:
        _fail(terminal, str(error), error.exit_code)
    except _UsageError as error:
        if not error.format_message():
            sys.exit(2)  # A group of commands without a command has printed its help.
        message = error.format_message().rstrip(".")
        if error.ctx:
            see = " See" if message.endswith("?") else "; see"
            message += f"{see} `{error.ctx.command_path} --help`"
        _fail(terminal, message, 2)
    except (KeyboardInterrupt, typer.Abort):
        _fail(terminal, terminal.stopped(), _INTERRUPTED)
    except MemoryError:
        _fail(terminal, "out of memory; choose a smaller area or a larger spacing", 1)
    except OSError as error:
        _fail(terminal, f"the system reports: {error}", 1)
    finally:
        _flush_streams()


def _fail(terminal: Terminal, message: str, code: int) -> NoReturn:
    terminal.error(message)
    sys.exit(code)


def _open_streams() -> None:
    """Open the streams that the shell has closed (``>&-``).

    Otherwise another file would get the number of a stream.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # The lowest number that is free is this one.
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115, PTH123  (for as long as we run)
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115, PTH123


def _flush_streams() -> None:
    """Discard output that cannot be written.

    Otherwise Python would print an error for it when it exits.
    """
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)

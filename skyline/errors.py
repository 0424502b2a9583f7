"""Errors and log lines, of one line each.

An error says what was found, what was expected and what to do. Every error is also the builtin
error a Python caller would expect, and carries the exit code of the command line: 2 for bad input,
1 for a failure.
"""

import io
import logging
import os
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

_UNSHOWN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff\ufffe\uffff]"
)
"""Control characters, line ends, marks that turn the direction of text, and noncharacters."""


def printable(text: str | os.PathLike[str]) -> str:
    r"""Return text as one line that UTF-8, JSON and XML can hold.

    A line end becomes ``\n``, an escape ``\x1b``, and a byte of a file's name that is not UTF-8
    ``\xe4``, for example; all else stays as it is.
    """
    return _UNSHOWN.sub(lambda found: _escaped(found[0]), os.fspath(text))


def one_line(text: object) -> str:
    """Return any text, such as a library's error, as one line."""
    return " ".join(str(text).split())


def _escaped(letter: str) -> str:
    # Python keeps a byte that is not UTF-8 as the surrogate U+DC00 plus the byte (PEP 383).
    is_byte = "\udc80" <= letter <= "\udcff"
    return f"\\x{ord(letter) - 0xDC00:02x}" if is_byte else ascii(letter)[1:-1]


class SkylineError(Exception):
    """Base of Skyline's errors.

    ``str`` of an error is one line for the user.
    """

    exit_code = 1

    def __str__(self) -> str:
        # A message may name files, and file names may hold any character.
        return printable(super().__str__())


class InputError(SkylineError, ValueError):
    """A value, file or option that cannot be used as given."""

    exit_code = 2


class MissingFileError(SkylineError, FileNotFoundError):
    """A named file does not exist."""

    exit_code = 2


class OffMapError(InputError):
    """A location where no eye can stand.

    It lies outside the data or on a hole, or the eye would be below the ground.
    """


class StoreError(SkylineError, OSError):
    """A store that cannot be read or written.

    It is truncated or damaged, or the file is not a store.
    """

    exit_code = 2


class StoreMismatchError(InputError):
    """A store whose frame, DEM digest or configuration differs from the request."""


class ContextError(SkylineError, RuntimeError):
    """No OpenGL context, or one that lacks memory or a feature."""


class FetchError(SkylineError, OSError):
    """A server that does not answer, or whose answer cannot be used."""


class BusyError(SkylineError, BlockingIOError):
    """A file that another process is writing."""


class BuildError(SkylineError, RuntimeError):
    """A build in which some jobs failed.

    The parts of the other jobs are kept.
    """


def entry_named(what: str, name: str, known: Mapping[str, T]) -> T:
    """Return the entry with a name.

    Raises `InputError` if ``what`` has an unknown name.
    """
    if name not in known:
        raise InputError(f"{what} is {name!r}; expected one of {', '.join(known)}")
    return known[name]


def numbers_of(given: Any, count: int, error: str) -> tuple[float, ...]:
    """Return ``count`` given numbers as floats; raises `InputError` with ``error`` otherwise."""
    try:
        values = () if isinstance(given, str | bytes | Mapping) else tuple(given)
        has_text = any(isinstance(one, str | bytes) for one in values)
        numbers = () if has_text else tuple(map(float, values))
    except (TypeError, ValueError, OverflowError):
        numbers = ()
    if len(numbers) != count:
        raise InputError(error)
    return numbers


def numbers_in(text: str, count: int, error: str) -> tuple[float, ...]:
    """Return ``count`` numbers from text with commas; otherwise as `numbers_of`."""
    try:
        numbers = tuple(map(float, text.split(",")))
    except ValueError:
        numbers = ()
    return numbers_of(numbers, count, error)


def suffix_of(path: str | Path, known: Iterable[str]) -> str:
    """Return a path's suffix in lower case.

    Raises `InputError` for an unknown suffix.
    """
    suffix = Path(path).suffix.lower()
    entry_named(f"the suffix of {path}", suffix, dict.fromkeys(known))
    return suffix


def check_suffix(path: str | Path, known: Iterable[str]) -> None:
    """Raise `InputError` for a path with an unknown suffix.

    A path without a suffix is accepted.
    """
    if Path(path).suffix:
        suffix_of(path, known)


def some_of(names: Sequence[str], most: int = 5) -> str:
    """Return the first names and the number of others, in words."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def swapped_in_words(*given: float, names: str = "longitude and latitude") -> str:
    """Return a hint with each pair of coordinates in swapped order."""
    right = ",".join(
        f"{second:.10g},{first:.10g}" for first, second in zip(given[::2], given[1::2], strict=True)
    )
    return f"{names} seem to be swapped: give {right}"


def library(name: str, what: str, package: str | None = None) -> Any:
    """Import and return the library that ``what`` needs.

    Without it, raises an `InputError` that says how to install it. The error names the package, not
    Skyline's extra: a package index need not have Skyline.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise InputError(
            f"{what} needs {name}, which is not installed; pip install {package or name}"
        ) from error


class _Lines(logging.Formatter):
    """Formats a record's message as one line."""

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802  (logging's name)
        return f"{record.levelname.lower()}: {printable(record.message)}"


def start_logging() -> None:
    """Send this process's log to standard error, without GDAL's own lines."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal whose encoding has no degree sign must not end the run.
            stream.reconfigure(errors="backslashreplace")
    handler = logging.StreamHandler()
    handler.setFormatter(_Lines())
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    # A file that GDAL cannot read becomes an error of one line; GDAL's own lines only confuse.
    logging.getLogger("rasterio").setLevel(logging.CRITICAL)

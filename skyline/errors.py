"""Errors that speak to a user: what, the value, what was expected, what to do next.

Every error is also the builtin error a Python caller would expect, and carries the exit
code of the command line: 2 for bad input, 1 for a failure.
"""

from collections.abc import Mapping
from typing import TypeVar

from skyline.text import printable

T = TypeVar("T")


class SkylineError(Exception):
    """Anything Skyline reports on purpose; ``str`` of it is one line for the user."""

    exit_code = 1

    def __str__(self) -> str:
        # A message names files, whose names may hold anything.
        return printable(super().__str__())


class InputError(SkylineError, ValueError):
    """A value, file or option that cannot be used as given."""

    exit_code = 2


class MissingFileError(SkylineError, FileNotFoundError):
    """A file that was named does not exist."""

    exit_code = 2


class OffMapError(InputError):
    """A location outside the data, on a hole, or an eye below the ground."""


class StoreError(SkylineError, OSError):
    """A store that cannot be read or written: truncated, damaged or not a store."""

    exit_code = 2


class StoreMismatchError(InputError):
    """A store whose frame, DEM digest or configuration differs from the request."""


class ContextError(SkylineError, RuntimeError):
    """No OpenGL context could be made, or the one at hand cannot do what is needed."""


class FetchError(SkylineError, OSError):
    """A server that does not answer, or answers with something that cannot be used."""


class BuildError(SkylineError, RuntimeError):
    """A build some of whose jobs failed; what the others made is kept."""


def named(what: str, name: str, known: Mapping[str, T]) -> T:
    """Return one of many by its name; raises `InputError` for a name that is not known."""
    if name not in known:
        raise InputError(f"{what} is {name!r}; expected one of {', '.join(known)}")
    return known[name]

"""Files on disk: reading them, writing them whole or not at all, locks, and names for GDAL."""

import fcntl
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import TextIO

from skyline.errors import InputError, MissingFileError

STANDARD = "-"
"""The name of standard input and output among paths."""


def read_bytes(path: str | Path, expected: str) -> bytes:
    """Return a file's content, or that of standard input for ``-``, which may be read again.

    Raises `MissingFileError` and `InputError`, with what was ``expected``.
    """
    if str(path) == STANDARD:
        return _content(sys.stdin)
    if not Path(path).exists():
        raise MissingFileError(f"{path} does not exist; {expected}")
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}); {expected}") from error


@cache
def _content(stream: TextIO) -> bytes:
    return stream.buffer.read()


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file at once, or to standard output for ``-``; a failure leaves what was there.

    Raises `InputError` where the file cannot be written.
    """
    content = content.encode() if isinstance(content, str) else content
    if str(path) == STANDARD:
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
        return
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        if partial.is_file():
            partial.unlink()
        raise InputError(
            f"{path} cannot be written ({error.strerror}); name a file in a folder that exists and "
            "has room"
        ) from error


def write_with_folders(path: Path, content: bytes | str) -> None:
    """Write a file at once, and make missing folders; otherwise as `write_whole`."""
    with suppress(OSError):  # Then the file cannot be written either.
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content)


def has_locks(path: Path) -> bool:
    """Return whether a file can be locked; in some network folders none can."""
    with path.open("rb") as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return True


def for_gdal(name: str) -> str:
    """Return a path or address that GDAL is to open; `InputError` where it is not UTF-8."""
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{name} cannot be opened by GDAL, since it is not UTF-8; rename the file or folder, "
            "or name a link to it"
        ) from None
    return name


def is_file(path: str | Path) -> bool:
    """Return whether there is a file of this name; an address may be too long to be one."""
    try:
        return Path(path).is_file()
    except OSError:
        return False

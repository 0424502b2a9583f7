"""Reading files, and writing them whole or not at all.

Marks tell Skyline's own files from others. Versions and digests show whether a file has changed.
"""

import hashlib
import os
import stat
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path, PureWindowsPath
from typing import TextIO
from uuid import uuid4

from skyline.errors import InputError, MissingFileError, printable
from skyline.files.gdal_names import on_disk

REPORT_PAGE = "index.html"
"""The page of a report's folder."""
PAGE_MARK = '<meta name="generator" content="Skyline">'
"""The mark of the pages that Skyline writes."""
STORE_SCHEMA = "skyline-store"
"""The attribute ``schema``, which tells a store from other HDF5 files in GDAL."""
STORE_SUFFIXES = (".h5", ".hdf5")
"""Suffixes of stores."""
STANDARD = "-"
"""The path that stands for standard input and output."""


def read_bytes(path: str | Path, expected: str) -> bytes:
    """Return the content of a file, or of standard input for ``-``.

    Standard input may be read again. Raises `MissingFileError` and `InputError`, whose messages end
    with what was ``expected``.
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
    """Return all bytes of a stream, which can be read only once."""
    return stream.buffer.read()


def write_whole(path: Path, content: bytes | str) -> None:
    """Write a file whole or not at all.

    The path ``-`` is standard output. Missing folders are made, so that hours of work are not lost
    to them. After a failure the file and the folders are as they were. A link stays, and its target
    is written; devices and pipes are written, too. Raises `InputError` where the file cannot be
    written.
    """
    content = content.encode() if isinstance(content, str) else content
    if str(path) == STANDARD:
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
        return
    made = list[Path]()
    try:
        if path.is_char_device() or path.is_fifo():
            path.write_bytes(content)
        else:
            target = Path(os.path.realpath(path))
            made = [one for one in target.parents if not one.exists()]
            target.parent.mkdir(parents=True, exist_ok=True)
            with appearing(target) as partial:
                partial.write_bytes(content)
    except OSError as error:
        with suppress(OSError):
            for folder in made:
                folder.rmdir()
        raise InputError(
            f"{path} cannot be written ({error.strerror}); name a file that can be made, on a "
            "disk with room"
        ) from error


@contextmanager
def appearing(path: Path) -> Iterator[Path]:
    """Yield a file's temporary name; give it its own at the end.

    So a file appears whole or not at all, even if another process is writing it.
    """
    partial = path.with_name(f".{path.name}.{uuid4().hex[:12]}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def has_mark(path: Path, mark: bytes) -> bool:
    """Return whether a mark is in the first kilobyte of a file."""
    try:
        with path.open("rb") as file:
            return mark in file.read(1024)
    except OSError:
        return False


def is_name_of(name: str, path: Path) -> bool:
    """Return whether a file's name is a path's, in any folder.

    The name may come from another system.
    """
    return PureWindowsPath(name).name == PureWindowsPath(printable(path)).name


def is_own_page(path: Path) -> bool:
    """Return whether a file has the mark of Skyline's pages."""
    return has_mark(path, PAGE_MARK.encode())


def check_outputs(
    outputs: Iterable[Path | None], inputs: Iterable[Path], folder: Path | None = None
) -> None:
    """Check the outputs of a command: files, and perhaps a folder.

    Raises `InputError` for an output that is an input or another output, or that cannot be made.
    """
    read = [path for path in inputs if is_file(path)]
    named = [path for path in (*outputs, folder) if path is not None]
    resolved = [path.resolve() for path in named]
    for path in named:
        if resolved.count(path.resolve()) > 1:
            raise InputError(f"{path} is the name of two outputs; choose another name for one")
        if path.exists() and any(path.samefile(one) for one in read):
            raise InputError(f"{path} is an input; choose another name for the output")
        if path.is_dir() and path is not folder:
            raise InputError(f"{path} is a folder; name a file for the output")
        parent = next(one for one in path.resolve().parents if one.exists())
        if str(path) != STANDARD and not os.access(parent, os.W_OK | os.X_OK):
            raise InputError(f"{path} cannot be written: there are no rights to write in {parent}")


def is_file(path: str | Path) -> bool:
    """Return whether there is a file of this name.

    An address may be too long for the name of a file.
    """
    return os.path.isfile(path)  # noqa: PTH113  (`Path.is_file` raises an error for long names)


def version_of(path: str | Path) -> tuple[int, int, int] | None:
    """Return a file's size, modification time and status-change time.

    Returns None without a file. A member of an archive has the version of the archive. Times are in
    nanoseconds. Copying and unpacking may keep the modification time, but not the status-change
    time, which a change of permissions or of the name updates, too.
    """
    try:
        known = Path(on_disk(path)).stat()
    except (OSError, ValueError):
        return None
    is_file = stat.S_ISREG(known.st_mode)
    return (known.st_size, known.st_mtime_ns, known.st_ctime_ns) if is_file else None


def digest_of(*parts: object, digits: int = 12) -> str:
    """Return a hexadecimal digest of names, versions and settings of files."""
    # Names of files are bytes, which need not be UTF-8.
    return hashlib.sha256(repr(parts).encode("utf-8", "surrogateescape")).hexdigest()[:digits]


def cache_folder() -> Path:
    """Return ``$SKYLINE_CACHE``, else ``$XDG_CACHE_HOME/skyline``, else ``~/.cache/skyline``."""
    if given := os.environ.get("SKYLINE_CACHE"):
        return Path(given).absolute()
    base = os.environ.get("XDG_CACHE_HOME")
    # The standard wants relative paths to be left aside.
    if not base or not Path(base).is_absolute():
        base = os.path.expanduser("~/.cache")  # noqa: PTH111  (Path raises without a home)
    return Path(base).absolute() / "skyline"

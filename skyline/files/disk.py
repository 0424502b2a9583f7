"""Files on disk: reading, writing, folders, locks, and names for GDAL.

A file is written whole or not at all.
"""

import fcntl
import hashlib
import os
import re
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from pathlib import Path, PurePath, PureWindowsPath
from typing import NoReturn, TextIO
from uuid import uuid4

from skyline.errors import InputError, MissingFileError, printable

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

_FILE_SUFFIXES = {
    ".csv", ".geojson", ".gpkg", ".gpx", ".h5", ".hdf5", ".htm", ".html", ".jpeg", ".jpg", ".json",
    ".kml", ".kmz", ".npz", ".pdf", ".png", ".svg", ".tif", ".tiff", ".txt", ".zip",
}  # fmt: skip
"""Suffixes that nobody gives to a folder."""

_SYSTEM_FOLDERS = {
    "__macosx", "@eadir", "$recycle.bin", "system volume information", "lost+found",
}  # fmt: skip
"""Folders that systems make beside a person's own, in lower case."""
_MEMBER = re.compile(r"/vsizip/\{(.+?\.zip)\}/(.+)", re.DOTALL | re.IGNORECASE)
"""The name by which GDAL opens a member of a zip archive."""


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


def check_folder(path: Path) -> None:
    """Raise `InputError` for a path that cannot be a folder.

    It is a file, or a new folder with the suffix of a file.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path} is a file; name a folder")
    suffix = path.suffix.lower()
    if suffix in _FILE_SUFFIXES and not path.exists():
        raise InputError(f"{path} would be a folder, and {suffix} promises a file; name a folder")


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


def files_in(folder: Path, is_skipped: Callable[[Path], bool] = lambda _: False) -> list[Path]:
    """Return the files below a folder, in order of path.

    Hidden files and folders are left out, and so are folders that systems make or for which
    ``is_skipped`` returns True. Links are followed, and each folder is listed once; a link without
    a target is a file. Raises `InputError` where a folder cannot be listed.
    """

    def refuse(error: OSError) -> NoReturn:
        raise InputError(f"{error.filename} cannot be read: {error.strerror}") from error

    found: list[Path] = []
    listed: set[str] = set()
    for here, folders, names in os.walk(folder, onerror=refuse, followlinks=True):
        if os.path.realpath(here) in listed or is_skipped(Path(here)):
            folders.clear()
            continue
        listed.add(os.path.realpath(here))
        folders[:] = [one for one in folders if not is_of_system(one)]
        files = (Path(here, name) for name in names if not is_of_system(name))
        found += (file for file in files if file.is_file() or not file.exists())
    return sorted(found)


def is_of_system(name: str) -> bool:
    """Return whether a file or folder is hidden or a system's own."""
    return name.startswith(".") or name.lower() in _SYSTEM_FOLDERS


def names_in_words(names: Sequence[str]) -> str:
    """Return the names of files in words.

    One file of each suffix is named, with the number of the others.
    """
    most = 10
    kinds: dict[str, list[str]] = {}
    for name in names:
        kinds.setdefault(PurePath(name).suffix.lower(), []).append(name)
    shown = [
        some[0] if len(some) == 1 else f"{some[0]} and {len(some) - 1} more {kind}".rstrip()
        for kind, some in list(kinds.items())[:most]
    ]
    others = sum(map(len, list(kinds.values())[most:]))
    return ", ".join(shown + [f"{others} others"] * bool(others))


def left_out_in_words(names: Sequence[str], expected: str) -> str:
    """Return a clause on a folder's files that are left out."""
    if len(names) == 1:
        return f"1 file is left out, which is not a {expected}: {names_in_words(names)}"
    return f"{len(names)} files are left out, which are not {expected}: {names_in_words(names)}"


def has_locks(path: Path) -> bool:
    """Return whether a file can be locked.

    In some network folders none can.
    """
    with path.open("rb") as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
    return True


def lock_file(path: Path, before_waiting: Callable[[], object] | None = None) -> TextIO | None:
    """Lock a file, made if it is missing, and return it open.

    If another process holds the lock, returns None, or, with ``before_waiting``, calls it and waits
    for the lock. Where no file can be locked, the file is returned all the same. The holder of the
    lock may remove the file. Raises `OSError` if it cannot be made.
    """
    while True:
        with ExitStack() as opened:
            file = opened.enter_context(path.open("w"))
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if before_waiting is None:
                    return None
                before_waiting()
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:
                pass  # Some network folders have no locks.
            # A file that another process has removed meanwhile locks nothing.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    opened.pop_all()
                    return file


def lies_in_any(output: Path, folders: Iterable[str]) -> bool:
    """Return whether an output is one of some folders, or inside one.

    It may lie in a folder of such a folder.
    """
    resolved = output.resolve()
    return not {Path(one).resolve() for one in folders}.isdisjoint([resolved, *resolved.parents])


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


def for_gdal(name: str) -> str:
    """Return a path or an address for GDAL to open.

    Raises `InputError` if it is not UTF-8.
    """
    try:
        name.encode()
    except UnicodeEncodeError:
        raise InputError(
            f"{name} cannot be opened by GDAL, since it is not UTF-8; rename the file or folder, "
            "or name a link to it"
        ) from None
    return name


def member_name(archive: str | Path, member: str) -> str:
    """Return GDAL's name for a member of a zip archive."""
    return f"/vsizip/{{{archive}}}/{member}"


def archive_of(name: str) -> tuple[str, str] | None:
    """Return the archive and the member of a `member_name`.

    Returns None for any other name.
    """
    parts = _MEMBER.fullmatch(name)
    return None if parts is None else (parts[1], parts[2])


def on_disk(name: str | Path) -> str | Path:
    """Return the file that GDAL reads under a name.

    It is a member's archive, or the name itself.
    """
    parts = archive_of(str(name))
    return name if parts is None else parts[0]


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

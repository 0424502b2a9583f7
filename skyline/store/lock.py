"""One writer at a time, files that are complete or absent, and what h5py raises in one line."""

import fcntl
import logging
import os
import re
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path

from skyline.errors import MissingFileError, SkylineError, StoreError

_log = logging.getLogger(__name__)

RESUME = "committed rows are safe: make room, then resume it"
REBUILD = "copy or build it again"

UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""What h5py raises on files that are damaged or made by someone else."""


def shards_folder(path: Path) -> Path:
    """Return the folder of the tiles that a store is merged from when all of them are built."""
    return path.with_name(f"{path.name}.shards")


def missing_store(path: Path) -> MissingFileError:
    """Return the error that there is no store of a name, or that there is none yet."""
    folder = shards_folder(path)
    if not folder.is_dir():
        return MissingFileError(f"store {path} does not exist; check the name, or build it")
    return MissingFileError(
        f"store {path} does not exist yet: its build is not finished, and {folder} holds the "
        f"tiles done so far, {len(list(folder.glob('*.h5')))}; give the same command again"
    )


@contextmanager
def explained(path: Path, what: str, advice: str = REBUILD) -> Iterator[None]:
    """Turn what h5py raises into one line about the store."""
    try:
        yield
    except SkylineError:
        raise
    except UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        cause = re.search(r"error message = '([^']+)'", reason)
        reason = cause[1] if cause else reason
        raise StoreError(f"store {path}: {what} ({reason}); {advice}") from error


@contextmanager
def complete_or_absent(path: Path) -> Iterator[Path]:
    """Yield a name beside ``path``; the file made there takes its place, unless that fails."""
    partial = path.with_name(f"{path.name}.partial")
    try:
        with explained(path, "it cannot be created", "check the folder's rights and space"):
            partial.unlink(missing_ok=True)
            yield partial
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def writer_lock(path: Path) -> Iterator[None]:
    """Hold ``path``.lock; raise `StoreError` where another writer does.

    The kernel lets go of the lock when its holder dies, so a file left behind bars nobody. Where
    the file system has no locks, as some network folders have none, a warning takes their place.
    """
    lock = path.with_name(f"{path.name}.lock")
    what, advice = "it cannot be locked for writing", "check the folder's rights and space"
    with explained(path, what, advice):
        descriptor = _lock_file(path, lock)
    try:
        with explained(path, what, advice):
            os.ftruncate(descriptor, 0)
            os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(descriptor)


def _lock_file(path: Path, lock: Path) -> int:
    while True:
        with ExitStack() as opened:
            descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o666)
            opened.callback(os.close, descriptor)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                holder = os.read(descriptor, 200).decode(errors="replace") or "another process"
                raise StoreError(
                    f"store {path} is being written by {holder}; wait for it to end, or stop it"
                ) from error
            except OSError as error:
                _warn_of_no_locks(path.parent, error.strerror)
            # A holder that just ended may have removed the file after it was opened here.
            if lock.exists() and os.path.samestat(os.fstat(descriptor), lock.stat()):
                opened.pop_all()
                return descriptor


@cache
def _warn_of_no_locks(folder: Path, reason: str) -> None:
    """Warn once of a folder."""
    _log.warning(
        "folder %s has no file locks (%s): nothing keeps two processes from writing one store "
        "there at the same time; see to it that only one does",
        *(folder, reason),
    )


@contextmanager
def new_store(path: Path, advice: str, *, overwrite: bool = False) -> Iterator[None]:
    """Hold the lock of a store that is to be made.

    Raises
    ------
    MissingFileError
        The folder does not exist.
    StoreError
        Something is there already, where that is not to be replaced, or somebody is writing it.
    """
    if not path.parent.is_dir():
        raise MissingFileError(
            f"store {path} cannot be created: folder {path.parent} does not exist; make it first"
        )
    with writer_lock(path):
        if path.is_dir() or (path.exists() and not overwrite):
            raise StoreError(f"store {path} cannot be created: it exists already; {advice}")
        yield

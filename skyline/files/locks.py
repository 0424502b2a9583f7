"""Locks of files, also in network folders that have none."""

import fcntl
import os
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TextIO


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

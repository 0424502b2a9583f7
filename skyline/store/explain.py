"""What h5py raises, in one line for a user."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from skyline.errors import SkylineError, StoreError

RESUME = "committed rows are safe: make room, then resume it"
REBUILD = "copy or build it again"

UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, OverflowError, MemoryError)
"""What h5py raises on files that are damaged or made by someone else."""


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

"""How far a match has come: told from within its steps to whoever asked.

Whoever asks may end the match, by raising from what is told.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

Told = Callable[[str, float], None]
"""Called with the step that a match is at, and the share of that step that is done."""

_told: ContextVar[Told | None] = ContextVar("told", default=None)


@contextmanager
def telling(told: Told | None) -> Iterator[None]:
    """Have `tell` call ``told`` within the block, in this thread."""
    token = _told.set(told)
    try:
        yield
    finally:
        _told.reset(token)


def tell(step: str, share: float) -> None:
    """Say how much of a step is done, from 0 to 1; raises what the one who is told raises."""
    told = _told.get()
    if told is not None:
        told(step, share)

"""How work tells its progress: by pieces, or by steps."""

from collections.abc import Callable
from enum import StrEnum

Progress = Callable[[int, int], None]
"""Called with the number of finished pieces of work, and the number of all pieces."""

StepProgress = Callable[[str, float], None]
"""Called with the current step of a match, a `Step` unless another package's matcher has steps of
its own, and the share of that step that is done, 0 to 1. An exception that it raises ends the
match."""


class Step(StrEnum):
    """A step of `locate`; from `SCREENING` on, a step of a match."""

    FETCHING = "fetching tiles"
    READING = "reading the elevation model"
    BUILDING = "building the store"
    SCREENING = "screening"
    FITTING = "fitting"
    REFINING = "refining"
    SURROUNDINGS = "searching around the best"


def silent(step: str, share: float) -> None:
    """Report nothing."""

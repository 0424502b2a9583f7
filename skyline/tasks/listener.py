"""What a task says while it works, to whoever has started it."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

from skyline.arrays import Progress


class Listener(Protocol):
    """Hears results, notes and errors as they come; a terminal prints them."""

    def result(self, record: Mapping[str, Any], text: str) -> None:
        """Hear a result, as a record and in lines of text.

        Raises `BrokenPipeError` if nobody reads results any more.
        """

    def remark(self, text: str) -> None:
        """Hear a line beside the results; raises as `result`."""

    def note(self, message: str) -> None:
        """Hear about the course of the work."""

    def error(self, message: str) -> None:
        """Hear an error that does not end the task."""

    def slow(self, doing: str) -> AbstractContextManager[None]:
        """Hear what the block does, which may take long."""

    def progress(self, doing: str) -> AbstractContextManager[Progress]:
        """Hear what the block does, and by the function yielded how far it is."""

    def keeps(self, advice: str, is_kept: Callable[[], bool] = ...) -> None:
        """Hear what is kept if the task is stopped, and whether there is anything yet."""

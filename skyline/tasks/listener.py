"""What a task shows while it works, to whoever started it."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Any, Protocol

from skyline.progress import Progress


class Listener(Protocol):
    """Receives results, notes and errors of a task as they come.

    A terminal prints them.
    """

    def result(self, record: Mapping[str, Any], text: str) -> None:
        """Receive a result, as a record and as lines of text.

        Raises `BrokenPipeError` if nobody reads results any more.
        """

    def remark(self, text: str) -> None:
        """Receive a line that belongs with the results; raises as `result`."""

    def note(self, message: str) -> None:
        """Receive a line about the course of the work."""

    def error(self, message: str) -> None:
        """Receive an error that does not end the task."""

    def slow(self, doing: str) -> AbstractContextManager[None]:
        """Run a block that may take long; ``doing`` says what it does."""

    def progress(self, doing: str) -> AbstractContextManager[Progress]:
        """Run a block that reports progress to the function yielded."""

    def keeps(self, advice: str, is_kept: Callable[[], bool] = ...) -> None:
        """Receive the advice for a person who stops the task.

        It is shown only if ``is_kept()`` is true then.
        """

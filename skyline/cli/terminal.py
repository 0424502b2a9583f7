"""The terminal of a command: results, notes, errors and progress.

An error is one line; progress is a bar.
"""

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as ProgressBar

from skyline.errors import printable
from skyline.files import STANDARD

if TYPE_CHECKING:
    from skyline.arrays import Progress

_SLOW_S = 5.0
_NOTE_EVERY_S = 60.0
"""Time between notes on how far a step is, where no bar is shown."""


class Terminal:
    """Prints what one run of a command has to say.

    Parameters
    ----------
    slow_s : float
        Time after which a note names the step that is taking long, seconds.

    Attributes
    ----------
    is_quiet : bool
        Whether only results and errors are printed.
    as_json : bool
        Whether results are printed as JSON.
    """

    def __init__(self, slow_s: float = _SLOW_S) -> None:
        self.is_quiet = False
        self.as_json = False
        self._slow_s = slow_s
        self._advice = ""
        self._is_kept: Callable[[], bool] = lambda: False
        self._is_interrupted = False

    @classmethod
    def of(cls, context: typer.Context, as_json: bool = False) -> "Terminal":
        """Return the terminal of a running command.

        It prints results as text or as JSON.
        """
        terminal = context.obj
        assert isinstance(terminal, cls)
        terminal.as_json = as_json
        return terminal

    def line(self, text: str) -> None:
        """Print one line to standard output.

        Characters that cannot be shown are escaped.
        """
        typer.echo(printable(text))

    def result(self, record: Mapping[str, Any], text: str) -> None:
        """Print a result.

        It is printed as its record in one line of JSON, or as the lines of its text.
        """
        for line in [json.dumps(record)] if self.as_json else text.splitlines():
            self.line(line)

    def remark(self, text: str) -> None:
        """Print a line beside the results; a note beside JSON."""
        (self.note if self.as_json else self.line)(text)

    def written(self, output: Path, text: str) -> None:
        """Print a line about a written file.

        It is a note if the file is standard output.
        """
        (self.note if str(output) == STANDARD else self.line)(f"{output}: {text}")

    def note(self, message: str) -> None:
        """Print a message to standard error, unless the command is quiet.

        It is printed as one line.
        """
        if not self.is_quiet:
            print_aside(message)

    def error(self, message: str) -> None:
        """Print an error as one line to standard error."""
        print_aside("error: " + " ".join(message.split()))

    def keeps(self, advice: str, is_kept: Callable[[], bool] = lambda: True) -> None:
        """Set the advice that the error after Ctrl-C gives.

        It is given only if ``is_kept()`` is true then: the command's work was kept.
        """
        self._advice = advice
        self._is_kept = is_kept

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """End the block at Ctrl-C, if not at once, then at the next step of progress.

        Python drops an interrupt that arrives while it clears away a dead weak reference.
        """

        def interrupt(*_: object) -> None:
            self._is_interrupted = True
            raise KeyboardInterrupt

        # A shell lets the jobs in its background ignore Ctrl-C.
        listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler
        if not listens or threading.current_thread() is not threading.main_thread():
            yield
            return
        signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    def stopped(self) -> str:
        """Return the error after Ctrl-C."""
        return f"stopped; {self._advice}" if self._is_kept() else "stopped"

    @contextmanager
    def progress(self, doing: str) -> "Iterator[Progress]":
        """Show a bar on standard error; yields a function of progress.

        The function takes the done steps and their total. The bar appears with the first step.
        Without a terminal, a line names a step that takes long, and one a minute says how far it
        is, and how long the rest takes at the rate since its first step.
        """
        with self._shown(doing) as show:

            def step(done: int, total: int) -> None:
                if self._is_interrupted:
                    raise KeyboardInterrupt
                show(done, total)

            yield step

    @contextmanager
    def _shown(self, doing: str) -> "Iterator[Progress]":
        """Yield a function that shows progress as a bar, or as notes without a terminal."""
        if self.is_quiet or not sys.stderr.isatty():
            with self.slow(doing.partition(",")[0]):
                yield self._notes_on(doing)
            return
        bar = ProgressBar(
            TextColumn(doing),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
        )
        with bar:
            task = bar.add_task(doing, total=None, visible=False)
            yield lambda done, total: bar.update(task, completed=done, total=total, visible=True)

    def _notes_on(self, doing: str) -> "Progress":
        """Return a function of progress that prints a note a minute.

        The function takes the done steps and their total.
        """
        noted_s = time.monotonic()
        first: tuple[float, int] | None = None

        def note(done: int, total: int) -> None:
            nonlocal noted_s, first
            now_s = time.monotonic()
            started_s, before = first = first or (now_s, done)
            if now_s - noted_s > _NOTE_EVERY_S and before < done < total:
                noted_s = now_s
                left_min = (now_s - started_s) * (total - done) / (done - before) / 60.0
                self.note(f"{doing}: {done} of {total}, about {left_min:.0f} min left")

        return note

    @contextmanager
    def slow(self, doing: str) -> Iterator[None]:
        """Print a note on standard error if the block takes long."""
        timer = threading.Timer(self._slow_s, self.note, [f"{doing} takes a while ..."])
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


def print_aside(message: str) -> None:
    """Print one line to standard error, if that still has a reader."""
    with suppress(BrokenPipeError):
        print(printable(message), file=sys.stderr, flush=True)

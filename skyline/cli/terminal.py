"""The terminal of a command: results, notes, errors and progress.

An error is one line; progress is a bar.
"""

import json
import os
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
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as ProgressBar

from skyline.errors import one_line, printable
from skyline.files.disk import STANDARD

if TYPE_CHECKING:
    from skyline.progress import Progress

_SLOW_S = 5.0
_NOTE_EVERY_S = 10.0
"""Time between notes on the progress of a step without a bar."""


def size_in_words(size: int) -> str:
    """Return a number of bytes in words, as kB or MB."""
    return f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"


class Terminal:
    """Prints the results, notes, errors and progress of one command.

    Parameters
    ----------
    slow_s : float
        Time after which a note names the step that is taking long, seconds.
    every_s : float
        Time between notes on the progress of a step without a bar, seconds.

    Attributes
    ----------
    is_quiet : bool
        Whether only results and errors are printed.
    as_json : bool
        Whether results are printed as JSON.
    """

    def __init__(self, slow_s: float = _SLOW_S, every_s: float = _NOTE_EVERY_S) -> None:
        self.is_quiet = False
        self.as_json = False
        self._slow_s = slow_s
        self._every_s = every_s
        self._bar: ProgressBar | None = None
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

        Characters that cannot be shown are escaped. A bar makes room for the line.
        """
        bar = self._bar
        if bar is not None:
            bar.stop()
        typer.echo(printable(text))
        if bar is not None:
            bar.start()

    def result(self, record: Mapping[str, Any], text: str) -> None:
        """Print a result as one line of JSON, or as text."""
        for line in [json.dumps(record)] if self.as_json else text.splitlines():
            self.line(line)

    def remark(self, text: str) -> None:
        """Print a line with the results; a note with JSON."""
        (self.note if self.as_json else self.line)(text)

    def written(self, output: Path, text: str) -> None:
        """Print a line about a written file; a note for standard output."""
        (self.note if str(output) == STANDARD else self.line)(f"{output}: {text}")

    def note(self, message: str) -> None:
        """Print a one-line message to standard error, unless the command is quiet."""
        if not self.is_quiet:
            print_aside(message)

    def error(self, message: str) -> None:
        """Print an error as one line to standard error."""
        print_aside("error: " + one_line(message))

    def keeps(self, advice: str, is_kept: Callable[[], bool] = lambda: True) -> None:
        """Set the advice that the error after Ctrl-C gives.

        It is given only if ``is_kept()`` is true then, because the command's work was kept.
        """
        self._advice = advice
        self._is_kept = is_kept

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """End the block at Ctrl-C: at once, or at the next progress.

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
        """Show progress, such as "3 of 6"; yield a function.

        The function takes the number of finished steps and their total. A terminal shows a bar.
        Elsewhere a line every ten seconds says how far the step is.
        """
        with self._shown(doing) as show:

            def step(done: int, total: int) -> None:
                if self._is_interrupted:
                    raise KeyboardInterrupt
                show(done, total)

            yield step

    @contextmanager
    def _shown(self, doing: str) -> "Iterator[Progress]":
        """Yield a function that shows progress as a bar or as notes."""
        if not self._has_bars:
            course = _Course(doing, self.note)
            with _repeated(course.tell, self._every_s):
                yield course.step
            return
        counted = BarColumn(), MofNCompleteColumn(separator=" of ")
        with self._shown_bar(doing, *counted, TimeElapsedColumn(), TimeRemainingColumn()) as show:
            yield show

    @property
    def _has_bars(self) -> bool:
        """Whether standard error is a terminal that can redraw lines."""
        return not self.is_quiet and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"

    @contextmanager
    def _shown_bar(self, doing: str, *columns: ProgressColumn) -> "Iterator[Progress]":
        """Show a line while the block runs; yield a function of progress."""
        bar = ProgressBar(
            # A name of a file in it may have brackets and braces.
            TextColumn("{task.description}", markup=False),
            *columns,
            console=Console(stderr=True),
            transient=True,
            # `line` writes results itself: they may go to a file.
            redirect_stdout=False,
        )
        with bar:
            self._bar = bar
            try:
                task = bar.add_task(printable(doing), total=None)
                yield lambda done, total: bar.update(task, completed=done, total=total)
            finally:
                self._bar = None

    @contextmanager
    def slow(self, doing: str) -> Iterator[None]:
        """Show that the block runs, or note that it takes long."""
        if self._has_bars and self._bar is None:
            with self._shown_bar(doing, SpinnerColumn(), TimeElapsedColumn()):
                yield
            return
        timer = threading.Timer(self._slow_s, self.note, [f"{doing} takes a while ..."])
        timer.daemon = True
        timer.start()
        try:
            yield
        finally:
            timer.cancel()


class _Course:
    """Tells in a log how far a step is.

    A step without progress, or of a single part, is named once.
    """

    def __init__(self, doing: str, note: Callable[[str], None]) -> None:
        self._doing = doing
        self._note = note
        self._first: tuple[float, int] | None = None
        self._done = 0
        self._total = 0
        self._is_named = False

    def step(self, done: int, total: int) -> None:
        """Receive the done parts and their total."""
        self._first = self._first or (time.monotonic(), done)
        self._done = done
        self._total = total

    def tell(self) -> None:
        """Print how far the step is, and the time left."""
        if self._first is None or self._total == 1:
            if not self._is_named:
                self._note(f"{self._doing.partition(',')[0]} takes a while ...")
            self._is_named = True
        elif self._done < self._total:
            self._note(f"{self._doing}: {self._done} of {self._total}{self._left(*self._first)}")

    def _left(self, started_s: float, before: int) -> str:
        """Return how long the rest will take, in words; at first empty."""
        if self._done == before:
            return ""
        passed_s = time.monotonic() - started_s
        left_s = passed_s * (self._total - self._done) / (self._done - before)
        left = f"{left_s:.0f} s" if left_s < 90.0 else f"{left_s / 60.0:.0f} min"
        return f", about {left} left"


@contextmanager
def _repeated(call: Callable[[], None], every_s: float) -> Iterator[None]:
    """Call a function at intervals while the block runs."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(every_s):
            call()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def print_aside(message: str) -> None:
    """Print one line to standard error, if that still has a reader."""
    with suppress(BrokenPipeError):
        print(printable(message), file=sys.stderr, flush=True)

"""Independent jobs, run by whoever runs them: in this process here, elsewhere on a cluster."""

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar

from skyline.errors import BuildError, SkylineError

T = TypeVar("T")
R = TypeVar("R")

Progress = Callable[[int, int], None]
"""Called with how much is done and how much there is to do."""

_NAMED = 5

_log = logging.getLogger(__name__)


class Runner(Protocol):
    """Does the same work on many items, in any order and anywhere.

    Both must be picklable for a runner that sends them to other processes. Yields the index of
    each item as it is done, with what the work returned or the exception it raised in the end.
    """

    def __call__(
        self, work: Callable[[T], R], items: Sequence[T], names: Sequence[str]
    ) -> Iterator[tuple[int, R | Exception]]:
        """Run ``work`` on every item; ``names`` are the items' names, each of them once."""
        ...


def run_here(
    work: Callable[[T], R], items: Sequence[T], _names: Sequence[str]
) -> Iterator[tuple[int, R | Exception]]:
    """Run jobs one after another in this process; a `Runner`."""
    for index, item in enumerate(items):
        try:
            done: R | Exception = work(item)
        except SkylineError as error:
            done = error
        yield index, done


def collect(
    outcomes: Iterator[tuple[int, R | Exception]],
    names: Sequence[str],
    finished: Callable[[R], None],
) -> list[R]:
    """Return all results in the items' order, telling each as it comes.

    Raises
    ------
    SkylineError
        The one that the only job raised.
    BuildError
        Some of several jobs failed; the first few are named with their reasons.
    """
    results: dict[int, R] = {}
    failures: dict[int, Exception] = {}
    for index, outcome in outcomes:
        if isinstance(outcome, Exception):
            failures[index] = outcome
            _log.warning("%s failed: %s", names[index], _line(outcome))
        else:
            results[index] = outcome
            finished(outcome)
    if failures:
        raise _failure(failures, names)
    return [results[index] for index in range(len(names))]


def in_order(outcomes: Iterator[tuple[int, R | Exception]]) -> Iterator[R | SkylineError]:
    """Yield results in the items' order, each as soon as those before it are there.

    In the place of a job that failed comes what it raised; `BuildError` for what is no
    `SkylineError`.
    """
    waiting: dict[int, R | Exception] = {}
    due = 0
    for index, outcome in outcomes:
        waiting[index] = outcome
        while due in waiting:
            result = waiting.pop(due)
            if isinstance(result, Exception) and not isinstance(result, SkylineError):
                result = BuildError(f"a worker failed: {_line(result)}")
            yield result
            due += 1


def _failure(failures: dict[int, Exception], names: Sequence[str]) -> SkylineError:
    first = next(iter(failures.values()))
    if len(names) == 1 and isinstance(first, SkylineError):
        return first
    said = [f"{names[index]} ({_line(failures[index])})" for index in sorted(failures)[:_NAMED]]
    more = f" and {len(failures) - _NAMED} more" if len(failures) > _NAMED else ""
    return BuildError(
        f"{len(failures)} of {len(names)} failed: {'; '.join(said)}{more}. The others are kept: "
        "mend the cause and give the same command, which goes on with what is left"
    )


def _line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return text if isinstance(error, SkylineError) else f"{type(error).__name__}: {text}"

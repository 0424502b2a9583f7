"""A thread that renders for all others; an urgent task is run before all tasks that wait.

An OpenGL context belongs to one thread. A program of many threads gives all its rendering to a
`RenderThread`; long work gives it piece by piece, so that an urgent task waits for one piece at
most.
"""

import itertools
import queue
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Self, TypeVar

from skyline.errors import ContextError
from skyline.render.context import release_context

T = TypeVar("T")

_URGENT, _USUAL, _LAST = 0, 1, 2
_Task = Callable[[], Any]


class RenderThread:
    """Runs tasks one after another on one thread, the urgent ones first.

    Renderers that are made in its tasks are used and released in its tasks alone.
    """

    def __init__(self) -> None:
        self._tasks: queue.PriorityQueue[tuple[int, int, Future[Any], _Task | None]] = (
            queue.PriorityQueue()
        )
        self._numbers = itertools.count()
        self._closing = threading.Lock()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="rendering", daemon=True)
        self._thread.start()

    def run(self, task: Callable[[], T], urgent: bool = False) -> T:
        """Run a task on the thread and return what it returns; raises what it raises.

        Parameters
        ----------
        urgent : bool
            Whether the task is run before all that are not urgent.

        Raises
        ------
        ContextError
            The thread was closed.
        """
        if threading.current_thread() is self._thread:
            return task()
        future: Future[T] = Future()
        with self._closing:
            if self._closed:
                raise ContextError("the render thread is closed; make another")
            self._put(_URGENT if urgent else _USUAL, future, task)
        return future.result()

    def close(self) -> None:
        """Finish the tasks that wait, release the OpenGL context and end the thread."""
        with self._closing:
            if not self._closed:
                self._closed = True
                self._put(_LAST, Future(), None)
        self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _put(self, rank: int, future: Future[Any], task: _Task | None) -> None:
        # Numbers keep the order within a rank, and futures from being compared.
        self._tasks.put((rank, next(self._numbers), future, task))

    def _work(self) -> None:
        while True:
            _, _, future, task = self._tasks.get()
            if task is None:
                with suppress(ContextError):  # The context belongs to another thread.
                    release_context()
                return
            try:
                future.set_result(task())
            except BaseException as error:  # The caller of `run` handles it.
                future.set_exception(error)
            # The result must not live on until the next task.
            del future, task

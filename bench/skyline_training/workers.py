"""Work in processes of its own, as many as there are cores so that none of them idles.

Workers hold the same big thing and do jobs on it, each with one thread, so that what is computed
does not depend on how many cores there are.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

from skyline.errors import BuildError, InputError

_ONE_THREAD = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_held: Any = None
"""In a worker: the thing that it holds."""


Crew = Callable[[Callable[[Any, Any], Any], Sequence[Any]], Iterator[tuple[Any, Any]]]
"""Does the same work on many items, begun in their order.

It yields each item with what ``work(held, item)`` returned, as they are done; an error that a job
raises is raised here.
"""


@contextmanager
def crew(held: object, workers: int) -> Iterator[Crew]:
    """Start workers for the block, which are stopped whatever they do when it is left.

    ``held`` is what every worker holds, sent once.
    """
    if workers < 1:
        raise InputError(f"workers is {workers}; expected 1 or more")
    others = set(multiprocessing.active_children())
    # Spawned, since an OpenGL context does not survive a fork.
    context = multiprocessing.get_context("spawn")
    with patch.dict(os.environ, dict.fromkeys(_ONE_THREAD, "1")):
        pool = ProcessPoolExecutor(workers, context, _start, (held,))

        def run(work: Callable[[Any, Any], Any], items: Sequence[Any]) -> Iterator[tuple[Any, Any]]:
            jobs = {pool.submit(_do, work, item): item for item in items}
            for job in as_completed(jobs):
                yield jobs[job], job.result()

        try:
            yield run
            pool.shutdown()
        except BrokenProcessPool as error:
            raise BuildError(
                "a worker process died: out of memory, or a fault of OpenGL; what was done is "
                "kept, run it again with fewer workers"
            ) from error
        finally:
            for process in set(multiprocessing.active_children()) - others:
                process.terminate()
            # The pool's own thread waits for them: two that wait for a process lose track of it.
            pool.shutdown(cancel_futures=True)


def _start(held: object) -> None:
    global _held  # noqa: PLW0603  (a process's own)
    # Ctrl-C goes to workers as well, which are stopped by the one process that answers it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _held = held


def _end_with_parent() -> None:
    """End this process when its parent is no more, however that ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _do(work: Callable[[Any, Any], Any], item: object) -> Any:
    return work(_held, item)

"""Independent jobs on a dask.distributed cluster (extra ``cluster``): processes or machines.

Jobs are few and long. The cluster runs each of them on any worker, tries it again if the worker
died or the job failed, and returns its result or its error.
"""

import logging
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from queue import SimpleQueue
from typing import Any, TypeVar
from uuid import uuid4

from skyline.errors import BuildError, InputError, SkylineError, library

T = TypeVar("T")
R = TypeVar("R")

RETRIES = 2
"""Further attempts at a job that raised an error. A job whose worker died is tried again on
another; after `distributed.scheduler.allowed-failures` deaths (3) it counts as their cause."""

_CONNECT_S = 10

# A terminal sends Ctrl-C to workers as well, but only the main process answers it and stops them.
_IGNORE_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
_LOG = "from skyline.errors import start_logging; start_logging()"

_log = logging.getLogger(__name__)

# One thread a process does all jobs: an OpenGL context belongs to the thread that made it, and
# dask may run tasks on several.
_job_thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="skyline-jobs")


@dataclass(frozen=True, slots=True)
class Runner:
    """Runs the same function on many items, on the workers of a dask client.

    Work and items must be picklable.
    """

    client: Any

    def __call__(
        self,
        work: Callable[..., R],
        items: Sequence[T],
        names: Sequence[str],
        listen: Callable[..., object] | None = None,
    ) -> Iterator[R | SkylineError]:
        """Run ``work`` on every item; ``names`` are distinct names of the items.

        Yields results in the items' order, each as soon as those before it are done. A job that
        failed at its last attempt yields its error, as a `BuildError` unless it is a
        `SkylineError`. With ``listen`` work is given a second argument, a function: what a job
        calls it with, numbers or texts, ``listen`` is called with here, in this thread.

        Raises `BuildError` if the scheduler is lost.
        """
        run, submit = uuid4().hex[:8], self.client.submit
        topic = f"skyline-{run}" if listen else None
        heard: SimpleQueue[Any] = SimpleQueue()
        if listen:
            self.client.subscribe_topic(topic, lambda event: heard.put(event[1]))
        with warnings.catch_warnings():
            # The viewpoints make the graph large, so it is sent once.
            warnings.filterwarnings("ignore", message="Sending large graph")
            futures = [
                submit(
                    _do_alone, work, item, topic, key=f"{name}-{run}", retries=RETRIES, pure=False
                )
                for name, item in zip(names, items, strict=True)
            ]
        # When the client leaves, the scheduler forgets the jobs that were not waited for.
        for future in futures:
            if listen:
                future.add_done_callback(lambda _: heard.put(None))
                while not future.done():
                    message = heard.get()
                    if message is not None:
                        listen(*message)
            yield _outcome(future)


@contextmanager
def runner_of(workers: str | None) -> Iterator[Runner | None]:
    """Yield a `Runner` on the given number of new processes, or on the cluster at an address.

    The runner is None if ``workers`` is None.

    What dask sends is pickled, both ways: connect only to a scheduler that you trust.

    Raises `InputError` for fewer than one worker, where nothing answers at the address, or where
    dask is not installed.
    """
    if workers is None:
        yield None
    elif workers.removeprefix("-").isdecimal():
        with local_cluster(int(workers)) as cluster, _distributed().Client(cluster) as client:
            yield Runner(client)
    else:
        try:
            client = _distributed().Client(workers, timeout=_CONNECT_S)
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise InputError(
                f"no dask scheduler answers at {workers!r} ({reason}); start one with `dask "
                "scheduler`, and give the address it prints, e.g. tcp://10.0.0.1:8786"
            ) from error
        with client:
            if not client.scheduler_info()["workers"]:
                _log.warning("the scheduler at %s has no workers yet; waiting for one", workers)
            yield Runner(client)


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    """Start worker processes for the block; yields dask's cluster; raises as `runner_of`."""
    if workers < 1:
        raise InputError(f"workers is {workers}; expected 1 or more")
    threads = max((os.cpu_count() or 1) // workers, 1)
    cluster = _distributed().LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        # Any free port of this machine alone: another cluster may have the usual one.
        dashboard_address="127.0.0.1:0",
        # A worker holds one DEM and one part, so no limit is needed.
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        preload=[_IGNORE_CTRL_C, _LOG],
        # Mesa's software rasterizer takes all cores unless a variable limits it.
        env={"LP_NUM_THREADS": os.environ.get("LP_NUM_THREADS", str(threads))},
    )
    try:
        yield cluster
    finally:
        # On a busy machine dask may give up waiting for workers to end; they end with this process.
        with suppress(TimeoutError):
            cluster.close()


def _distributed() -> Any:
    distributed = library("distributed", "a run on workers", "'dask[distributed]'")
    # Its log has every step; `_outcome` returns the errors that matter to a user.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    return distributed


def _do_alone(work: Callable[..., R], item: T, topic: str | None) -> R:
    """Do a job in the thread for jobs, with a function that tells the client if it listens."""
    if topic is None:
        return _job_thread.submit(work, item).result()
    worker = _distributed().get_worker()

    def tell(*message: float | str) -> None:
        worker.log_event(topic, message)

    return _job_thread.submit(work, item, tell).result()


def _outcome(future: Any) -> Any:
    """Wait for a job; return its result or its error. Raises `BuildError` without a scheduler."""
    try:
        error = future.exception()
        if error is None:
            return future.result()
    except (CancelledError, OSError) as lost:
        raise BuildError(
            "the scheduler has ended, or cannot be reached any more; start it, and give the same "
            "command again"
        ) from lost
    if isinstance(error, SkylineError):
        return error
    if type(error).__name__ == "KilledWorker":
        return BuildError("its worker died at every attempt: out of memory, or a fault of OpenGL")
    return BuildError(f"a worker failed: {type(error).__name__}: {' '.join(str(error).split())}")

"""Independent jobs on a dask.distributed cluster (extra ``cluster``): processes or machines.

Jobs are few and long. The cluster runs each job on any worker, runs it again if the worker dies or
the job fails, and returns its result or its error.
"""

import logging
import os
import warnings
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from queue import SimpleQueue
from typing import Any, Generic, Protocol, TypeVar
from uuid import uuid4

from skyline.errors import BuildError, InputError, SkylineError, library, one_line

# A terminal sends Ctrl-C to workers as well, but only the main process answers it and stops them.
_IGNORE_CTRL_C = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
_LOG = "from skyline.errors import start_logging; start_logging()"

_NO_TRIMMING = {"distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None}
"""Drops the setting by which Dask makes its workers return memory to the system at once. With it,
arrays are allocated anew each time, and screening and fits take 2.5 times the processor time."""

_log = logging.getLogger(__name__)


class Tool(Protocol):
    """The renderer or the matcher with which a run's jobs work."""

    def close(self) -> None:
        """Free its memory."""


K = TypeVar("K", bound=Tool)
T = TypeVar("T")
R = TypeVar("R")

Tell = Callable[..., object]
"""Called by a job with numbers or texts for the process that waits for the job."""


@dataclass(frozen=True, slots=True)
class Opening(Generic[K]):
    """Describes the tool of a run for workers; can be pickled."""

    key: Hashable
    """Equal for two openings of the same tool."""
    open: Callable[[], K]


class Bench:
    """A worker's thread for jobs, and the tool that they left open.

    One thread does all jobs: dask may run tasks in several threads, which would wait for one
    another.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="skyline-jobs")
        self._key: Hashable = None
        self._tool: Any = None

    def do(self, work: Callable[[K, T, Tell], R], opening: Opening[K], item: T, tell: Tell) -> R:
        """Return the result of ``work(tool, item, tell)``, in the thread for jobs.

        The tool stays open for the next job, and is closed before another one is opened: two
        elevation models never take memory at once.
        """
        return self._thread.submit(lambda: work(self._opened(opening), item, tell)).result()

    def _opened(self, opening: Opening[K]) -> K:
        if self._tool is None or self._key != opening.key:
            if self._tool is not None:
                self._tool.close()
            self._tool = None
            self._tool = opening.open()
            self._key = opening.key
        tool: K = self._tool
        return tool


@dataclass(frozen=True, slots=True)
class Runner:
    """Runs one function on many items, on a dask client's workers."""

    client: Any
    retries: int = 2
    """Further attempts at a job that raised an error. A job whose worker died is tried again on
    another; if more than `distributed.scheduler.allowed-failures` (3) die, dask blames the job."""

    def __call__(
        self,
        work: Callable[[K, T, Tell], R],
        opening: Opening[K],
        items: Sequence[T],
        names: Sequence[str],
        listen: Tell | None = None,
    ) -> Iterator[R | SkylineError]:
        """Call ``work`` with the opened tool and each item.

        The function, the opening and the items must be picklable, and the names distinct. Yields
        results in the items' order, each as soon as those before it are done. A job that failed at
        its last attempt yields its error, as a `BuildError` unless it is a `SkylineError`. What a
        job passes to its third argument is passed on to ``listen``, in this thread.

        Raises `BuildError` if the scheduler is lost.
        """
        run = uuid4().hex[:8]
        topic = f"skyline-{run}" if listen else None
        heard: SimpleQueue[Any] = SimpleQueue()
        if listen:
            self.client.subscribe_topic(topic, lambda event: heard.put(event[1]))
        futures = [
            self._submit(work, opening, item, topic, f"{name}-{run}")
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

    def ask(self, work: Callable[[K, T, Tell], R], opening: Opening[K], item: T, worker: int) -> R:
        """Return what a worker answers about one item; any thread may ask.

        The worker with the number ``worker`` modulo the number of workers is asked; if it dies, any
        other. Raises what the job raises, or `BuildError`; see `__call__`.
        """
        addresses = self._addresses()
        asked = addresses[worker % len(addresses)] if addresses else None
        submit = partial(self._submit, work, opening, item, None)
        future = submit(f"ask-{uuid4().hex}", workers=asked)
        while asked is not None and _is_pending(future):
            # If the only worker dies, dask does not give its job to a worker that joins later.
            if asked not in self._addresses():
                future.cancel()
                asked = None
                future = submit(f"ask-{uuid4().hex}")
        answer = _outcome(future)
        if isinstance(answer, SkylineError):
            raise answer
        found: R = answer
        return found

    @property
    def workers(self) -> int:
        """Number of workers now."""
        return len(self._addresses())

    def _addresses(self) -> list[str]:
        return sorted(self.client.nthreads())

    def _submit(
        self,
        work: Callable[[K, T, Tell], R],
        opening: Opening[K],
        item: T,
        topic: str | None,
        key: str,
        workers: str | None = None,
    ) -> Any:
        """Submit a job; return its future."""
        with warnings.catch_warnings():
            # Viewpoints, or a photo's waves, make the graph large; it is sent once.
            warnings.filterwarnings("ignore", message="Sending large graph")
            return self.client.submit(
                _do_on_bench,
                *(work, opening, item, topic),
                key=key,
                retries=self.retries,
                pure=False,
                workers=workers,
                allow_other_workers=workers is not None,
            )


@contextmanager
def runner_of(workers: str | None) -> Iterator[Runner | None]:
    """Yield a `Runner` on new processes or an existing cluster.

    The runner is None if ``workers`` is None. Dask pickles what it sends in both directions:
    connect only to a scheduler that you trust.

    Raises `InputError` for fewer than one worker, if nothing answers at the address, or if dask is
    not installed.
    """
    if workers is None:
        yield None
    elif workers.removeprefix("-").isdecimal():
        with local_cluster(int(workers)) as cluster, _distributed().Client(cluster) as client:
            yield Runner(client)
    else:
        try:
            client = _distributed().Client(workers, timeout=10)
        except (OSError, ValueError) as error:
            reason = one_line(error)
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
    distributed = _distributed()
    with import_module("dask.config").set(_NO_TRIMMING):
        cluster = distributed.LocalCluster(
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


def _do_on_bench(
    work: Callable[[K, T, Tell], R], opening: Opening[K], item: T, topic: str | None
) -> R:
    """Do a job in a dask worker; its messages become topic events."""
    worker = _distributed().get_worker()

    def tell(*message: float | str) -> None:
        if topic is not None:
            worker.log_event(topic, message)

    # The worker keeps its bench. Of tasks that begin together, the first sets it for all.
    bench: Bench = vars(worker).setdefault("skyline_bench", Bench())
    return bench.do(work, opening, item, tell)


def _is_pending(future: Any) -> bool:
    """Return whether a job is still pending after another second."""
    with suppress(TimeoutError):
        _distributed().wait(future, timeout=1)
    return not future.done()


def _outcome(future: Any) -> Any:
    """Wait for a job, and return its result or its error.

    Raises `BuildError` if the scheduler is lost.
    """
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
    return BuildError(f"a worker failed: {type(error).__name__}: {one_line(error)}")

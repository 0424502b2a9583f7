"""The number of threads of matrix products."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from threading import Lock

from threadpoolctl import ThreadpoolController

_blas = cache(ThreadpoolController)
"""The libraries' controls, which take milliseconds to find."""


class _BlasLimit:
    """The limit to one thread, as long as anyone holds it.

    BLAS has one limit for the whole process. Of two searches at a time, the one that ends first
    must not lift the other's.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._holders = 0
        self._limit = ExitStack()

    def hold(self) -> None:
        with self._lock:
            if not self._holders:
                self._limit.enter_context(_blas().limit(limits=1, user_api="blas"))
            self._holders += 1

    def release(self) -> None:
        with self._lock:
            self._holders -= 1
            if not self._holders:
                self._limit.close()


_BLAS_LIMIT = _BlasLimit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit matrix products to one thread each within the block.

    If a BLAS library splits small products among threads, each thread waits for the slowest a
    thousand times a second, and a busy machine becomes several times slower. Matching shares its
    work by blocks of places instead. One thread also gives the same bits in every process.
    """
    _BLAS_LIMIT.hold()
    try:
        yield
    finally:
        _BLAS_LIMIT.release()

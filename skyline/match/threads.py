"""Linear algebra on one thread: many small products wait for one another on several.

A library of linear algebra that shares a small product among threads makes each wait for the
slowest, a thousand times a second; on a busy machine that is several times slower. Work here is
shared by the blocks of places instead. One thread also gives the same result to the bit whatever
the process.
"""

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[Any]:
    """Return a context in which products of matrices take one thread each."""
    limited: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return limited


@cache
def _controller() -> ThreadpoolController:
    # Finding the libraries takes milliseconds.
    return ThreadpoolController()

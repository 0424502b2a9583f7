"""Work in as many processes as there are cores.

Each process has one thread, so that results do not depend on the number of cores.
"""

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ProcessPoolExecutor
from itertools import islice
from typing import TypeVar
from unittest.mock import patch

import cv2

from skyline_bench.measuring import core_count

T = TypeVar("T")
R = TypeVar("R")

_ONE_THREAD = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_AHEAD = 4
"""Items begun or waiting for each process."""


def over_processes(work: Callable[[T], R], items: Iterable[T]) -> Generator[R]:
    """Yield what work returns for each item, in order.

    Work, items and results must be picklable. The items may be endless: the processes stay a few
    items ahead, until the iterator is closed.
    """
    # Spawned, since an OpenGL context does not survive a fork.
    context = multiprocessing.get_context("spawn")
    cores, left = core_count(), iter(items)
    with (
        patch.dict(os.environ, dict.fromkeys(_ONE_THREAD, "1")),
        ProcessPoolExecutor(cores, context, cv2.setNumThreads, (1,)) as pool,
    ):
        ahead = deque(pool.submit(work, item) for item in islice(left, _AHEAD * cores))
        try:
            while ahead:
                yield ahead.popleft().result()
                ahead.extend(pool.submit(work, item) for item in islice(left, 1))
        finally:
            pool.shutdown(cancel_futures=True)

"""Work in as many processes as there are cores.

Each process has one thread, so that results do not depend on the number of cores.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import TypeVar
from unittest.mock import patch

from skyline_bench.measuring.timing import core_count

T = TypeVar("T")
R = TypeVar("R")

_ONE_THREAD = ("LP_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def over_processes(work: Callable[[T], R], items: Sequence[T]) -> Iterator[R]:
    """Yield what work returns for each item, in order; work, items and results are picklable."""
    # Spawned, since an OpenGL context does not survive a fork.
    context = multiprocessing.get_context("spawn")
    with (
        patch.dict(os.environ, dict.fromkeys(_ONE_THREAD, "1")),
        ProcessPoolExecutor(core_count(), context) as pool,
    ):
        yield from pool.map(work, items)

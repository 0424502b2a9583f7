"""The thread that renders for all others: results, errors, tasks within tasks."""

import pickle
import threading

import pytest

from skyline import InputError, RenderThread
from skyline.render.context import Closeable


def test_it_returns_and_raises_what_the_task_does_on_one_thread():
    with RenderThread() as thread:
        names = {thread.run(lambda: threading.current_thread().name) for _ in range(3)}
        assert names == {"rendering"}
        with pytest.raises(ZeroDivisionError):
            thread.run(lambda: 1 // 0)
        assert thread.run(lambda: thread.run(lambda: "within")) == "within"


def test_what_is_on_the_gpu_is_not_sent_to_another_process():
    class Held(Closeable):
        def close(self):
            pass

    with pytest.raises(InputError, match=r"a Held holds memory on the GPU.*; make one there"):
        pickle.dumps(Held())

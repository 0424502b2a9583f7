"""The thread that renders for all others: order, errors, the end."""

import threading

import pytest

from skyline import RenderThread


def test_urgent_tasks_go_before_waiting_ones():
    done, started, go_on = [], threading.Event(), threading.Event()

    def block():
        started.set()
        go_on.wait(10.0)

    with RenderThread() as thread:
        askers = [threading.Thread(target=thread.run, args=(block,))]
        askers[0].start()
        started.wait(10.0)
        for name, urgent in (("first", False), ("second", False), ("urgent", True)):
            waiting = thread._tasks.qsize()
            asker = threading.Thread(
                target=thread.run, args=(lambda name=name: done.append(name), urgent)
            )
            asker.start()
            askers.append(asker)
            while thread._tasks.qsize() == waiting:
                pass
        go_on.set()
        for asker in askers:
            asker.join()
    assert done == ["urgent", "first", "second"]


def test_it_returns_and_raises_what_the_task_does_on_one_thread():
    with RenderThread() as thread:
        names = {thread.run(lambda: threading.current_thread().name) for _ in range(3)}
        assert names == {"rendering"}
        with pytest.raises(ZeroDivisionError):
            thread.run(lambda: 1 // 0)
        assert thread.run(lambda: thread.run(lambda: "within")) == "within"

"""Worker processes: what they hold, what they do, and how they end."""

import multiprocessing
import os
import subprocess
import sys
import time

import pytest

from skyline.errors import BuildError, InputError
from skyline_training.workers import crew


def weigh(held, item):
    threads = os.environ["OMP_NUM_THREADS"], os.environ["LP_NUM_THREADS"]
    return held * item, os.getpid(), threads


def die(_, item):
    os._exit(item)


def sleep(_, item):
    time.sleep(item)


LEADER = """
import sys
sys.path[:0] = {path}
from test_crew import sleep
from skyline_training.workers import crew

if __name__ == "__main__":
    with crew(None, 1) as run:
        list(run(sleep, [0.0]))
        print("at work", flush=True)
        list(run(sleep, [600.0]))
"""


def test_workers_end_when_their_leader_is_killed(tmp_path):
    script = tmp_path / "leader.py"
    script.write_text(LEADER.format(path=[*sys.path]))
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as leader:
        assert leader.stdout is not None
        assert leader.stdout.readline() == "at work\n"
        leader.kill()
        # The worker holds the other end of the pipe: it is closed when the worker is gone.
        assert leader.stdout.read() == ""


def test_every_item_is_done_elsewhere_with_one_thread(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    with crew(10, 2) as run:
        done = dict(run(weigh, [1, 2, 3]))
        again = dict(run(weigh, [4]))
    assert {item: told[0] for item, told in (done | again).items()} == {1: 10, 2: 20, 3: 30, 4: 40}
    assert all(told[1] != os.getpid() for told in done.values())
    assert all(told[2] == ("1", "1") for told in done.values())
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "LP_NUM_THREADS" not in os.environ
    assert not multiprocessing.active_children()


def test_a_worker_that_dies_is_one_line():
    with pytest.raises(BuildError, match="worker process died"), crew(None, 1) as run:
        list(run(die, [3]))
    with pytest.raises(InputError, match="workers is 0"), crew(None, 0):
        pass

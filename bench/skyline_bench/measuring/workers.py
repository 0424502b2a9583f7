"""Work in forked processes, where a crash or a hang is a result."""

import os
import signal
from collections.abc import Callable
from functools import partial

Say = Callable[[bytes], object]
"""Sends bytes to the process that forked this one."""


def fork(work: Callable[[Say], object]) -> tuple[int, int]:
    """Do work in a new process, which exits with 0, or with 1 where it raises.

    Return its id, and the end of a pipe at which its bytes are read.
    """
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return pid, reading
    code = 1
    try:
        os.close(reading)
        work(partial(os.write, writing))
        code = 0
    finally:
        os._exit(code)


def ended(pid: int, reading: int) -> tuple[int, bytes]:
    """Wait for a process that was forked; return its exit code and its bytes."""
    with os.fdopen(reading, "rb") as pipe:
        said = pipe.read()
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), said


def outcome_of(work: Callable[[], str], patience_s: int = 60) -> str:
    """Return the text of work in a process of its own, or "raised", "hang" or "crash"."""

    def child(say: Say) -> None:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(patience_s)
        say(work().encode())

    code, said = ended(*fork(child))
    return {0: said.decode(), 1: "raised", -signal.SIGALRM: "hang"}.get(code, "crash")

"""Work in forked processes, so that a crash or a hang is a result and no more."""

import os
import signal
from collections.abc import Callable


def fork(work: Callable[[], None]) -> int:
    """Do work in a new process, which exits with 0, or with 1 where it raises; return its id."""
    pid = os.fork()
    if pid:
        return pid
    code = 1
    try:
        work()
        code = 0
    finally:
        os._exit(code)


def outcome_of(work: Callable[[], str], patience_s: int = 60) -> str:
    """Return what work in a process of its own says, or "raised", "hang" or "crash"."""
    reading, writing = os.pipe()

    def child() -> None:
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(patience_s)
        os.write(writing, work().encode())

    pid = fork(child)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        said = pipe.read().decode()
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    return {0: said, 1: "raised", -signal.SIGALRM: "hang"}.get(code, "crash")

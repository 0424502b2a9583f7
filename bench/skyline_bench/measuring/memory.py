"""How much memory a process takes."""

import re
from pathlib import Path

_RESET, _RESET_PEAK = Path("/proc/self/clear_refs"), "5"


def reset_peak() -> None:
    """Begin to look for the peak anew, where the system can; else it stays that of all."""
    try:
        _RESET.write_text(_RESET_PEAK)
    except OSError:
        return


def peak_bytes() -> int | None:
    """Return the greatest resident memory since the last `reset_peak`; None where unknown.

    Pages of mapped files count, which the system may drop when it needs them.
    """
    return _kilobytes("VmHWM")


def own_bytes(process: int | str = "self") -> int | None:
    """Return the resident memory of a process that lies in no file; None where unknown."""
    return _kilobytes("RssAnon", process)


def _kilobytes(name: str, process: int | str = "self") -> int | None:
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
        found = re.search(rf"^{name}:\s*(\d+) kB$", status, re.MULTILINE)
    except OSError:
        return None
    return 1024 * int(found[1]) if found else None

"""How much memory this process takes."""

import re
from pathlib import Path

_PROCESS = Path("/proc/self/status")
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


def own_bytes() -> int | None:
    """Return the resident memory that lies in no file; None where unknown."""
    return _kilobytes("RssAnon")


def _kilobytes(name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s*(\d+) kB$", _PROCESS.read_text(), re.MULTILINE)
    except OSError:
        return None
    return 1024 * int(found[1]) if found else None

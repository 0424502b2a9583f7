"""How much memory this process has taken, and how much more there is."""

import os
import re
from pathlib import Path

_PROCESS, _MACHINE = Path("/proc/self/status"), Path("/proc/meminfo")
_RESET, _RESET_PEAK = Path("/proc/self/clear_refs"), "5"


def reset_peak() -> None:
    """Begin to look for the peak anew, where the system can; else it stays that of all."""
    try:
        _RESET.write_text(_RESET_PEAK)
    except OSError:
        return


def peak_bytes() -> int | None:
    """Return the greatest resident memory since the last `reset_peak`; None where unknown."""
    return _kilobytes(_PROCESS, "VmHWM")


def available_bytes() -> int | None:
    """Return what can be taken without pushing anything out; None where unknown."""
    available = _kilobytes(_MACHINE, "MemAvailable")
    if available is None and "SC_AVPHYS_PAGES" in os.sysconf_names:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return available


def _kilobytes(path: Path, name: str) -> int | None:
    try:
        found = re.search(rf"^{name}:\s*(\d+) kB$", path.read_text(), re.MULTILINE)
    except OSError:
        return None
    return 1024 * int(found[1]) if found else None

"""The record of a benchmark: what was measured, and on which machine."""

import datetime
import json
import math
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skyline import __version__
from skyline.errors import ContextError
from skyline.files import write_whole
from skyline.render.context import acquire_context
from skyline_bench.measuring.timing import core_count

Row = Mapping[str, Any]
"""One line of a benchmark's table: plain values by name."""


def machine() -> dict[str, object]:
    """Describe this machine and the software that matters to a measurement on it."""
    try:
        context = acquire_context()
        renderer, driver = context.renderer, context.version
    except ContextError:
        renderer = driver = "none"
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "processor": _processor(),
        "cores": core_count(),
        "os": platform.platform(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "renderer": renderer,
        "driver": driver,
        "skyline": __version__,
    }


def write_record(
    path: Path | None,
    bench: str,
    rows: Sequence[Row],
    summary: Mapping[str, Sequence[Row]] | None = None,
) -> None:
    """Write rows and the machine they come from as JSON, whole or not at all, to a path if any.

    Numbers that are not finite, for which JSON has no word, are written as null. A summary, which
    follows from the rows, is tables by name.
    """
    if path is None:
        return
    record: dict[str, object] = {"bench": bench, "machine": machine(), "rows": _plain(rows)}
    if summary:
        record["summary"] = {name: _plain(table) for name, table in summary.items()}
    write_whole(path, json.dumps(record, indent=1, allow_nan=False) + "\n")


def shown(value: object) -> str:
    """Return a value as tables show it: three digits, or all before the point."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"
    return str(value)


def _plain(rows: Sequence[Row]) -> list[Row]:
    def plain(value: object) -> object:
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return [{key: plain(value) for key, value in row.items()} for row in rows]


def _processor() -> str:
    """Return the processor's model name where the system gives it, else its architecture."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(filter(None, [*names, platform.processor()]), platform.machine())

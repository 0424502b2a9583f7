"""Speed against error as a picture: one line a path, one marker a setting."""

from collections.abc import Sequence
from math import log
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes

from skyline_bench.figures.canvas import new_figure, save_figure

_STYLES = {
    "depth": ("depth path", "tab:gray", "s", 8),
    "horizon": ("horizon path", "crimson", "o", -8),
    "embree plain": ("Embree, plain bisection", "tab:blue", "^", 8),
    "embree neighbour": ("Embree, from the neighbouring columns", "tab:cyan", "v", -8),
}
"""By series: label, colour, marker, and how far aside of a marker its setting is written."""


def save_speed_error(
    rows: Sequence[dict[str, Any]], machine: dict[str, object], path: Path
) -> None:
    """Save milliseconds a viewpoint against rms and greatest error, both on log scales."""
    figure = new_figure(13, 6.2)
    panels = figure.subplots(1, 2)
    times_ms = [row["ms_per_viewpoint"] for row in rows]
    for axis, key, name in zip(
        panels, ("rms_px", "max_px"), ("rms error", "greatest error"), strict=True
    ):
        for series in _STYLES:
            _draw(axis, [row for row in rows if _series(row) == series], key, series)
        for row in rows:
            if row["path"] == "oracle":
                axis.axvline(
                    row["ms_per_viewpoint"], color="black", linestyle=":", label="oracle (error 0)"
                )
        axis.set(
            xscale="log",
            yscale="log",
            xlim=(min(times_ms) / 2.5, max(times_ms) * 4.0),
            xlabel="ms per viewpoint (four views), all cores",
            ylabel=f"{name} against the oracle (px of W = 640)",
        )
        axis.margins(y=0.1)
        axis.grid(which="major", alpha=0.35)
        axis.grid(which="minor", alpha=0.12)
    panels[0].legend(loc="best", fontsize=9)
    figure.suptitle(
        f"Skylines: speed against error. {machine['processor']}, {machine['cores']} cores; "
        f"{machine['renderer']}",
        fontsize=11,
    )
    save_figure(figure, path)


def _series(row: dict[str, Any]) -> str:
    return f"{row['path']} {row['start']}" if "start" in row else str(row["path"])


def _draw(axis: Axes, rows: Sequence[dict[str, Any]], key: str, series: str) -> None:
    rows = [row for row in rows if row[key]]
    label, colour, marker, aside = _STYLES[series]
    if not rows:
        return
    axis.plot(
        [row["ms_per_viewpoint"] for row in rows],
        [row[key] for row in rows],
        color=colour,
        marker=marker,
        label=label,
    )
    for place, settings in _labels(rows, key):
        axis.annotate(
            ", ".join(settings),
            place,
            xytext=(aside, 0),
            textcoords="offset points",
            horizontalalignment="left" if aside > 0 else "right",
            verticalalignment="center",
            fontsize=8,
            color=colour,
        )


def _labels(
    rows: Sequence[dict[str, Any]], key: str
) -> list[tuple[tuple[float, float], list[str]]]:
    """Return where to write what, points too close for labels of their own sharing one."""
    labels: list[tuple[tuple[float, float], list[str]]] = []
    for row in rows:
        ms, error_px = row["ms_per_viewpoint"], row[key]
        setting = row["setting"].removeprefix(f"{row.get('start')} ")
        for (other_ms, other_px), settings in labels:
            if abs(log(ms / other_ms)) < 0.3 and abs(log(error_px / other_px)) < 0.3:
                settings.append(setting)
                break
        else:
            labels.append(((ms, error_px), [setting]))
    return labels

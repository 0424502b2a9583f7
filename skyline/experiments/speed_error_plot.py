"""Speed against error as a picture: one line a path, one marker a setting."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

_STYLES = {
    "depth": ("depth path", "tab:gray", "s", (6, 4)),
    "horizon": ("horizon path", "crimson", "o", (7, -3)),
    "embree plain": ("Embree, plain bisection", "tab:blue", "^", (6, 4)),
    "embree neighbour": ("Embree, from the neighbouring columns", "tab:cyan", "v", (-8, -9)),
}
"""Label, colour, marker and where the setting is written, by series."""


def save_speed_error(
    rows: Sequence[dict[str, Any]], machine: dict[str, object], path: Path
) -> None:
    """Save milliseconds a viewpoint against rms and greatest error, both on log scales."""
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, 2, sharex=True)
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
            xlabel="ms per viewpoint (four views), all cores",
            ylabel=f"{name} against the oracle (px of W = 640)",
        )
        axis.grid(which="major", alpha=0.35)
        axis.grid(which="minor", alpha=0.12)
    panels[0].legend(loc="best", fontsize=9)
    figure.suptitle(
        f"Skylines: speed against error. {machine['processor']}, {machine['cores']} cores; "
        f"{machine['renderer']}",
        fontsize=11,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _series(row: dict[str, Any]) -> str:
    return f"{row['path']} {row['start']}" if "start" in row else str(row["path"])


def _draw(axis: Axes, rows: Sequence[dict[str, Any]], key: str, series: str) -> None:
    rows = [row for row in rows if row[key]]
    label, colour, marker, place = _STYLES[series]
    if not rows:
        return
    axis.plot(
        [row["ms_per_viewpoint"] for row in rows],
        [row[key] for row in rows],
        color=colour,
        marker=marker,
        label=label,
    )
    for row in rows:
        axis.annotate(
            row["setting"].removeprefix(f"{row.get('start')} "),
            (row["ms_per_viewpoint"], row[key]),
            xytext=place,
            textcoords="offset points",
            fontsize=8,
            color=colour,
        )

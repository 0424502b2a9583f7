"""Cost against size as a picture: seconds, bytes and query time over renderings or places."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skyline.experiments.scale import EXTRAPOLATED, MEASURED, PROBE

Row = Mapping[str, Any]

_PANELS = (
    ("renderings", "build_s", "build (s)"),
    ("renderings", "bytes", "store (bytes)"),
    ("places", "query_ms", "query (ms)"),
)
_MARKS = {MEASURED: "o", PROBE: "^", EXTRAPOLATED: "s"}
_COLOURS = ("tab:blue", "tab:orange", "tab:green", "tab:red")


def save_scale(rows: Sequence[Row], path: Path) -> None:
    """Save what `experiments.scale.measure` found, one line a number of shells."""
    shells = list(dict.fromkeys(row["shells"] for row in rows))
    figure = Figure(figsize=(14.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, (over, cost, name) in zip(figure.subplots(1, len(_PANELS)), _PANELS, strict=True):
        for index, count in enumerate(shells):
            _draw(
                axis,
                [row for row in rows if row["shells"] == count and row.get(cost) is not None],
                (over, cost),
                _COLOURS[index % len(_COLOURS)],
                f"{count} shells" if count else "skylines alone",
            )
        axis.set(xscale="log", yscale="log", xlabel=over, ylabel=name)
        axis.margins(0.15)
        axis.grid(alpha=0.3)
        if axis.lines:
            axis.legend(fontsize=8, loc="lower right")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def _draw(axis: Axes, rows: Sequence[Row], keys: tuple[str, str], colour: str, name: str) -> None:
    """Draw the measured points joined, the probe, and a dashed line to the extrapolated one."""
    over, cost = keys
    for kind, mark in _MARKS.items():
        shown = [row for row in rows if row["kind"] == kind]
        axis.plot(
            [row[over] for row in shown],
            [row[cost] for row in shown],
            color=colour,
            marker=mark,
            markerfacecolor="none" if kind == EXTRAPOLATED else colour,
            linestyle="solid" if kind == MEASURED else "none",
            label=f"{name}, {kind}" if shown else None,
        )
        if kind != PROBE:
            for row in shown:
                axis.annotate(
                    f"{row['area_km2']:g} km²",
                    (row[over], row[cost]),
                    xytext=(-6, 5),
                    textcoords="offset points",
                    horizontalalignment="right",
                    fontsize=7,
                    color=colour,
                )
    measured = [row for row in rows if row["kind"] == MEASURED]
    beyond = [row for row in rows if row["kind"] == EXTRAPOLATED]
    ends = [*measured[-1:], *beyond]
    axis.plot(
        [row[over] for row in ends],
        [row[cost] for row in ends],
        color=colour,
        linestyle="dashed",
        linewidth=0.8,
    )

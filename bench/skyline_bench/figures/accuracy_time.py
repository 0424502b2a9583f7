"""Accuracy against processor time, one line a depth of refinement."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline_bench.figures.canvas import new_figure, plain_ticks, save_figure
from skyline_bench.measuring.record import Row
from skyline_bench.runs.accuracy_time import DEPTHS, FITTED, SHORTLISTS, UNREFINED


def save_accuracy_time(rows: Sequence[Row], path: Path) -> None:
    """Save error against time, one line a depth of refinement."""
    figure = new_figure(10.0, 4.4)
    error, within = figure.subplots(1, 2)
    _draw(error, rows, "median_m", "median error (m)")
    _draw(within, rows, "within_200m", f"share within {RIGHT_WITHIN_M:.0f} m")
    error.legend(fontsize=8, title="refinement")
    figure.suptitle(
        f"retrieval fits {', '.join(map(str, FITTED))} places; the best "
        f"{', '.join(map(str, SHORTLISTS))} are refined",
        fontsize=10,
    )
    save_figure(figure, path)


def _draw(axis: Axes, rows: Sequence[Row], key: str, label: str) -> None:
    for name in (UNREFINED, *DEPTHS):
        line = [row for row in rows if row["refinement"] == name]
        shown = [[float(str(row[of])) for row in line] for of in ("cpu_ms", key)]
        axis.plot(*shown, "o-", label=name)
    axis.set(xscale="log", xlabel="processor time a query (ms)", ylabel=label)
    plain_ticks(axis.xaxis)
    axis.grid(alpha=0.3)

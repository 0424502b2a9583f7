"""Accuracy against area as a picture: what is found, what it takes, and where it is lost."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from skyline_bench.figures.canvas import new_figure, plain_ticks, save_figure
from skyline_bench.measuring.record import Row
from skyline_bench.runs.scale import GROUPS
from skyline_bench.trials.traced import STAGES


def save_scale(rows: Sequence[Row], path: Path) -> None:
    """Save the rows of `skyline_bench.runs.scale.measure`."""
    figure = new_figure(14.0, 4.6)
    accuracy, lost, seconds = figure.subplots(1, 3)
    everything = [row for row in rows if row["group"] == "all"]
    for group in GROUPS:
        mine = [row for row in rows if row["group"] == group]
        if mine:
            label = f"skyline {group}" if group != "all" else "all, within 200 m"
            _draw(accuracy, mine, "within_200m", f"{label}, {mine[-1]['n']} queries")
    _draw(accuracy, everything, "within_1km", "all, within 1 km", "dashed")
    for stage in STAGES:
        _draw(lost, everything, stage, stage)
    _draw(lost, everything, "within_200m", "answer within 200 m", "dashed")
    _draw(seconds, everything, "query_s", "by the clock")
    _draw(seconds, everything, "query_cpu_s", "processor time")
    for axis, label in (
        (accuracy, "share within 200 m"),
        (lost, "share of queries whose place is there"),
        (seconds, "a query (s)"),
    ):
        axis.set(xscale="log", xlabel="area searched (km2)", ylabel=label)
        plain_ticks(axis.xaxis)
        axis.set_ylim(0.0, None if axis is seconds else 1.02)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    save_figure(figure, path)


def _draw(axis: Axes, rows: Sequence[Row], key: str, label: str, dashes: str = "solid") -> None:
    points = sorted((float(str(row["km2"])), float(str(row[key]))) for row in rows)
    axis.plot(
        [km2 for km2, _ in points],
        [value for _, value in points],
        marker=".",
        linestyle=dashes,
        label=label,
    )

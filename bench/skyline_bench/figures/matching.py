"""Accuracy of matchers against what their stores cost, as a picture."""

from collections.abc import Sequence
from pathlib import Path

from skyline_bench.figures.canvas import new_figure, plain_ticks, save_figure
from skyline_bench.measuring.record import Row
from skyline_bench.runs.cost_summary import UNIFORM

_COSTS = (
    ("places", 1.0, "places (or four renderings each)"),
    ("build_cpu_s", 1.0, "processor time to build (s)"),
    ("bytes", 1e-6, "store (MB)"),
)
_FIGURES = (
    ("within_200m", "share within 200 m"),
    ("median_m", "median error (m)"),
    ("mean_m", "mean error (m)"),
)
_DASHES = ("solid", "dashed", "dotted", "dashdot")


def save_accuracy(rows: Sequence[Row], path: Path) -> None:
    """Save accuracy against cost: a colour a matcher, a kind of dashes a kind of queries.

    Lines join uniform grids; stores that something else chose are crosses.
    """
    keys = "matcher", "queries", "planner"
    lines = list(dict.fromkeys(tuple(str(row[key]) for key in keys) for row in rows))
    matchers, kinds, _ = (list(dict.fromkeys(names)) for names in zip(*lines, strict=True))
    figure = new_figure(13.0, 10.0)
    grid = figure.subplots(len(_FIGURES), len(_COSTS), sharex="col", sharey="row")
    for line, (key, label) in zip(grid, _FIGURES, strict=True):
        line[0].set_ylabel(label)
        for axis, (cost, scale, _) in zip(line, _COSTS, strict=True):
            axis.set_xscale("log")
            plain_ticks(axis.xaxis)
            if key == "within_200m":
                axis.set_ylim(0.0, 1.02)
            else:
                axis.set_yscale("log")
                plain_ticks(axis.yaxis)
            axis.grid(alpha=0.3)
            for matcher, kind, planner in lines:
                joined = planner == UNIFORM
                shown = sorted(
                    (scale * float(str(row[cost])), float(str(row[key])))
                    for row in rows
                    if tuple(row[name] for name in keys) == (matcher, kind, planner)
                    and row[cost] is not None
                )
                axis.plot(
                    *([point[i] for point in shown] for i in range(2)),
                    marker="." if joined else "x",
                    color=f"C{matchers.index(matcher)}",
                    linestyle=_DASHES[kinds.index(kind) % len(_DASHES)] if joined else "none",
                    label=f"{matcher}, {kind}, {planner}",
                )
    for axis, (_, _, label) in zip(grid[-1], _COSTS, strict=True):
        axis.set_xlabel(label)
    grid[0, 0].legend(fontsize=7)
    save_figure(figure, path)

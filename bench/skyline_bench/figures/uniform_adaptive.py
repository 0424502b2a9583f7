"""Error against what stores cost, uniform and adaptive, one column a matcher (paper Figure 7)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from skyline_bench.figures.canvas import new_figure, plain_ticks, save_figure
from skyline_bench.measuring.record import Row
from skyline_bench.runs.cost_summary import UNIFORM
from skyline_bench.trials.distance_groups import ALL
from skyline_bench.trials.matchers import PAPER, WHAT

_STYLES = {
    UNIFORM: ("#000000", "o"),
    "lpov": ("#0072B2", "s"),
    "rov": ("#009E73", "D"),
    "arov": ("#CC79A7", "v"),
    "hov": ("#E69F00", "P"),
    "sov": ("#56B4E9", "X"),
}
"""Colours of Okabe and Ito, told apart by every eye, and marks, by planner."""
_OTHERWISE = ("#777777", "*")
_PAPERS_UNIFORM = ((182, 1587.0), (665, 702.0), (2662, 411.0), (10648, 123.0))
_PAPERS_ADAPTIVE = (2800, 117.0)
"""Renderings and mean error over the groups, metres: Table 2 of the paper."""
_GREY = "#777777"
_COSTS = (("renderings", 1.0), ("bytes", 1e-6))
"""What the rows of panels show, and what one unit of it is drawn as."""


def draw_costs(rows: Sequence[Row]) -> Figure:
    """Draw the mean error over all queries against renderings, and against bytes.

    Bars are 95 % intervals. The figures of the paper's own Table 2, six photos of other terrain,
    stand in grey beside its matcher.
    """
    shown = [row for row in rows if row["group"] == ALL]
    matchers = [name for name in WHAT if any(row["matcher"] == name for row in shown)]
    planners = list(dict.fromkeys(str(row["planner"]) for row in shown))
    figure = new_figure(2.75 * len(matchers) + 0.9, 6.4)
    grid = figure.subplots(2, len(matchers), sharey=True, sharex="row", squeeze=False)
    for column, matcher in enumerate(matchers):
        mine = [row for row in shown if row["matcher"] == matcher]
        for axis, (key, scale) in zip(grid[:, column], _COSTS, strict=True):
            if matcher == PAPER and key == "renderings":
                _draw_papers(axis)
            for planner in planners:
                stores = [row for row in mine if row["planner"] == planner]
                _draw_line(axis, planner, stores, key, scale)
            _finish(axis)
        grid[0, column].set_title(f"{matcher}\n{WHAT[matcher]}", fontsize=8.5)
    for axis in grid[0]:
        axis.set_xlabel("renderings, or four a place", fontsize=9)
    for axis in grid[1]:
        axis.set_xlabel("store (MB the matcher reads)", fontsize=9)
    for axis in grid[:, 0]:
        axis.set_ylabel("mean position error (m)", fontsize=9)
    handles: dict[str, Artist] = {}
    for axis in grid[0]:
        handles |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(
        list(handles.values()), list(handles), loc="outside upper center",
        ncols=len(handles), fontsize=9, frameon=False,
    )  # fmt: skip
    return figure


def save_costs(rows: Sequence[Row], path: Path) -> None:
    """Save `draw_costs` as PNG, PDF or SVG, by the path's ending."""
    save_figure(draw_costs(rows), path)


def _draw_line(axis: Axes, planner: str, rows: Sequence[Row], key: str, scale: float) -> None:
    """Draw one planner's stores."""
    names = (key, "mean_m", "mean_m_low", "mean_m_high")
    values = np.array([[float(str(row[name])) for name in names] for row in rows])
    colour, mark = _STYLES.get(planner, _OTHERWISE)
    cost, mean, low, high = values[np.argsort(values[:, 0])].T
    axis.errorbar(
        cost * scale,
        mean,
        yerr=np.abs([mean - low, high - mean]),
        color=colour,
        marker=mark,
        linestyle="--" if planner == UNIFORM else "-",
        linewidth=1.5,
        elinewidth=0.8,
        markersize=5,
        capsize=2,
        label=planner,
    )


def _draw_papers(axis: Axes) -> None:
    cost, mean = zip(*_PAPERS_UNIFORM, strict=True)
    axis.plot(
        cost, mean, "o--", color=_GREY, markerfacecolor="none", linewidth=1.0, markersize=5,
        label="uniform in the paper",
    )  # fmt: skip
    axis.plot(*_PAPERS_ADAPTIVE, "*", color=_GREY, markersize=10, label="adaptive in the paper")


def _finish(axis: Axes) -> None:
    axis.set(xscale="log", yscale="log")
    for side in (axis.xaxis, axis.yaxis):
        plain_ticks(side)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)

"""The figure of a comparison: accuracy against cost."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from skyline_bench.measuring.record import Row
from skyline_bench.search.specs import GIVEN, PLANNED, UNIFORM
from skyline_bench.search.summary import ALL
from skyline_bench.search.trials import PAPER

_COSTS = {
    "renderings": (1.0, "renderings, or four a place"),
    "bytes": (1e-6, "store (MB)"),
    "build_cpu_s": (1.0, "processor time to build (s)"),
    "km2": (1.0, "area searched (km2)"),
}
"""Keys of what is on the horizontal axis: what one unit is drawn as, and its label."""
_FOUND = {
    "within_200m": "share within 200 m",
    "within_1km": "share within 1 km",
    "mean_m": "mean error (m)",
    "screened": "share screened",
    "retrieved": "share retrieved",
    "query_s": "a query (s)",
}
_COLOURS = {
    UNIFORM: "#000000",
    PLANNED: "#D55E00",
    GIVEN: "#777777",
    "lpov": "#0072B2",
    "rov": "#009E73",
    "arov": "#CC79A7",
    "hov": "#E69F00",
    "sov": "#56B4E9",
}
"""By planner: colours of Okabe and Ito, which every eye can tell apart."""
_MARKS = "osDvPX^"
_PAPERS_UNIFORM = ((182, 665, 2662, 10648), (1587.0, 702.0, 411.0, 123.0))
_PAPERS_ADAPTIVE = (2800, 117.0)
"""Renderings and mean error over the groups, metres: Table 2 of the paper."""

AGAINST_COST = tuple((x, y) for y in ("mean_m", "within_200m") for x in ("renderings", "bytes"))
AGAINST_AREA = tuple(
    ("km2", y) for y in ("within_200m", "within_1km", "screened", "retrieved", "query_s")
)


def save_found(rows: Sequence[Row], panels: Sequence[tuple[str, str]], path: Path) -> None:
    """Save a panel for each pair of a cost and what is found; bars are intervals of 95 %.

    A colour is a planner, a mark a matcher and a kind of queries. The figures of the paper's own
    Table 2, six photos of other terrain, stand in grey beside its matcher.
    """
    shown = [row for row in rows if row["group"] == ALL]
    lines = list(dict.fromkeys(_line(row) for row in shown))
    marks = list(dict.fromkeys(line[:2] for line in lines))
    columns = min(len(panels), 3 if len(panels) > 4 else 2)
    figure = Figure(figsize=(5.5 * columns, 4.2 * -(-len(panels) // columns)), layout="constrained")
    axes = figure.subplots(-(-len(panels) // columns), columns, squeeze=False).ravel()
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    for axis, (cost, found) in zip(axes, panels, strict=False):
        scale, label = _COSTS[cost]
        for line in lines:
            some = [row for row in shown if _line(row) == line and row.get(found) is not None]
            some.sort(key=lambda row: float(row[cost]))
            matcher, kind, planner = line
            style = {
                "color": _COLOURS.get(planner, "#777777"),
                "marker": _MARKS[marks.index((matcher, kind)) % len(_MARKS)],
                "linestyle": "--" if planner == UNIFORM else "-",
                "label": f"{matcher}, {kind}, {planner}",
            }
            x = [scale * row[cost] for row in some]
            y = np.array([row[found] for row in some])
            bars = None
            if some and f"{found}_low" in some[0]:
                ends = [[row[f"{found}_low"], row[f"{found}_high"]] for row in some]
                bars = np.abs(np.array(ends).T - y)
            axis.errorbar(x, y, bars, capsize=2, **style)
        if (cost, found) == ("renderings", "mean_m") and any(line[0] == PAPER for line in lines):
            axis.plot(*_PAPERS_UNIFORM, "o--", color="#777777", label="uniform in the paper")
            axis.plot(*_PAPERS_ADAPTIVE, "*", color="#777777", label="adaptive in the paper")
        axis.set(xscale="log", xlabel=label, ylabel=_FOUND[found])
        plain_ticks(axis.xaxis)
        _scale_up(axis, found)
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=7)
    figure.savefig(path, dpi=110)


def plain_ticks(side: Axis) -> None:
    """Write the ticks of a logarithmic axis, after all is drawn, as plain numbers."""
    low, high = side.get_view_interval()
    # An axis that spans more has ticks at powers of ten alone.
    subs = (1.0, 2.0, 5.0) if high < 500.0 * low else (1.0,)
    side.set_major_locator(LogLocator(subs=subs))
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    side.set_minor_formatter(NullFormatter())


def _scale_up(axis: Axes, found: str) -> None:
    if found.endswith("_m"):
        axis.set_yscale("log")
        plain_ticks(axis.yaxis)
    else:
        axis.set_ylim(0.0, None if found == "query_s" else 1.02)


def _line(row: Row) -> tuple[str, str, str]:
    return row["matcher"], row["queries"], row["planner"]

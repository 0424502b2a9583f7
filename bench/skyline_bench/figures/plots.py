"""The figures of records, drawn without a window."""

from collections.abc import Iterable, Sequence
from math import isfinite, log
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from skyline.paper.planning.strategies import STRATEGIES
from skyline_bench.measuring.record import Row
from skyline_bench.runs.calibration import Reliability, calibration_error, reliability
from skyline_bench.runs.cost_summary import UNIFORM
from skyline_bench.runs.scale import GROUPS
from skyline_bench.trials.traced import STAGES
from skyline_bench.trials.trials import ALL, PAPER, WHAT
from skyline_bench.truth.simulation import TABLE_1, Simulation, simulate

_FEW_DECADES = 500.0
"""An axis that spans more has ticks at powers of ten alone."""


def save_figure(figure: Figure, path: Path) -> None:
    """Save a figure as PNG, PDF or SVG, by the path's ending."""
    figure.savefig(path, dpi=110)


def plain_ticks(side: Axis) -> None:
    """Write the ticks of a logarithmic axis, after all is drawn, as plain numbers."""
    low, high = side.get_view_interval()
    subs = (1.0, 2.0, 5.0) if high < _FEW_DECADES * low else (1.0,)
    side.set_major_locator(LogLocator(subs=subs))
    side.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    side.set_minor_formatter(NullFormatter())


def draw_line(
    axis: Axes, rows: Iterable[Row], cost: str, key: str, label: str, style: str = ".-"
) -> None:
    """Draw a figure of rows against a cost of theirs, from the least cost on."""
    scale, _ = _COSTS.get(cost, (1.0, ""))
    points = sorted((scale * row[cost], row[key]) for row in rows if isfinite(row[cost]))
    if points:
        axis.plot(*zip(*points, strict=True), style, label=label)


# --- matchers on stores ---------------------------------------------------------------------

_COSTS = {
    "places": (1.0, "places (or four renderings each)"),
    "renderings": (1.0, "renderings, or four a place"),
    "build_cpu_s": (1.0, "processor time to build (s)"),
    "bytes": (1e-6, "store (MB the matcher reads)"),
}
"""What stores cost: what one unit of it is drawn as, and its label."""
_ERRORS = {
    "within_200m": "share within 200 m",
    "median_m": "median error (m)",
    "mean_m": "mean error (m)",
}
_DASHES = ("-", "--", ":", "-.")


def save_accuracy(rows: Sequence[Row], path: Path) -> None:
    """Save accuracy against cost: a colour a matcher, a kind of dashes a kind of queries.

    Lines join uniform grids; stores that something else chose are crosses.
    """
    keys = "matcher", "queries", "planner"
    lines = list(dict.fromkeys(tuple(row[key] for key in keys) for row in rows))
    matchers, kinds, _ = (list(dict.fromkeys(names)) for names in zip(*lines, strict=True))
    costs = "places", "build_cpu_s", "bytes"
    figure = Figure(figsize=(13.0, 10.0), layout="constrained")
    grid = figure.subplots(len(_ERRORS), len(costs), sharex="col", sharey="row")
    for line, key in zip(grid, _ERRORS, strict=True):
        for axis, cost in zip(line, costs, strict=True):
            for matcher, kind, planner in lines:
                asked = [matcher, kind, planner]
                mine = [row for row in rows if [row[name] for name in keys] == asked]
                dashes = "." + _DASHES[kinds.index(kind) % len(_DASHES)]
                style = f"C{matchers.index(matcher)}" + (dashes if planner == UNIFORM else "x")
                draw_line(axis, mine, cost, key, f"{matcher}, {kind}, {planner}", style)
            axis.set(xscale="log", xlabel=_COSTS[cost][1])
            plain_ticks(axis.xaxis)
            if key == "within_200m":
                axis.set_ylim(0.0, 1.02)
            else:
                axis.set_yscale("log")
                plain_ticks(axis.yaxis)
            axis.grid(alpha=0.3)
            axis.label_outer()
        line[0].set_ylabel(_ERRORS[key])
    grid[0, 0].legend(fontsize=7)
    save_figure(figure, path)


_STYLES = {
    UNIFORM: ("#000000", "o--"),
    "lpov": ("#0072B2", "s-"),
    "rov": ("#009E73", "D-"),
    "arov": ("#CC79A7", "v-"),
    "hov": ("#E69F00", "P-"),
    "sov": ("#56B4E9", "X-"),
}
"""Colours of Okabe and Ito, told apart by every eye, and marks, by planner."""
_GREY = "#777777"
_PAPERS_UNIFORM = ((182, 665, 2662, 10648), (1587.0, 702.0, 411.0, 123.0))
_PAPERS_ADAPTIVE = (2800, 117.0)
"""Renderings and mean error over the groups, metres: Table 2 of the paper."""


def draw_costs(rows: Sequence[Row]) -> Figure:
    """Draw the mean error over all queries against renderings, and against bytes (Figure 7).

    A column a matcher; bars are 95 % intervals. The figures of the paper's own Table 2, six photos
    of other terrain, stand in grey beside its matcher.
    """
    shown = [row for row in rows if row["group"] == ALL]
    matchers = [name for name in WHAT if any(row["matcher"] == name for row in shown)]
    figure = Figure(figsize=(2.75 * len(matchers) + 0.9, 6.4), layout="constrained")
    grid = figure.subplots(2, len(matchers), sharey=True, sharex="row", squeeze=False)
    handles: dict[str, Artist] = {}
    for line, key in zip(grid, ("renderings", "bytes"), strict=True):
        scale, label = _COSTS[key]
        for axis, matcher in zip(line, matchers, strict=True):
            if matcher == PAPER and key == "renderings":
                grey = {"color": _GREY, "markerfacecolor": "none"}
                axis.plot(*_PAPERS_UNIFORM, "o--", label="uniform in the paper", **grey)
                axis.plot(*_PAPERS_ADAPTIVE, "*", color=_GREY, label="adaptive in the paper")
            for planner in dict.fromkeys(row["planner"] for row in shown):
                names = (key, "mean_m", "mean_m_low", "mean_m_high")
                asked = matcher, planner
                cost, mean, low, high = np.array(
                    sorted(
                        [row[name] for name in names]
                        for row in shown
                        if (row["matcher"], row["planner"]) == asked
                    ),
                    dtype=np.float64,
                ).T
                colour, style = _STYLES.get(planner, (_GREY, "*-"))
                bars = np.abs([mean - low, high - mean])
                axis.errorbar(
                    cost * scale, mean, bars, fmt=style, color=colour, capsize=2, label=planner
                )
            axis.set(xscale="log", yscale="log", xlabel=label)
            axis.tick_params(labelsize=8)
            plain_ticks(axis.xaxis)
            plain_ticks(axis.yaxis)
            axis.grid(alpha=0.3)
            handles |= dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
        line[0].set_ylabel("mean position error (m)")
    for axis, matcher in zip(grid[0], matchers, strict=True):
        axis.set_title(f"{matcher}\n{WHAT[matcher]}", fontsize=8.5)
    figure.legend(
        list(handles.values()), list(handles), loc="outside upper center", ncols=len(handles)
    )
    return figure


# --- our search -----------------------------------------------------------------------------


def save_scale(rows: Sequence[Row], path: Path) -> None:
    """Save accuracy against area: what is found, where it is lost, and what it takes."""
    figure = Figure(figsize=(14.0, 4.6), layout="constrained")
    accuracy, lost, seconds = figure.subplots(1, 3)
    everything = [row for row in rows if row["group"] == "all"]
    for group in GROUPS:
        mine = [row for row in rows if row["group"] == group]
        if mine:
            label = f"skyline {group}" if group != "all" else "all, within 200 m"
            draw_line(accuracy, mine, "km2", "within_200m", f"{label}, {mine[-1]['n']} queries")
    draw_line(accuracy, everything, "km2", "within_1km", "all, within 1 km", ".--")
    for stage in STAGES:
        draw_line(lost, everything, "km2", stage, stage)
    draw_line(lost, everything, "km2", "within_200m", "answer within 200 m", ".--")
    draw_line(seconds, everything, "km2", "query_s", "by the clock")
    draw_line(seconds, everything, "km2", "query_cpu_s", "processor time")
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


def save_reliability(path: Path, told: Iterable[Reliability], title: str) -> None:
    """Save the reliability diagram: how often answers are right against how sure they were."""
    figure = Figure(figsize=(6.4, 6.6), layout="constrained")
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], ":", color="black", linewidth=0.8)
    for name, sure, right in told:
        said, hit, share, spread = np.array(reliability(sure, right)).T
        error = calibration_error(sure, right)
        label = f"{name}: {len(sure)} queries, calibration error {error:.3f}"
        bars = axis.errorbar(said, hit, spread, marker="o", capsize=2, label=label)
        colour = bars.lines[0].get_color()
        for x, y, part in zip(said, hit, share, strict=True):
            count = f"{part * len(sure):.0f}"
            axis.annotate(
                count, (x, y), (4, -10), textcoords="offset points", fontsize=8, color=colour
            )
    axis.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="confidence", ylabel="share right", title=title)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.1))
    save_figure(figure, path)


# --- skylines and planners ------------------------------------------------------------------

_SERIES = {
    "depth": ("depth path", "tab:gray", "s", 8),
    "horizon": ("horizon path", "crimson", "o", -8),
    "embree plain": ("Embree, plain bisection", "tab:blue", "^", 8),
    "embree neighbour": ("Embree, from the neighbouring columns", "tab:cyan", "v", -8),
}
"""By path and start: label, colour, marker, and how far aside of it its setting is written."""


def save_speed_error(rows: Sequence[Row], machine: Row, path: Path) -> None:
    """Save milliseconds a viewpoint against rms and greatest error, both on log scales."""
    figure = Figure(figsize=(13, 6.2), layout="constrained")
    panels = figure.subplots(1, 2)
    times_ms = [row["ms_per_viewpoint"] for row in rows]
    for axis, key, name in zip(
        panels, ("rms_px", "max_px"), ("rms error", "greatest error"), strict=True
    ):
        for series in _SERIES:
            _draw_series(axis, rows, key, series)
        for row in rows:
            if row["path"] == "oracle":
                label = "oracle (error 0)"
                axis.axvline(row["ms_per_viewpoint"], color="black", linestyle=":", label=label)
        axis.set(xscale="log", yscale="log", xlim=(min(times_ms) / 4.0, max(times_ms) * 4.0))
        axis.set_xlabel("ms per viewpoint (four views), all cores")
        axis.set_ylabel(f"{name} against the oracle (px of W = 640)")
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


def _draw_series(axis: Axes, rows: Sequence[Row], key: str, series: str) -> None:
    path, _, start = series.partition(" ")
    asked = path, start or None
    mine = [row for row in rows if row[key] and (row["path"], row.get("start")) == asked]
    label, colour, marker, aside = _SERIES[series]
    points = [(row["ms_per_viewpoint"], row[key]) for row in mine]
    if not points:
        return
    axis.plot(*zip(*points, strict=True), color=colour, marker=marker, label=label)
    # Points too close for labels of their own share one.
    labels: list[tuple[tuple[float, float], list[str]]] = []
    for row, point in zip(mine, points, strict=True):
        setting = row["setting"].removeprefix(f"{row.get('start')} ")
        for other, settings in labels:
            if max(abs(log(a / b)) for a, b in zip(point, other, strict=True)) < 0.3:
                settings.append(setting)
                break
        else:
            labels.append((point, [setting]))
    side: dict[str, Any] = {"ha": "left" if aside > 0 else "right", "va": "center"}
    for place, settings in labels:
        text = ", ".join(settings)
        axis.annotate(
            text, place, (aside, 0), textcoords="offset points", fontsize=8, color=colour, **side
        )


_SMALLEST_PX, _LARGEST_PX = 1e-8, 1e3
"""Errors of 0 and of columns without a value are drawn at these."""


def save_stability(rows: Sequence[Row], path: Path) -> None:
    """Save every hard case's greatest error beside its bound, on a log scale, a panel a path."""
    paths = list(dict.fromkeys(row["path"] for row in rows))
    cases = list(dict.fromkeys(row["case"] for row in rows))
    figure = Figure(figsize=(6.5 + 3.5 * len(paths), 1.5 + 0.19 * len(cases)), layout="constrained")
    panels = figure.subplots(1, len(paths), sharey=True, squeeze=False)[0]
    for axis, name in zip(panels, paths, strict=True):
        mine = [row for row in rows if row["path"] == name]
        place = [cases.index(row["case"]) for row in mine]
        error, bound = np.clip(
            [[row[key] for row in mine] for key in ("error_px", "bound_px")],
            _SMALLEST_PX, _LARGEST_PX,
        )  # fmt: skip
        colours = ["tab:green" if row["ok"] else "crimson" for row in mine]
        axis.scatter(bound, place, marker="|", color="black", label="bound")
        axis.scatter(error, place, marker="o", s=14, c=colours, label="greatest error")
        axis.set(xscale="log", xlabel="px (0 at 1e-8)", title=f"{name} path")
        axis.grid(alpha=0.25)
    panels[0].set_yticks(range(len(cases)), cases, fontsize=7)
    panels[0].set_ylim(len(cases) - 0.5, -0.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    save_figure(figure, path)


def save_table1(path: Path) -> None:
    """Save coverage against renderings in the paper's simulation, all strategies, a panel a row."""
    figure = Figure(figsize=(15, 4.6), layout="constrained")
    for axis, row in zip(figure.subplots(1, len(TABLE_1)), TABLE_1, strict=True):
        simulation = Simulation(row)
        for name, strategy in STRATEGIES.items():
            progress = simulate(simulation, strategy, seed=0).progress
            rendered = np.arange(len(progress)) + len(simulation.corners())
            axis.plot(rendered, 100.0 * progress, linewidth=1.2, label=name)
        axis.axhline(100.0 * row.coverage, color="black", linewidth=0.8, linestyle=":")
        axis.set_title(
            f"{'affine' if row.affine else 'non-affine'}, p = {row.peaks}, "
            f"t = {row.threshold_px:g} px, c = {row.coverage:.0%}, r = {row.rotation_deg:g}°"
        )
        axis.set(xlabel="renderings", ylabel="coverage (%)", ylim=(0, 101))
        axis.grid(alpha=0.3)
    axis.legend(loc="lower right")
    save_figure(figure, path)


def save_placing(rows: Sequence[Row], path: Path) -> None:
    """Save the rows of `skyline_bench.runs.placing.measure`."""
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    everything = [row for row in rows if row["group"] == "all"]
    for axis, key, label in zip(
        figure.subplots(1, 2),
        ("within_200m", "within_1km"),
        ("share within 200 m", "share within 1 km"),
        strict=True,
    ):
        for kind, begins in (("uniform", "places"), ("planned", "planned")):
            mine = [row for row in everything if row["layout"].startswith(begins)]
            draw_line(axis, mine, "places", key, kind, "o-")
        axis.set(xscale="log", xlabel="places", ylabel=label)
        plain_ticks(axis.xaxis)
        axis.grid(alpha=0.3)
        axis.legend()
    save_figure(figure, path)

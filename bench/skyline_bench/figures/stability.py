"""The hard cases as a picture: what each path's error is and what it may be."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from skyline_bench.cases.stability import Row
from skyline_bench.figures.canvas import new_figure, save_figure

_SMALLEST_PX, _LARGEST_PX = 1e-8, 1e3
"""Errors of 0 and of columns without a value are drawn at these."""


def save_stability(rows: Sequence[Row], path: Path) -> None:
    """Save every case's greatest error beside its bound, on a log scale, a panel a path."""
    paths = list(dict.fromkeys(row["path"] for row in rows))
    cases = list(dict.fromkeys(row["case"] for row in rows))
    figure = new_figure(6.5 + 3.5 * len(paths), 1.5 + 0.19 * len(cases))
    panels = figure.subplots(1, len(paths), sharey=True, squeeze=False)[0]
    for axis, name in zip(panels, paths, strict=True):
        mine = [row for row in rows if row["path"] == name]
        place = [cases.index(row["case"]) for row in mine]
        error = np.clip([row["error_px"] for row in mine], _SMALLEST_PX, _LARGEST_PX)
        bound = np.clip([row["bound_px"] for row in mine], _SMALLEST_PX, _LARGEST_PX)
        colours = ["tab:green" if row["ok"] else "crimson" for row in mine]
        axis.scatter(bound, place, marker="|", color="black", label="bound")
        axis.scatter(error, place, marker="o", s=14, c=colours, label="greatest error")
        axis.set(xscale="log", xlabel="px (0 at 1e-8)", title=f"{name} path")
        axis.grid(alpha=0.25)
    panels[0].set_yticks(range(len(cases)), cases, fontsize=7)
    panels[0].set_ylim(len(cases) - 0.5, -0.5)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    save_figure(figure, path)

"""Position errors of matchers as a picture: their distribution, one line a store and matcher."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from skyline.experiments.matching import KINDS, Comparison
from skyline.matching.confidence import RIGHT_WITHIN_M

_DASHES = ("solid", "dashed", "dotted", "dashdot")
_LEAST_M = 1.0


def save_errors(compared: Sequence[Comparison], path: Path) -> None:
    """Save the share of queries whose error is at most so many metres; one panel a kind."""
    kinds = list(dict.fromkeys(comparison.kind for comparison in compared))
    stores = list(dict.fromkeys(comparison.store.name for comparison in compared))
    matchers = list(dict.fromkeys(comparison.matcher for comparison in compared))
    figure = Figure(figsize=(5.4 * len(kinds) + 0.6, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, len(kinds), squeeze=False)[0]
    colours = colormaps["viridis"](np.linspace(0.0, 0.9, len(stores)))
    for axis, kind in zip(panels, kinds, strict=True):
        shown = [comparison for comparison in compared if comparison.kind == kind]
        for comparison in shown:
            error_m = np.sort([trial.error_m for trial in comparison.trials])
            axis.step(
                np.maximum(error_m, _LEAST_M),
                100.0 * np.arange(1, len(error_m) + 1) / len(error_m),
                where="post",
                color=colours[stores.index(comparison.store.name)],
                linestyle=_DASHES[matchers.index(comparison.matcher) % len(_DASHES)],
                label=f"{comparison.store.name}, {comparison.matcher}",
            )
        axis.axvline(RIGHT_WITHIN_M, color="black", linewidth=0.8, linestyle=":")
        axis.set(
            xscale="log",
            xlim=(_LEAST_M, None),
            ylim=(0, 100),
            xlabel="position error (m)",
        )
        axis.set_title(f"{kind}, {len(shown[0].trials)} queries\n{KINDS[kind]}", fontsize=10)
        axis.grid(alpha=0.3)
    panels[0].set_ylabel("queries (%)")
    panels[0].legend(fontsize=8, loc="upper left")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)

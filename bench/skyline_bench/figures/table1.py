"""Coverage against renderings in the paper's simulation."""

from pathlib import Path

import numpy as np

from skyline.paper.planning.strategies import STRATEGIES
from skyline_bench.figures.canvas import new_figure, save_figure
from skyline_bench.truth.simulation import TABLE_1, Simulation, simulate


def save_table1(path: Path) -> None:
    """Save coverage against renderings, all strategies, one panel a row."""
    figure = new_figure(15, 4.6)
    for axis, row in zip(figure.subplots(1, len(TABLE_1)), TABLE_1, strict=True):
        simulation = Simulation(row)
        for name, strategy in STRATEGIES.items():
            run = simulate(simulation, strategy, seed=0)
            rendered = np.arange(len(run.progress)) + len(simulation.corners())
            axis.plot(rendered, 100.0 * run.progress, linewidth=1.2, label=name)
        axis.axhline(100.0 * row.coverage, color="black", linewidth=0.8, linestyle=":")
        model = "affine" if row.affine else "non-affine"
        axis.set(
            title=f"{model}, p = {row.peaks}, t = {row.threshold_px:g} px, "
            f"c = {row.coverage:.0%}, r = {row.rotation_deg:g}°",
            xlabel="renderings",
            ylabel="coverage (%)",
            ylim=(0, 101),
        )
        axis.grid(alpha=0.3)
    axis.legend(loc="lower right")
    save_figure(figure, path)

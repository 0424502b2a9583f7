"""How often answers are right, against how sure they were."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from skyline.matching.confidence import RIGHT_WITHIN_M
from skyline_bench.figures.canvas import new_figure, save_figure
from skyline_bench.runs.calibration import Reliability, calibration_error, reliability


def save_reliability(path: Path, told: Iterable[Reliability], title: str) -> None:
    """Save the reliability diagram: how often answers are right against how sure they were."""
    figure = new_figure(5.6, 5.2)
    axis = figure.subplots()
    axis.plot([0, 1], [0, 1], color="black", linewidth=0.8, linestyle=":")
    for label, sure, right in told:
        rows = reliability(sure, right)
        said, hit, share, spread = np.array(rows).T
        error = calibration_error(sure, right)
        axis.errorbar(
            said,
            hit,
            yerr=spread,
            marker="o",
            capsize=2,
            label=f"{label}: {len(sure)} queries, calibration error {error:.3f}",
        )
        for x, y, part in zip(said, hit, share, strict=True):
            axis.annotate(f"{part * len(sure):.0f}", (x, y), (4, -10), textcoords="offset points")
    axis.set(
        xlim=(0, 1),
        ylim=(0, 1.02),
        xlabel="confidence",
        ylabel=f"right (within {RIGHT_WITHIN_M:.0f} m)",
        title=title,
    )
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="upper left")
    save_figure(figure, path)

"""Accuracy against places as a picture: uniform grids and planned places."""

from collections.abc import Sequence
from pathlib import Path

from skyline_bench.figures.plots import draw_line, new_figure, plain_ticks, save_figure
from skyline_bench.measuring.record import Row


def save_placing(rows: Sequence[Row], path: Path) -> None:
    """Save the rows of `skyline_bench.runs.placing.measure`."""
    figure = new_figure(11.0, 4.6)
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

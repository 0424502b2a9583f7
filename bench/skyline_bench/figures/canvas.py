"""Figures without a window: how every one of them is begun and saved."""

from pathlib import Path

from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

_FEW_DECADES = 500.0
"""An axis that spans more has ticks at powers of ten alone."""


def new_figure(width_in: float, height_in: float) -> Figure:
    """Return an empty figure of a size in inches."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


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

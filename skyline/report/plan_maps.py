"""Maps of the paper's plans: viewpoints and tolerance areas over the shaded terrain."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS
from skyline.report.pictures import HEADING_NAMES, save_figure
from skyline.report.relief import Area, draw_bearings, draw_relief

if TYPE_CHECKING:
    from skyline.paper.coverage import Coverage
    from skyline.paper.plan import Plan

_WIDTH_IN = 9.0
_INK_SHARE = 0.35
"""Share of the picture that all points together cover."""
_PANEL_SQUARE_IN = 14.0
_OPACITY = 0.55


def save_coverage_map(plan: "Plan", path: Path) -> None:
    """Save a picture (PNG) with a map for each heading: viewpoints and their tolerance areas.

    After the paper's Figure 6. A location has the colour of the largest tolerance area that holds
    it; the terrain is bare where none does.

    Raises `InputError` where the file cannot be written.
    """
    candidates = plan.candidates
    columns_m, rows_m = candidates.easting_m, candidates.northing_m
    # Each candidate stands in the middle of its cell; one row or column has the others' spacing.
    known_m = [abs(float(axis[1] - axis[0])) for axis in (columns_m, rows_m) if len(axis) > 1]
    east_m, north_m = known_m[0], known_m[-1]
    area = Area(
        float(columns_m[0]) - east_m / 2.0,
        float(rows_m[-1]) - north_m / 2.0,
        float(columns_m[-1]) + east_m / 2.0,
        float(rows_m[0]) + north_m / 2.0,
    )
    shape = area.height_m / area.width_m
    width = np.sqrt(_PANEL_SQUARE_IN / shape)
    figure = Figure(
        figsize=(len(HEADINGS) * width + 1.2, width * shape + 0.7), layout="constrained"
    )
    axes = figure.subplots(1, len(HEADINGS), sharey=True)
    cell_km2 = east_m * north_m / 1e6
    norm = LogNorm(cell_km2, cell_km2 * candidates.window**2)
    for heading, axis in zip(HEADINGS, axes, strict=True):
        coverage = plan.coverages[heading]
        draw_relief(axis, plan.field, area)
        axis.imshow(
            _largest(coverage) * cell_km2,
            norm=norm,
            cmap="plasma",
            alpha=_OPACITY,
            extent=(area.west_m, area.east_m, area.south_m, area.north_m),
            interpolation="nearest",
        )
        row, col = candidates.row_col(coverage.viewpoints)
        axis.plot(
            columns_m[col],
            rows_m[row],
            ".",
            color="black",
            markeredgecolor="white",
            markeredgewidth=0.3,
            markersize=4.0,
        )
        draw_bearings(axis, plan.field.frame, area)
        axis.set_title(
            f"heading {heading}, {HEADING_NAMES[heading]}\n{len(coverage.viewpoints)} renderings "
            f"cover {coverage.fraction():.1%}",
            fontsize=9,
        )
    bar = figure.colorbar(ScalarMappable(norm, "plasma"), ax=axes, shrink=0.8, pad=0.01)
    bar.set_label("largest tolerance area that holds a location (km²)")
    save_figure(figure, path)


def _largest(coverage: "Coverage") -> Float64Array:
    """Return the size of the largest area that holds each candidate (rows, cols), NaN for none."""
    grid = coverage.candidates
    sizes = np.count_nonzero(coverage.areas, axis=(1, 2))
    largest = np.zeros(np.pad(grid.valid, grid.reach).shape)
    for row, col, area, size in zip(
        *grid.row_col(coverage.viewpoints), coverage.areas, sizes, strict=True
    ):
        place = largest[row : row + grid.window, col : col + grid.window]
        np.maximum(place, area * float(size), out=place)
    inner = largest[grid.reach : -grid.reach, grid.reach : -grid.reach]
    return np.where(inner > 0.0, inner, np.nan)

"""A map of a plan: viewpoints and what their tolerance areas cover (after the paper's Figure 6)."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.paper.planning.candidates import CandidateMap
from skyline.paper.planning.coverage import Coverage
from skyline.paper.planning.plan import Plan
from skyline.report.pictures import HEADING_NAMES, save_figure
from skyline.report.relief import Area, draw_bearings, draw_relief

_PANEL_SQUARE_IN = 14.0

_OPACITY = 0.55


def save_coverage_map(plan: Plan, path: Path) -> None:
    """Save a map (PNG) for each heading: the terrain shaded, viewpoints, and their tolerance areas.

    A location has the colour of the largest tolerance area that holds it; the terrain is bare
    where none does.

    Raises `InputError` where the file cannot be written.
    """
    candidates = plan.candidates
    area = _area(candidates)
    shape = area.height_m / area.width_m
    width = np.sqrt(_PANEL_SQUARE_IN / shape)
    figure = Figure(
        figsize=(len(HEADINGS) * width + 1.2, width * shape + 0.7), layout="constrained"
    )
    axes = figure.subplots(1, len(HEADINGS), sharey=True)
    cell_east_m, cell_north_m = _cell_m(candidates)
    cell_km2 = cell_east_m * cell_north_m / 1e6
    norm = LogNorm(cell_km2, cell_km2 * candidates.grid.window**2)
    for heading, axis in zip(HEADINGS, axes, strict=True):
        coverage = plan.coverages[heading]
        draw_relief(axis, candidates.field, area)
        axis.imshow(
            _largest(coverage) * cell_km2,
            norm=norm,
            cmap="plasma",
            alpha=_OPACITY,
            extent=(area.west_m, area.east_m, area.south_m, area.north_m),
            interpolation="nearest",
        )
        _draw_viewpoints(axis, candidates, coverage)
        draw_bearings(axis, candidates.field.frame, area)
        axis.set_title(
            f"heading {heading}, {HEADING_NAMES[heading]}\n{len(coverage.viewpoints)} renderings "
            f"cover {coverage.fraction():.1%}",
            fontsize=9,
        )
    bar = figure.colorbar(ScalarMappable(norm, "plasma"), ax=axes, shrink=0.8, pad=0.01)
    bar.set_label("largest tolerance area that holds a location (km²)")
    save_figure(figure, path)


def _cell_m(candidates: CandidateMap) -> tuple[float, float]:
    """Return the candidates' spacing east and north; of a single row or column, the other's."""
    steps = [np.diff(axis[:2]) for axis in (candidates.easting_m, candidates.northing_m)]
    known = next(float(abs(step[0])) for step in steps if step.size)
    east, north = (float(abs(step[0])) if step.size else known for step in steps)
    return east, north


def _area(candidates: CandidateMap) -> Area:
    """Return the candidates' area; each stands in the middle of its cell."""
    east, north = (step / 2.0 for step in _cell_m(candidates))
    return Area(
        float(candidates.easting_m[0]) - east,
        float(candidates.northing_m[-1]) - north,
        float(candidates.easting_m[-1]) + east,
        float(candidates.northing_m[0]) + north,
    )


def _largest(coverage: Coverage) -> NDArray[np.float64]:
    """Return the size of the largest area that holds each candidate (rows, cols), NaN for none."""
    grid = coverage.grid
    sizes = np.count_nonzero(coverage.areas, axis=(1, 2))
    largest = np.zeros(np.pad(grid.valid, grid.reach).shape)
    for row, col, area, size in zip(
        *grid.row_col(coverage.viewpoints), coverage.areas, sizes, strict=True
    ):
        place = largest[row : row + grid.window, col : col + grid.window]
        np.maximum(place, area * float(size), out=place)
    inner = largest[grid.reach : -grid.reach, grid.reach : -grid.reach]
    return np.where(inner > 0.0, inner, np.nan)


def _draw_viewpoints(axis: Axes, candidates: CandidateMap, coverage: Coverage) -> None:
    row, col = candidates.grid.row_col(coverage.viewpoints)
    axis.plot(
        candidates.easting_m[col],
        candidates.northing_m[row],
        ".",
        color="black",
        markeredgecolor="white",
        markeredgewidth=0.3,
        markersize=4.0,
    )

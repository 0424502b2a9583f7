"""Pictures of the paper's plans and renderings: coverage maps and depth images."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from skyline.arrays import Float32Array, Float64Array
from skyline.errors import InputError
from skyline.files.disk import write_whole
from skyline.files.folders import check_folder
from skyline.paper.plan import CoveragePlan
from skyline.paper.planners import Coverage
from skyline.progress import Progress
from skyline.render.depth import DepthRenderer
from skyline.render.horizon import RenderConfig
from skyline.report.figure_files import encode_figure, is_figure
from skyline.report.maps import draw_bearings, draw_relief
from skyline.skylines import HEADINGS, Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_HEADING_NAMES = ("grid north", "grid east", "grid south", "grid west")
_DPI = 110.0
"""Dots per inch of both kinds of pictures."""


def save_depth_pictures(
    terrain: HeightField,
    viewpoints: Viewpoints,
    folder: Path,
    config: RenderConfig,
    labels: Sequence[str] = (),
    progress: Progress | None = None,
) -> None:
    """Save depth images (TIFF) and a picture of each viewpoint.

    Depths are float32 metres, inf for sky. The files are ``NNNN_heading_H.tif`` and ``NNNN.png``,
    numbered in the viewpoints' order; after the number comes the viewpoint's label, if it has one.
    ``progress`` is called after each viewpoint. Raises as `check_depth_folder`.
    """
    check_depth_folder(folder, len(viewpoints), labels)
    folder.mkdir(parents=True, exist_ok=True)
    with DepthRenderer(terrain, config.width, config.curvature) as renderer:
        for index in range(len(viewpoints)):
            images = renderer.depth_images(viewpoints, index)
            views = renderer.render(viewpoints[index : index + 1])
            stem = _stem(index, labels)
            # The picture first: its mark says whose the others are, should this be stopped.
            write_whole(folder / f"{stem}.png", encode_figure(_depth_figure(images, views)))
            for heading in HEADINGS:
                picture = cv2.imencode(".tif", images[heading])[1].tobytes()
                write_whole(folder / f"{stem}_heading_{heading}.tif", picture)
            if progress is not None:
                progress(index + 1, len(viewpoints))


def check_depth_folder(folder: Path, count: int, labels: Sequence[str] = ()) -> None:
    """Check that depth images would replace only earlier depth images.

    Raises `InputError` as `check_folder`, and for a file that would be replaced.
    """
    check_folder(folder)
    for stem in (_stem(index, labels) for index in range(count if folder.exists() else 0)):
        picture, *images = (
            folder / f"{stem}{end}"
            for end in (".png", *(f"_heading_{heading}.tif" for heading in HEADINGS))
        )
        there = next((path for path in (picture, *images) if path.exists()), None)
        if there is not None and not is_figure(picture):
            raise InputError(
                f"{there} would be replaced, and {picture} is not marked as Skyline's; name "
                "another folder"
            )


def _stem(index: int, labels: Sequence[str]) -> str:
    """Return the beginning of the names of a viewpoint's files."""
    label = re.sub(r"[^\w.-]+", "-", labels[index]) if labels else ""
    return f"{index:04d}{label and '_'}{label}"


def _depth_figure(images: Float32Array, views: Views) -> Figure:
    """Draw depth images (4, W, W) side by side, with their skylines."""
    size = images.shape[-1]
    finite = images[np.isfinite(images)]
    norm = LogNorm(*(np.percentile(finite, [1, 99]) if finite.size else (1.0, 10.0)))
    figure = Figure((16, 4.6), _DPI, layout="constrained")
    axes = figure.subplots(1, len(HEADINGS))
    for heading, axis in enumerate(axes):
        depth = np.where(np.isfinite(images[heading]), images[heading], np.nan)
        shown = axis.imshow(depth, cmap="viridis_r", norm=norm, interpolation="nearest")
        axis.set_facecolor("#dfe9f5")
        rows = (1.0 - views.v[heading]) * size / 2.0 - 0.5
        axis.plot(np.arange(size), rows, color="crimson", linewidth=1.0)
        axis.set(xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), xticks=[], yticks=[])
        axis.set_title(f"heading {heading}: {_HEADING_NAMES[heading]}")
    bar = figure.colorbar(shown, ax=axes, shrink=0.9, pad=0.01, format="{x:g} m")
    bar.set_label("forward depth")
    return figure


def save_coverage_map(plan: CoveragePlan, path: Path) -> None:
    """Save maps of the viewpoints and the area that they cover.

    There is one map for each heading, all in one PNG, which resembles Figure 6 of the paper. A
    location has the colour of the largest tolerance area that holds it; terrain in no tolerance
    area stays uncoloured.

    Raises `InputError` where the file cannot be written.
    """
    sites = plan.sites
    columns_m = sites.easting_m
    rows_m = sites.northing_m
    # Each site is in the middle of its cell.
    corners = columns_m[0], rows_m[-1], columns_m[-1], rows_m[0]
    area = Bbox.from_extents(*corners).padded(plan.config.site_spacing_m / 2.0)
    shape = area.height / area.width
    width = np.sqrt(14.0 / shape)  # Each map has 14 square inches.
    size_in = len(HEADINGS) * width + 1.2, width * shape + 0.7
    figure = Figure(size_in, _DPI, layout="constrained")
    axes = figure.subplots(1, len(HEADINGS), sharey=True)
    cell_km2 = (plan.config.site_spacing_m / 1000.0) ** 2
    norm = LogNorm(cell_km2, cell_km2 * sites.window**2)
    for heading, axis in zip(HEADINGS, axes, strict=True):
        coverage = plan.coverages[heading]
        draw_relief(axis, plan.field, area)
        axis.imshow(
            _largest(coverage) * cell_km2,
            norm=norm,
            cmap="plasma",
            alpha=0.55,
            extent=(area.x0, area.x1, area.y0, area.y1),
            interpolation="nearest",
        )
        row, col = sites.row_col(coverage.viewpoints)
        edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 0.3}
        axis.plot(columns_m[col], rows_m[row], ".k", markersize=4.0, **edge)
        draw_bearings(axis, plan.field.frame, area)
        axis.set_title(
            f"heading {heading}, {_HEADING_NAMES[heading]}\n{len(coverage.viewpoints)} renderings "
            f"cover {coverage.fraction():.1%}",
            fontsize=9,
        )
    bar = figure.colorbar(ScalarMappable(norm, "plasma"), ax=axes, shrink=0.8, pad=0.01)
    bar.set_label("largest tolerance area that holds a location (km²)")
    write_whole(path, encode_figure(figure))


def _largest(coverage: Coverage) -> Float64Array:
    """Return the size of the largest area that holds each site.

    Sizes are (rows, cols), in sites; NaN where no area holds the site.
    """
    grid = coverage.sites
    sizes = np.count_nonzero(coverage.areas, axis=(1, 2))
    largest = np.zeros(np.pad(grid.valid, grid.reach).shape)
    for row, col, area, size in zip(
        *grid.row_col(coverage.viewpoints), coverage.areas, sizes, strict=True
    ):
        around = largest[row : row + grid.window, col : col + grid.window]
        np.maximum(around, area * float(size), out=around)
    inner = largest[grid.reach : -grid.reach, grid.reach : -grid.reach]
    return np.where(inner > 0.0, inner, np.nan)

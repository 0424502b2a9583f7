"""Pictures: depth images with their skyline, panoramas, and maps of what was found where."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LightSource
from matplotlib.figure import Figure
from numpy.typing import NDArray

from skyline.camera import HEADINGS
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

_HEADING_NAMES = ("north", "east", "south", "west")
_LARGEST_MAP_SAMPLES = 1200


@dataclass(frozen=True, slots=True)
class Found:
    """A query on a map: where it was taken, where it was put (grid coordinates and azimuths)."""

    name: str
    true_m: tuple[float, float] | None
    found_m: tuple[float, float] | None
    true_heading_deg: float | None = None
    found_heading_deg: float | None = None


def save_depth_images(images: NDArray[np.float32], views: Views, path: Path) -> None:
    """Save the four depth images of one viewpoint side by side, their skylines drawn.

    Parameters
    ----------
    images : (4, W, W) float32, metres, top row first, inf = sky
    views : Views
        The four views of that viewpoint, in order of heading.
    path : Path
        A PNG.
    """
    size = images.shape[-1]
    finite = images[np.isfinite(images)]
    low, high = np.log10(np.percentile(finite, [1, 99])) if finite.size else (0.0, 1.0)
    figure = Figure(figsize=(16, 4.6), layout="constrained")
    axes = figure.subplots(1, len(HEADINGS))
    for heading, axis in enumerate(axes):
        depth = np.where(np.isfinite(images[heading]), images[heading], np.nan)
        shown = axis.imshow(
            np.log10(depth), cmap="viridis_r", vmin=low, vmax=high, interpolation="nearest"
        )
        axis.set_facecolor("#dfe9f5")
        rows = (1.0 - views.elevation_tan[heading]) * size / 2.0 - 0.5
        axis.plot(np.arange(size), rows, color="crimson", linewidth=1.0)
        axis.set(xlim=(-0.5, size - 0.5), ylim=(size - 0.5, -0.5), xticks=[], yticks=[])
        axis.set_title(f"heading {heading}: {_HEADING_NAMES[heading]}")
    bar = figure.colorbar(shown, ax=axes, shrink=0.9, pad=0.01)
    ticks = np.array([10, 30, 100, 300, 1e3, 3e3, 1e4, 3e4, 1e5])
    ticks = ticks[(np.log10(ticks) >= low) & (np.log10(ticks) <= high)]
    bar.set_ticks(np.log10(ticks), labels=[f"{tick:g} m" for tick in ticks])
    bar.set_label("forward depth")
    _save(figure, path)


def save_panorama(views: Views, convergence_deg: float, path: Path) -> None:
    """Save the skyline of one viewpoint all the way round, from true north, coloured by depth."""
    azimuth = (views.azimuth_deg() + convergence_deg) % 360.0
    order = np.argsort(azimuth, axis=None)
    azimuth, elevation = azimuth.ravel()[order], views.elevation_deg().ravel()[order]
    depth_km = views.depth_m.ravel()[order] / 1000.0
    figure = Figure(figsize=(14, 3.6), layout="constrained")
    axis = figure.subplots()
    floor = np.nanmin(elevation) - 1.0 if np.isfinite(elevation).any() else -1.0
    axis.fill_between(azimuth, floor, elevation, color="#c9c3b8", linewidth=0)
    dots = axis.scatter(azimuth, elevation, c=depth_km, s=3, cmap="viridis_r")
    axis.set(
        xlim=(0, 360),
        xticks=np.arange(0, 361, 45),
        xlabel="azimuth from true north (degrees)",
        ylabel="elevation (degrees)",
    )
    axis.set_ylim(bottom=floor)
    axis.grid(alpha=0.3)
    figure.colorbar(dots, ax=axis, label="forward depth (km)", pad=0.01)
    _save(figure, path)


def save_map(
    field: HeightField, viewpoints: Viewpoints | None, found: Sequence[Found], path: Path
) -> None:
    """Save the terrain shaded from above, with viewpoints and true and found positions."""
    figure = Figure(figsize=(9, 9), layout="constrained")
    axis = figure.subplots()
    _draw_terrain(axis, field)
    if viewpoints is not None and len(viewpoints):
        axis.plot(
            viewpoints.easting_m / 1000.0,
            viewpoints.northing_m / 1000.0,
            ".",
            color="black",
            markersize=2,
            label=f"{len(viewpoints)} viewpoints",
        )
        _look_at(axis, field, viewpoints)
    for index, query in enumerate(found):
        _draw_found(axis, query, first=index == 0)
    axis.set(xlabel="easting (km)", ylabel="northing (km)", aspect="equal")
    if axis.get_legend_handles_labels()[0]:
        axis.legend(loc="upper right", framealpha=0.9)
    _save(figure, path)


def _draw_terrain(axis: Axes, field: HeightField) -> None:
    step = max(1, int(np.ceil(max(field.rows, field.cols) / _LARGEST_MAP_SAMPLES)))
    heights = field.heights_m[::step, ::step].astype(np.float64)
    low, _ = field.height_range_m
    shade = LightSource(azdeg=315, altdeg=45).hillshade(
        np.nan_to_num(heights, nan=low),
        dx=field.spacing_east_m * step,
        dy=field.spacing_north_m * step,
    )
    west, south, east, north = (side / 1000.0 for side in field.bounds_m)
    extent = (west, east, south, north)
    axis.imshow(np.where(np.isnan(heights), np.nan, shade), cmap="gray", extent=extent)
    axis.imshow(heights, cmap="terrain", extent=extent, alpha=0.35)


def _look_at(axis: Axes, field: HeightField, viewpoints: Viewpoints) -> None:
    """Show the viewpoints and a third of their extent around them, as far as there is terrain."""
    west, south, east, north = field.bounds_m
    easting, northing = viewpoints.easting_m, viewpoints.northing_m
    margin = max(1000.0, np.ptp(easting) / 3.0, np.ptp(northing) / 3.0)
    axis.set_xlim(
        max(west, easting.min() - margin) / 1000.0, min(east, easting.max() + margin) / 1000.0
    )
    axis.set_ylim(
        max(south, northing.min() - margin) / 1000.0, min(north, northing.max() + margin) / 1000.0
    )


def _draw_found(axis: Axes, query: Found, first: bool) -> None:
    places = (
        (query.true_m, query.true_heading_deg, "o", "tab:blue", "true position"),
        (query.found_m, query.found_heading_deg, "X", "crimson", "found position"),
    )
    arrow_km = 0.06 * float(np.ptp(axis.get_xlim()))
    if query.true_m and query.found_m:
        pair = np.array([query.true_m, query.found_m]) / 1000.0
        axis.plot(pair[:, 0], pair[:, 1], "-", color="crimson", linewidth=1.0)
    for place, heading_deg, marker, colour, label in places:
        if place is None:
            continue
        easting, northing = place[0] / 1000.0, place[1] / 1000.0
        axis.plot(
            easting,
            northing,
            marker,
            color=colour,
            markeredgecolor="white",
            markersize=9,
            label=label if first else None,
        )
        if heading_deg is not None:
            turn = np.radians(heading_deg)
            axis.annotate(
                "",
                xytext=(easting, northing),
                xy=(easting + arrow_km * np.sin(turn), northing + arrow_km * np.cos(turn)),
                arrowprops={"arrowstyle": "->", "color": colour},
            )
    anchor = query.true_m or query.found_m
    if anchor is not None:
        axis.annotate(
            query.name,
            (anchor[0] / 1000.0, anchor[1] / 1000.0),
            xytext=(6, 6),
            textcoords="offset points",
            fontsize=8,
            bbox={"boxstyle": "round,pad=0.15", "fc": "white", "alpha": 0.7, "lw": 0},
        )


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)

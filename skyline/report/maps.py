"""Maps over shaded relief: the candidates of a match, degrees, and true north."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnchoredText
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar
from scipy.spatial import cKDTree

from skyline.angles import wrapped_deg
from skyline.arrays import Float64Array
from skyline.geodesy.bounds import degrees_in_words
from skyline.geodesy.map_frame import Frame
from skyline.pose.outlines import Ellipse, view_wedge_m
from skyline.pose.pose import Pose
from skyline.report.labels import Label, UnnamedPeaks, labels_of
from skyline.report.relief import relief, tint_range_m
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.view.sightings import Sighting

_LEAST_SIDE_M = 2000.0
"""Least side of a candidate's map; the map of all candidates is at least twice as wide."""
_WIDTH_IN = 5.8
"""Width of a map."""


def overview_area(places: Sequence[Pose | Viewpoints], terrain: HeightField | None) -> Bbox:
    """Return the area around places that the terrain covers."""
    easting_m = np.hstack([place.easting_m for place in places])
    northing_m = np.hstack([place.northing_m for place in places])
    return _area_around(easting_m, northing_m, 2.0 * _LEAST_SIDE_M, terrain)


def detail_area(candidate: Pose, terrain: HeightField | None) -> Bbox:
    """Return the area within a kilometre of a candidate.

    It is larger if the candidate's ellipse is.
    """
    ellipse = Ellipse.of(candidate)
    side_m = _LEAST_SIDE_M if ellipse is None else max(_LEAST_SIDE_M, 4.0 * ellipse.semi_major_m)
    return _area_around(
        np.array([candidate.easting_m]), np.array([candidate.northing_m]), side_m, terrain
    )


def _area_around(
    easting_m: Float64Array, northing_m: Float64Array, least_m: float, terrain: HeightField | None
) -> Bbox:
    """Return the part of a square around places that terrain covers.

    The square is at least ``least_m`` wide, and leaves a fifth of its side free beyond the
    outermost places.
    """
    widest_m = max(float(np.ptp(easting_m)), float(np.ptp(northing_m)))
    half_m = max(widest_m / (1.0 - 2.0 * 0.2), least_m) / 2.0
    east_m = float(easting_m.min() + easting_m.max()) / 2.0
    north_m = float(northing_m.min() + northing_m.max()) / 2.0
    area = Bbox.from_extents(east_m - half_m, north_m - half_m, east_m + half_m, north_m + half_m)
    covered = area if terrain is None else Bbox.from_extents(*terrain.bounds_m)
    return Bbox.intersection(area, covered) or area


def draw_match_map(
    candidates: Sequence[Pose],
    area: Bbox,
    frame: Frame,
    viewpoints: Viewpoints,
    terrain: HeightField | None,
    sightings: Sequence[Sighting],
) -> Figure:
    """Draw candidates with their ranks, fields of view and 95 % ellipses.

    The first stands out over the others. The store's viewpoints are dots; ``sightings`` are the
    peaks visible from the first candidate. Without terrain the map has no relief.
    """
    size_in = _WIDTH_IN, _WIDTH_IN * area.height / area.width + 0.5
    figure = Figure(size_in, 150.0, layout="constrained")
    axis = figure.subplots()
    draw_relief(axis, terrain, area)
    shown = _draw_viewpoints(axis, viewpoints, area)
    reach_m = 0.16 * max(area.width, area.height)
    for index, candidate in reversed(list(enumerate(candidates))):
        _draw_candidate(axis, candidate, index == 0, reach_m)
    peaks = [peak for peak in sightings if area.contains(peak.easting_m, peak.northing_m)]
    labels, no_font = labels_of(peaks, [peak.label for peak in peaks])
    most_peaks = 12
    _draw_peaks(axis, labels[:most_peaks], area)
    axis.autoscale(False)
    draw_bearings(axis, frame, area)
    no_room = tuple(label.peak.name for label in labels[most_peaks:])
    title = f"{shown:,} of the store's viewpoints (dots)"
    title += UnnamedPeaks(no_room, no_font).counted.replace("; ", "\n", 1)
    axis.set_title(title, fontsize=9, loc="left")
    return figure


def _draw_viewpoints(axis: Axes, viewpoints: Viewpoints, area: Bbox) -> int:
    """Draw the store's positions within an area; return their number.

    Dots are smaller than the distance between neighbours, so that the map shows between them.
    """
    positions = np.unique(np.stack([viewpoints.easting_m, viewpoints.northing_m], axis=1), axis=0)
    inside = positions[((area.min <= positions) & (positions <= area.max)).all(axis=1)]
    distances_m, _ = cKDTree(positions).query(inside, k=2)
    point_m = area.width / (72.0 * _WIDTH_IN)
    size = np.clip(0.35 * np.asarray(distances_m)[:, 1] / point_m, 0.25, 2.25)
    axis.scatter(inside[:, 0], inside[:, 1], size**2, color="black", alpha=0.7, linewidths=0.0)
    return len(inside)


def _draw_candidate(axis: Axes, candidate: Pose, is_first: bool, reach_m: float) -> None:
    """Draw a candidate's position, view and ellipse; the first stands out."""
    colour = "#d1103d" if is_first else "#1f5fbf"
    order = 4.0 if is_first else 3.0
    reach_m *= 1.0 if is_first else 0.6
    wedge = Polygon(view_wedge_m(candidate, reach_m), closed=True, zorder=order)
    wedge.set(facecolor=(colour, 0.22), edgecolor=(colour, 0.9), linewidth=1.2)
    axis.add_patch(wedge)
    ellipse = Ellipse.of(candidate)
    if ellipse is not None:
        halo = [withStroke(linewidth=3.0, foreground="white")]
        outline = ellipse.outline_m.T
        axis.plot(*outline, color=colour, linewidth=1.4, path_effects=halo, zorder=order + 0.1)
    axis.annotate(
        "×" if candidate.rank is None else str(candidate.rank),
        (candidate.easting_m, candidate.northing_m),
        ha="center",
        va="center",
        fontsize=9 if is_first else 8,
        fontweight="bold",
        color="white",
        zorder=order + 0.5,
        bbox={"boxstyle": "circle,pad=0.22", "fc": colour, "ec": "white", "lw": 1.0},
        annotation_clip=True,
    )


def _draw_peaks(axis: Axes, labels: Sequence[Label[Sighting]], area: Bbox) -> None:
    """Draw peaks with their names, which do not cross the border."""
    for label in labels:
        peak = label.peak
        across = (peak.easting_m - area.x0) / area.width
        side = "left" if across < 0.2 else "right" if across > 0.8 else "center"
        position = peak.easting_m, peak.northing_m
        axis.plot(*position, "^", color="black", markeredgecolor="white", markersize=7, zorder=5)
        axis.annotate(
            label.text,
            position,
            xytext=(0, -6),
            textcoords="offset points",
            ha=side,
            va="top",
            fontsize=8,
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            annotation_clip=True,
            zorder=5,
            **label.style,
        )


def draw_relief(axis: Axes, terrain: HeightField | None, area: Bbox) -> None:
    """Draw the terrain of an area, shaded and tinted by height.

    Without terrain the map is plain and has a note.
    """
    axis.set_facecolor("#eef0ee")
    axis.set(xlim=(area.x0, area.x1), ylim=(area.y0, area.y1), aspect="equal")
    if terrain is not None:
        pixel_m = max(terrain.spacing_m / 2.0, max(area.size) / 900)
        columns = 1 + int(area.width / pixel_m)
        rows = 1 + int(area.height / pixel_m)
        # Coordinates of the pixels' centres, and of one pixel beyond each side.
        east_m = np.clip(area.x0 + pixel_m * np.arange(-0.5, columns + 1), area.x0, area.x1)
        north_m = np.clip(area.y1 - pixel_m * np.arange(-0.5, rows + 1), area.y0, area.y1)
        heights_m = terrain.height_at(easting_m=east_m, northing_m=north_m[:, np.newaxis])
        if not np.isnan(heights_m).all():
            picture = relief(heights_m.astype(np.float32), pixel_m, tint_range_m(heights_m))
            extent = area.x0, area.x0 + columns * pixel_m, area.y1 - rows * pixel_m, area.y1
            axis.imshow(picture, extent=extent, interpolation="bilinear", aspect="equal")
            return
    axis.add_artist(AnchoredText("no elevation data for relief", loc="lower right"))


def draw_bearings(axis: Axes, frame: Frame, area: Bbox) -> None:
    """Draw degrees, a bar of lengths on the ground, and true north."""
    _draw_degrees(axis, frame, area)
    centre = {"easting_m": (area.x0 + area.x1) / 2.0, "northing_m": (area.y0 + area.y1) / 2.0}
    scale = float(frame.scale(**centre))
    length_m = _nice_length(0.28 * area.width / scale)
    text = f"{length_m / 1000.0:g} km" if length_m >= 1000.0 else f"{length_m:g} m"
    box = {"facecolor": "white", "alpha": 0.7, "linewidth": 0.0}
    spaces = {"pad": 0.4, "borderpad": 1.0, "size_vertical": 0.006 * area.height}
    bar = AnchoredSizeBar(
        axis.transData, length_m * scale, text, "lower left", label_top=True, **spaces
    )
    bar.patch.set(**box)
    axis.add_artist(bar)
    turn = -math.radians(float(frame.convergence_deg(**centre)))
    length = 0.1 * min(area.width, area.height)
    tip = area.x0 + 0.06 * area.width, area.y1 - 0.02 * area.height
    foot = tip[0] - length * math.sin(turn), tip[1] - length * math.cos(turn)
    arrow = {"arrowstyle": "-|>,head_width=0.35,head_length=0.8", "lw": 2.0, "color": "black"}
    font: dict[str, Any] = {"fontsize": 11, "fontweight": "bold", "ha": "center", "va": "center"}
    axis.annotate("N", tip, foot, arrowprops=arrow, bbox={"pad": 2.0, **box}, **font)


def _draw_degrees(axis: Axes, frame: Frame, area: Bbox) -> None:
    """Draw degrees along the borders, and their lines across the map."""
    points = 65
    along = np.linspace(0.0, 1.0, points)
    easting_m = area.x0 + along * area.width
    northing_m = area.y0 + along * area.height
    lon, lat = frame.to_lonlat(*np.meshgrid(easting_m, northing_m))
    lon = wrapped_deg(lon, float(lon[points // 2, points // 2]))
    lines: dict[str, Any] = {"colors": "black", "linewidths": 0.4, "alpha": 0.35}
    for degrees, along_m, edge, letters, way in (
        (lon, easting_m, lon[0], "EW", axis.set_xticks),
        (lat, northing_m, lat[:, 0], "NS", axis.set_yticks),
    ):
        step = _nice_length(float(np.ptp(edge)) / 2.5)
        levels = step * np.arange(math.ceil(edge.min() / step), math.floor(edge.max() / step) + 1)
        axis.contour(easting_m, northing_m, degrees, levels, **lines)
        order = np.argsort(edge)
        ticks = np.interp(levels, edge[order], along_m[order])
        decimals = max(0, -math.floor(math.log10(step) + 1e-9))
        way(ticks, [degrees_in_words(level, letters, decimals) for level in levels])
    axis.tick_params(axis="y", labelrotation=90.0)
    for label in axis.get_yticklabels():
        label.set_verticalalignment("center")


def _nice_length(length: float) -> float:
    """Return the greatest round number that does not exceed a length.

    Round numbers are 1, 2 and 5 times a power of ten.
    """
    power = 10.0 ** math.floor(math.log10(length))
    return float(
        max(factor for factor in (1.0, 2.0, 5.0) if factor * power <= length * (1.0 + 1e-9)) * power
    )

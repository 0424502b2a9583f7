"""A query's picture with its skyline, the skyline rendered at a candidate, and named peaks."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, UInt8Array
from skyline.match.ranking import Candidate
from skyline.match.records import pose_name
from skyline.photo.query import QuerySkyline
from skyline.report.figures import Placed, encode_figure, extent_px, place_labels
from skyline.report.peaks import Sighting
from skyline.report.viewer import AROUND, Panorama, peaks_in_picture, pixels_of

_FOUND_COLOUR, _RENDERED_COLOUR = "#ff2d6f", "#00e0ff"

_LONGEST_PX, _NARROWEST_PX = 1600.0, 700.0
_DPI = 100.0
_ROW_PX = 21.0
_LABEL_POINTS = 10.0
_MOST_ROWS = 6
_KEY_ROW_PX = 23.0
_FOUR_KEYS_PX = 1200.0
_CANVAS_RGB = (239, 241, 238)
_HALO = [withStroke(linewidth=3.2, foreground="black", alpha=0.55)]


@dataclass(frozen=True, slots=True, eq=False)
class Overlay:
    """One query's picture and the skylines and peaks to draw over it."""

    query: QuerySkyline
    photo: UInt8Array | None = None
    """(H, W, 3) uint8 RGB, of the query's size; None draws on a blank canvas."""
    candidate: Candidate | None = None
    """The pose at which ``panorama`` and ``sightings`` are seen."""
    panorama: Panorama | None = None
    """The skyline rendered at the candidate."""
    sightings: Sequence[Sighting] = ()
    """Peaks visible from the candidate, the most important first."""

    @property
    def unnamed(self) -> int:
        """Number of peaks in the picture without room for their names."""
        peaks, labels = _place_peaks(self, Figure(dpi=_DPI))
        return len(peaks) - len(labels)

    def jpeg(self) -> bytes:
        """Return the drawn picture; the query's picture in it is at most 1600 px wide and high."""
        with warnings.catch_warnings():
            # Letters that the font lacks are drawn as boxes, which needs no warning.
            warnings.filterwarnings("ignore", message=r"Glyph .* missing from", append=False)
            return encode_figure(_draw(self), "jpeg", _DPI)


def _scale(query: QuerySkyline) -> float:
    """Return the size of the query's pixels in the drawn picture, in its pixels."""
    return min(
        _LONGEST_PX / max(query.width_px, query.height_px),
        max(1.0, _NARROWEST_PX / query.width_px),
    )


def _place_peaks(
    overlay: Overlay, figure: Figure
) -> tuple[list[tuple[str, float, float]], list[Placed]]:
    """Return the peaks in the drawn picture (label, column, row) and the labels that have room."""
    query, pose, scale = overlay.query, overlay.candidate, _scale(overlay.query)
    peaks: list[tuple[str, float, float]] = []
    if pose is not None:
        for sighting, *place_px in peaks_in_picture(pose, query, overlay.sightings):
            column, row = _drawn(place_px, scale).tolist()
            peaks.append((sighting.label, column, row))
    widths = [extent_px(figure, text, _LABEL_POINTS)[0] for text, _, _ in peaks]
    width = max(8.0, query.width_px * scale)
    return peaks, place_labels([at for _, at, _ in peaks], widths, width, _MOST_ROWS)


def _draw(overlay: Overlay) -> Figure:
    query, scale = overlay.query, _scale(overlay.query)
    width, height = (max(8.0, side * scale) for side in (query.width_px, query.height_px))
    figure = Figure(dpi=_DPI)
    FigureCanvasAgg(figure)
    peaks, labels = _place_peaks(overlay, figure)
    band = _ROW_PX * (1 + max((label.row for label in labels), default=-1)) + (
        10.0 if labels else 0
    )
    keys_across = 4 if width >= _FOUR_KEYS_PX else 2
    foot = _KEY_ROW_PX * 4 / keys_across
    figure.set_size_inches(width / _DPI, (height + band + foot) / _DPI)
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set_axis_off()
    axis.set(xlim=(0.0, width), ylim=(height + foot, -band))
    axis.autoscale(False)
    picture = np.full((2, 2, 3), _CANVAS_RGB, dtype=np.uint8)
    if overlay.photo is not None:
        size = round(width), max(1, round(height))
        picture = np.asarray(cv2.resize(overlay.photo, size, interpolation=cv2.INTER_AREA))
    axis.imshow(picture, extent=(0.0, width, height, 0.0), aspect="auto")
    _draw_masked(axis, query, scale, height)
    _draw_rendered(axis, overlay, scale)
    axis.plot(
        _drawn(np.arange(query.width_px), scale),
        _drawn(query.row_px, scale),
        color=_FOUND_COLOUR,
        linewidth=1.6,
        path_effects=_HALO,
        label="skyline found in the query",
    )
    for label in labels:
        text, column, row = peaks[label.index]
        _draw_label(axis, text, label, (column, row))
    axis.legend(loc="lower left", fontsize=9, frameon=False, ncols=keys_across, borderpad=0.1)
    return figure


def _drawn(pixel: ArrayLike, scale: float) -> Float64Array:
    """Convert pixel centres of the query to coordinates of the drawn picture."""
    return (np.asarray(pixel, dtype=np.float64) + 0.5) * scale


def _draw_masked(axis: Axes, query: QuerySkyline, scale: float, height: float) -> None:
    """Veil the columns in which no skyline is trusted."""
    edges = np.flatnonzero(np.diff(~query.trusted, prepend=False, append=False)).reshape(-1, 2)
    spans = [(start * scale, (end - start) * scale) for start, end in edges]
    if spans:
        axis.broken_barh(
            spans,
            (0.0, height),
            facecolor=(0.2, 0.2, 0.25, 0.38),
            hatch="//",
            edgecolor=(1.0, 1.0, 1.0, 0.25),
            linewidth=0.0,
            label="columns not trusted, left out",
        )


def _draw_rendered(axis: Axes, overlay: Overlay, scale: float) -> None:
    """Draw the rendered skyline, dotted where the data's border may hide farther terrain."""
    query, pose = overlay.query, overlay.candidate
    if pose is None or overlay.panorama is None:
        return
    panorama = overlay.panorama.facing(pose.grid_heading_deg)
    column, row = pixels_of(pose, query, panorama.azimuth_deg, panorama.elevation_tan)
    near = np.abs(column - query.width_px / 2.0) <= AROUND * query.width_px
    for sure, style, label in (
        (True, "-", f"skyline rendered at {pose_name(pose)}"),
        (False, ":", "the same, where the elevation data end"),
    ):
        drawn = near & (panorama.is_sure == sure)
        if np.isfinite(row[drawn]).any():
            axis.plot(
                _drawn(column, scale),
                np.where(drawn, _drawn(row, scale), np.nan),
                style,
                color=_RENDERED_COLOUR,
                linewidth=1.5,
                path_effects=_HALO,
                label=label,
            )


def _draw_label(axis: Axes, text: str, label: Placed, peak_px: tuple[float, float]) -> None:
    column, row = peak_px
    foot = -8.0 - label.row * _ROW_PX
    leader = [withStroke(linewidth=2.0, foreground="black", alpha=0.55)]
    axis.plot([column, column], [foot, row - 3.0], "-w", linewidth=0.9, path_effects=leader)
    axis.plot(column, row, "v", color="white", markeredgecolor="black", markersize=6)
    axis.text(
        (label.left_px + label.right_px) / 2.0,
        foot,
        text,
        fontsize=_LABEL_POINTS,
        ha="center",
        va="bottom",
        parse_math=False,
    )

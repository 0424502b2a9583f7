"""A query's picture with its skyline, the skyline rendered at a pose, and named peaks."""

import warnings
from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import ArrayLike

from skyline.arrays import Float64Array, UInt8Array
from skyline.match.candidate import Candidate
from skyline.photo.query import QuerySkyline
from skyline.report.figures import Placed, encode_figure, extent_px, place_labels
from skyline.report.viewer import SeenPeak, Sight

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


def draw_overlay(
    query: QuerySkyline,
    photo: UInt8Array | None = None,
    pose: Candidate | None = None,
    sight: Sight | None = None,
    peaks: Sequence[SeenPeak] = (),
) -> tuple[bytes, int]:
    """Draw skylines and peaks over a query's picture.

    Parameters
    ----------
    photo : (H, W, 3) uint8, optional
        RGB, of the query's size; None draws on a blank canvas.
    pose : Candidate, optional
        The pose from which ``sight`` and ``peaks`` are seen.
    sight : Sight, optional
        The rendered skyline.
    peaks : sequence of SeenPeak
        Peaks in the picture, the most important first.

    Returns
    -------
    bytes, int
        A JPEG with the query's picture at most 1600 px wide and high, and the number of peaks
        without room for their names.
    """
    figure = Figure(dpi=_DPI)
    width, height = _size_px(query)
    labels = _placed(figure, query, peaks, [one.label for one in peaks])
    foot = _KEY_ROW_PX * 4 / _keys_across(width)
    axis = _draw_picture(figure, photo, (width, height), labels, foot)
    _draw_masked(axis, query, height)
    if pose is not None and sight is not None:
        _draw_rendered(axis, query, pose, sight)
    axis.plot(
        _drawn(query, np.arange(query.width_px)),
        _drawn(query, query.row_px),
        color=_FOUND_COLOUR,
        linewidth=1.6,
        path_effects=_HALO,
        label="skyline found in the query",
    )
    for label in labels:
        peak = peaks[label.index]
        _draw_label(axis, peak.label, label, float(_drawn(query, peak.row_px)))
    axis.legend(
        loc="lower left", fontsize=9, frameon=False, ncols=_keys_across(width), borderpad=0.1
    )
    return _encoded(figure, "jpeg"), len(peaks) - len(labels)


def draw_labels(
    query: QuerySkyline,
    photo: UInt8Array,
    peaks: Sequence[SeenPeak],
    sight: Sight | None = None,
    kind: str = "png",
) -> tuple[bytes, int]:
    """Draw a photo with the names and distances of the peaks in it.

    Parameters
    ----------
    photo : (H, W, 3) uint8
        RGB, of the query's size.
    peaks : sequence of SeenPeak
        Peaks in the picture, the most important first.
    sight : Sight, optional
        A rendered skyline, which is drawn faintly.
    kind : str
        ``png``, ``jpeg`` or ``svg``; in SVG names are text, and the photo is embedded.

    Returns
    -------
    bytes, int
        The picture, the photo at most 1600 px wide and high, and the number of peaks without room
        for their names.
    """
    figure = Figure(dpi=_DPI)
    texts = [one.with_distance for one in peaks]
    labels = _placed(figure, query, peaks, texts)
    axis = _draw_picture(figure, photo, _size_px(query), labels, 0.0)
    if sight is not None:
        axis.plot(
            _drawn(query, sight.column_px),
            _drawn(query, sight.row_px),
            color=_RENDERED_COLOUR,
            linewidth=1.0,
            alpha=0.6,
        )
    for label in labels:
        row = float(_drawn(query, peaks[label.index].row_px))
        _draw_label(axis, texts[label.index], label, row)
    return _encoded(figure, kind), len(peaks) - len(labels)


def _encoded(figure: Figure, kind: str) -> bytes:
    with warnings.catch_warnings(), rc_context({"svg.fonttype": "none"}):
        # Letters that the font lacks are drawn as boxes, which needs no warning.
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from", append=False)
        return encode_figure(figure, kind, _DPI)


def _placed(
    figure: Figure, query: QuerySkyline, peaks: Sequence[SeenPeak], texts: Sequence[str]
) -> list[Placed]:
    """Return the places of the peaks' texts above the picture."""
    FigureCanvasAgg(figure)
    widths = [extent_px(figure, text, _LABEL_POINTS)[0] for text in texts]
    anchors = [float(_drawn(query, one.column_px)) for one in peaks]
    return place_labels(anchors, widths, _size_px(query)[0], _MOST_ROWS)


def _size_px(query: QuerySkyline) -> tuple[float, float]:
    """Return the width and height of the query's picture as drawn."""
    scale = _scale(query)
    return max(8.0, query.width_px * scale), max(8.0, query.height_px * scale)


def _scale(query: QuerySkyline) -> float:
    """Return the size of the query's pixels in the drawn picture, in its pixels."""
    return min(
        _LONGEST_PX / max(query.width_px, query.height_px),
        max(1.0, _NARROWEST_PX / query.width_px),
    )


def _drawn(query: QuerySkyline, pixel: ArrayLike) -> Float64Array:
    """Convert pixel centres of the query to coordinates of the drawn picture."""
    return (np.asarray(pixel, dtype=np.float64) + 0.5) * _scale(query)


def _keys_across(width: float) -> int:
    """Return the number of the legend's keys side by side."""
    return 4 if width >= _FOUR_KEYS_PX else 2


def _draw_picture(
    figure: Figure,
    photo: UInt8Array | None,
    size_px: tuple[float, float],
    labels: Sequence[Placed],
    foot: float,
) -> Axes:
    """Draw the photo, or a blank canvas, between a band of labels and a foot of so many pixels."""
    width, height = size_px
    band = _ROW_PX * (1 + max((label.row for label in labels), default=-1)) + (
        10.0 if labels else 0
    )
    figure.set_size_inches(width / _DPI, (height + band + foot) / _DPI)
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set_axis_off()
    axis.set(xlim=(0.0, width), ylim=(height + foot, -band))
    axis.autoscale(False)
    picture = np.full((2, 2, 3), _CANVAS_RGB, dtype=np.uint8)
    if photo is not None:
        size = round(width), max(1, round(height))
        picture = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA))
    axis.imshow(picture, extent=(0.0, width, height, 0.0), aspect="auto")
    return axis


def _draw_masked(axis: Axes, query: QuerySkyline, height: float) -> None:
    """Veil the columns in which no skyline is trusted."""
    scale = _scale(query)
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


def _draw_rendered(axis: Axes, query: QuerySkyline, pose: Candidate, sight: Sight) -> None:
    """Draw the rendered skyline, dotted where the data's border may hide farther terrain."""
    for sure, style, label in (
        (True, "-", f"skyline rendered at {pose.title}"),
        (False, ":", "the same, where the elevation data end"),
    ):
        row = np.where(sight.is_sure == sure, sight.row_px, np.nan)
        if np.isfinite(row).any():
            axis.plot(
                _drawn(query, sight.column_px),
                _drawn(query, row),
                style,
                color=_RENDERED_COLOUR,
                linewidth=1.5,
                path_effects=_HALO,
                label=label,
            )


def _draw_label(axis: Axes, text: str, label: Placed, row: float) -> None:
    """Write a label, with a line down to its peak in a row of the drawn picture."""
    column = label.anchor_px
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

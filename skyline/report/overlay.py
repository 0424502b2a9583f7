"""Photos with their skyline, a rendered skyline, and named peaks."""

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from skyline.arrays import UInt8Array
from skyline.ground.ground_shapes import PhotoShape
from skyline.photo.skyline import PhotoForm, PhotoSkyline
from skyline.pose.pose import Pose
from skyline.report.figure_files import encode_figure
from skyline.report.labels import (
    Label,
    PlacedLabel,
    UnnamedPeaks,
    labels_of,
    place_labels,
    with_distance,
)
from skyline.view.viewer import SeenBody, SeenPeak, Sight

_RENDERED_COLOUR = "#35d0ff"
_DRAWN_COLOUR = "#ffd23f"
"""Colour of the skyline found, the sun, the moon and lines of the map."""
_DPI = 100.0
_ROW_PX = 21.0
"""Height of a row of labels."""
_HALO = [withStroke(linewidth=3.2, foreground="black", alpha=0.55)]


def draw_overlay(
    skyline: PhotoSkyline,
    photo: UInt8Array | None,
    pose: Pose | None,
    sight: Sight | None = None,
    peaks: Sequence[SeenPeak] = (),
) -> tuple[bytes, UnnamedPeaks]:
    """Draw skylines and the names of peaks over a photo.

    Returns a JPEG and the peaks left unnamed. Without a photo the canvas is blank. ``sight`` and
    ``peaks`` are seen from ``pose``; see `draw_labels`.
    """
    texts = [one.label for one in peaks]
    # The legend has two rows, 46 px high.
    figure, axis, unnamed = _draw_picture(skyline, photo, peaks, texts, foot_px=46.0)
    _draw_masked(axis, skyline)
    if pose is not None and sight is not None:
        _draw_rendered(axis, pose, sight)
    axis.plot(
        skyline.row_px,
        color=_DRAWN_COLOUR,
        linewidth=1.6,
        path_effects=_HALO,
        label="skyline found in the photo",
    )
    axis.legend(loc="lower left", fontsize=9, frameon=False, ncols=2, borderpad=0.1)
    return _encoded(figure, "jpeg"), unnamed


def draw_labels(
    form: PhotoForm,
    photo: UInt8Array,
    peaks: Sequence[SeenPeak],
    sight: Sight | None = None,
    kind: str = "png",
    bodies: Sequence[SeenBody] = (),
) -> tuple[bytes, UnnamedPeaks]:
    """Draw a photo with the names and distances of its peaks.

    Parameters
    ----------
    form : Photo or PhotoSkyline
        Its size counts.
    photo : (H, W, 3) uint8
        RGB, of the size of ``form``.
    peaks : sequence of SeenPeak
        Peaks in the picture, the most important first.
    sight : Sight, optional
        A rendered skyline, which is drawn faintly.
    kind : str
        ``png``, ``jpeg`` or ``svg``; in SVG names are text, and the photo is embedded.
    bodies : sequence of SeenBody
        The sun and the moon, whose discs are outlined; dashed where terrain hides them.

    Returns
    -------
    bytes, UnnamedPeaks
        The picture, with the photo at most 1600 px wide and high; and the peaks left unnamed,
        because names would overlap or no installed font draws them.
    """
    texts = list(map(with_distance, peaks))
    figure, axis, unnamed = _draw_picture(form, photo, peaks, texts)
    if sight is not None:
        axis.plot(sight.column_px, sight.row_px, color=_RENDERED_COLOUR, linewidth=1.0, alpha=0.6)
    for body in bodies:
        _draw_body(axis, body)
    return _encoded(figure, kind), unnamed


def _draw_body(axis: Axes, body: SeenBody) -> None:
    """Outline the disc of the sun or moon, with its name below."""
    style = "--" if body.is_hidden else "-"
    column_px, row_px = body.outline_px.T
    axis.plot(column_px, row_px, style, color=_DRAWN_COLOUR, linewidth=1.4, path_effects=_HALO)
    foot_px = float(np.nanmax(body.outline_px[:, 1]))
    axis.annotate(
        f"{body.name}, hidden" if body.is_hidden else body.name,
        (body.column_px, foot_px),
        (0.0, -3.0),
        textcoords="offset points",
        ha="center",
        va="top",
        fontsize=10.0,
        color=_DRAWN_COLOUR,
        path_effects=_HALO,
    )


def draw_shapes(
    form: PhotoForm, photo: UInt8Array, shapes: Sequence[PhotoShape], kind: str = "png"
) -> bytes:
    """Draw shapes of the map over a photo, hidden parts dashed.

    Parameters
    ----------
    form : Photo or PhotoSkyline
        Its size counts.
    photo : (H, W, 3) uint8
        RGB, of the size of ``form``.
    kind : str
        As in `draw_labels`.

    Returns
    -------
    bytes
        The picture, the photo at most 1600 px wide and high.
    """
    figure, axis, _ = _draw_picture(form, photo, (), ())
    for one in shapes:
        for part, is_hidden in one.parts(form.width_px, form.height_px):
            style: dict[str, Any] = {
                "linestyle": "--" if is_hidden else "-",
                "alpha": 0.6 if is_hidden else 1.0,
            }
            if len(part) == 1:
                style = {"marker": "o", "fillstyle": "none" if is_hidden else "full"}
            axis.plot(*part.T, color=_DRAWN_COLOUR, linewidth=2.0, path_effects=_HALO, **style)
    return _encoded(figure, kind)


def _encoded(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file, with names as text in SVG."""
    with rc_context({"svg.fonttype": "none"}):
        return encode_figure(figure, kind)


def _draw_picture(
    form: PhotoForm,
    photo: UInt8Array | None,
    peaks: Sequence[SeenPeak],
    texts: Sequence[str],
    foot_px: float = 0.0,
) -> tuple[Figure, Axes, UnnamedPeaks]:
    """Draw the photo with the peaks' texts above it.

    Without a photo, a blank canvas is drawn. Below it, ``foot_px`` are left empty, and a line tells
    the number of names that no font draws. The picture is at most 1600 px wide and high, and at
    least 700 px wide if that leaves it no higher. Returns the figure, axes in pixels of the photo,
    and the peaks without their texts.
    """
    figure = Figure(dpi=_DPI)
    FigureCanvasAgg(figure)
    # Pixels of the picture for one of the photo.
    most = 1600.0 / max(form.width_px, form.height_px)
    scale = min(most, max(1.0, 700.0 / form.width_px))
    drawn_px = form.width_px * scale, form.height_px * scale
    font_pt = 10.0
    labels, no_font = labels_of(peaks, texts)
    placed = place_labels(
        [(one.peak.column_px + 0.5) * scale for one in labels],
        [one.extent_px(figure, font_pt)[0] for one in labels],
        drawn_px[0],
        rows=6,
        gap=8.0,
    )
    drawn = {one.index for one in placed}
    no_room = tuple(one.peak.name for at, one in enumerate(labels) if at not in drawn)
    unnamed = UnnamedPeaks(no_room, no_font)
    band_px = max((_ROW_PX * (1 + one.row) + 10.0 for one in placed), default=0.0)
    foot_px += _ROW_PX if no_font else 0.0
    figure.set_size_inches(drawn_px[0] / _DPI, (drawn_px[1] + band_px + foot_px) / _DPI)
    axis = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axis.set_axis_off()
    right = form.width_px - 0.5
    bottom = form.height_px - 0.5
    axis.set(xlim=(-0.5, right), ylim=(bottom + foot_px / scale, -0.5 - band_px / scale))
    axis.autoscale(False)
    picture = np.full((2, 2, 3), (239, 241, 238), dtype=np.uint8)
    if photo is not None:
        size = round(drawn_px[0]), max(1, round(drawn_px[1]))
        picture = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA))
    axis.imshow(picture, extent=(-0.5, right, bottom, -0.5), aspect="auto")
    font: dict[str, Any] = {"fontsize": font_pt, "ha": "center", "va": "bottom"}
    for one in placed:
        _draw_name(axis, labels[one.index], one, scale, font)
    if no_font:
        note = UnnamedPeaks(no_font=no_font).counted.removeprefix("; ")
        axis.text(drawn_px[0] / 2.0 / scale - 0.5, bottom + _ROW_PX / scale, note, **font)
    return figure, axis, unnamed


def _draw_name(
    axis: Axes, label: Label[SeenPeak], placed: PlacedLabel, scale: float, font: Mapping[str, Any]
) -> None:
    """Draw a peak's mark, its name above the photo, and a line between them.

    ``scale`` is the number of the picture's pixels for one of the photo.
    """
    peak = label.peak
    outline = [withStroke(linewidth=2.0, foreground="black", alpha=0.55)]
    foot = (-8.0 - placed.row * _ROW_PX) / scale - 0.5
    middle = (placed.left + placed.right) / 2.0 / scale - 0.5
    leader = [foot, peak.row_px - 3.0 / scale]
    axis.plot([peak.column_px] * 2, leader, "w", linewidth=0.9, path_effects=outline, zorder=2.5)
    axis.plot(peak.column_px, peak.row_px, "vw", markeredgecolor="black", markersize=6, zorder=2.5)
    axis.text(middle, foot, label.text, **font, **label.style)


def _draw_masked(axis: Axes, skyline: PhotoSkyline) -> None:
    """Veil the columns without a trusted skyline."""
    edges = np.flatnonzero(np.diff(~skyline.trusted, prepend=False, append=False)).reshape(-1, 2)
    spans = [(start - 0.5, end - start) for start, end in edges]
    if spans:
        axis.broken_barh(
            spans,
            (-0.5, skyline.height_px),
            facecolor=(0.2, 0.2, 0.25, 0.38),
            hatch="//",
            edgecolor=(1.0, 1.0, 1.0, 0.25),
            linewidth=0.0,
            label="columns not trusted, left out",
        )


def _draw_rendered(axis: Axes, pose: Pose, sight: Sight) -> None:
    """Draw the rendered skyline, dotted where it is not sure.

    It is not sure where terrain beyond the elevation data may rise above it.
    """
    for sure, style, label in (
        (True, "-", f"skyline rendered at {pose.title}"),
        (False, ":", "the same, where the elevation data end"),
    ):
        row = np.where(sight.is_sure == sure, sight.row_px, np.nan)
        if np.isfinite(row).any():
            axis.plot(
                sight.column_px,
                row,
                style,
                color=_RENDERED_COLOUR,
                linewidth=1.5,
                path_effects=_HALO,
                label=label,
            )

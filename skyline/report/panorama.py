"""Panoramas to print: fading terrain, ridges, a compass and named summits."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from skyline.arrays import Float64Array, UInt8Array
from skyline.errors import suffix_of
from skyline.files.disk import write_whole
from skyline.geodesy.bounds import degrees_in_words
from skyline.report.figure_files import encode_figure
from skyline.report.labels import (
    Label,
    UnnamedPeaks,
    labels_of,
    place_labels,
    with_distance,
)
from skyline.report.panorama_view import (
    COLUMNS,
    PanoramaConfig,
    PanoramaView,
    panorama_view,
    row_count,
)
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.surface_model import read_surface
from skyline.terrain.viewpoints import stand_at_one
from skyline.view.peaks import Peaks
from skyline.view.sightings import Sighting

PANORAMA_SUFFIXES = (".png", ".svg", ".pdf")
"""Suffixes of the files that panoramas can be written to."""
SUMMIT = "summit"
"""The id that the names of summits have in the figure."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """Sizes on the page."""

    width_in: float = 16.0
    margin_in: float = 0.45
    """Margin on the left and on the right, in which the degrees of elevation stand."""
    scale_in: float = 0.7
    """Height of the compass under a row."""
    title_in: float = 0.45
    """Height of the title."""
    font_pt: float = 8.0
    """Size of names and degrees."""
    title_pt: float = 11.0
    """Greatest size of the title, which is made smaller to fit in."""

    @property
    def row_in(self) -> float:
        """Width of a row."""
        return self.width_in - 2.0 * self.margin_in


_LAYOUT = _Layout()
_ROCK = np.array([0.46, 0.47, 0.38])
"""Colour of near terrain."""
_HAZE = np.array([0.80, 0.87, 0.93])
"""Colour of terrain that haze hides."""
_log = logging.getLogger(__name__)


def save_panorama(
    terrain: Dem,
    path: str | Path,
    *,
    lon: float,
    lat: float,
    peaks: Peaks | None = None,
    config: PanoramaConfig | None = None,
    surface: Dem | None = None,
) -> int:
    """Draw the terrain and named peaks visible from a place.

    Parameters
    ----------
    terrain : path, paths, DataArray or HeightField
        The elevation model.
    path : str or Path
        ``.png``, ``.svg`` or ``.pdf``.
    lon, lat : float
        Degrees (WGS 84).
    peaks : Peaks, optional
        Named summits; see `skyline.read_peaks`.
    surface : path, paths, DataArray or HeightField, optional
        A surface or canopy model: a green line shows how far trees and houses may rise.

    Returns
    -------
    int
        Number of peaks visible in the picture. If two names would overlap, the less prominent peak
        gets none. Neither does a peak whose name no installed font draws; a warning names it. The
        picture's title gives the number of peaks without a name.

    Raises
    ------
    OffMapError
        The place is off the map or on a hole.
    InputError
        The suffix is unknown, the file cannot be written, or the surface does not cover the DEM.
    ContextError
        A surface is given and no OpenGL context can be created.
    """
    suffix_of(path, PANORAMA_SUFFIXES)
    terrain = read_dem(terrain)
    over = None if surface is None else read_surface(surface, terrain)
    config = config or PanoramaConfig()
    eye = stand_at_one(
        terrain,
        lon=lon,
        lat=lat,
        eye_height_m=config.eye_height_m,
        summit_within_m=config.summit_within_m,
    )
    view = panorama_view(terrain, eye, peaks, config, over)
    unnamed = save_view(view, path)
    if unnamed.no_font:
        _log.warning("%s%s", path, unnamed.named)
    return len(view.sightings)


def save_view(view: PanoramaView, path: str | Path) -> UnnamedPeaks:
    """Draw a view as a panorama; return the peaks left unnamed."""
    figure, unnamed = draw_panorama(view)
    write_whole(Path(path), encode_figure(figure, suffix_of(path, PANORAMA_SUFFIXES)[1:]))
    return unnamed


def draw_panorama(view: PanoramaView) -> tuple[Figure, UnnamedPeaks]:
    """Draw a panorama in rows, with one scale for azimuth and elevation.

    Returns the figure and the peaks left unnamed.
    """
    figure = Figure(dpi=150)
    FigureCanvasAgg(figure)
    labels, no_font = labels_of(view.sightings, list(map(with_distance, view.sightings)))
    rows = [_Row.of(view, row, labels, figure) for row in range(row_count(view.config.fov_deg))]
    rows_in = sum(row.names_in + row.high_in + _LAYOUT.scale_in for row in rows)
    total_in = _LAYOUT.title_in + rows_in
    figure.set_size_inches(_LAYOUT.width_in, total_in)
    left = _LAYOUT.margin_in / _LAYOUT.width_in
    wide = 1.0 - 2.0 * _LAYOUT.margin_in / _LAYOUT.width_in
    top_in = total_in - _LAYOUT.title_in
    colours = _colours(view)
    drawn: list[Label[Sighting]] = []
    for row in rows:
        bottom_in = top_in - row.names_in - row.high_in
        axis = figure.add_axes((left, bottom_in / total_in, wide, row.high_in / total_in))
        _draw_row(axis, view, row, colours)
        drawn += _draw_names(axis, row)
        top_in = bottom_in - _LAYOUT.scale_in
    known = set(map(id, drawn))
    no_room = tuple(label.peak.name for label in labels if id(label) not in known)
    unnamed = UnnamedPeaks(no_room, no_font)
    words = _title(view) + unnamed.counted
    title_pt = _LAYOUT.title_pt
    title = figure.text(left, 1.0 - 0.3 / total_in, words, fontsize=title_pt, va="baseline")
    share = wide * figure.bbox.width / title.get_window_extent().width
    title.set_fontsize(title_pt * min(share, 1.0))
    return figure, unnamed


class _Name(NamedTuple):
    """The name of a summit, and where the summit stands."""

    label: Label[Sighting]
    azimuth_deg: float
    summit_deg: float
    """Elevation angle of the summit."""
    wide_in: float
    """Width of the upright name."""


@dataclass(frozen=True, slots=True, eq=False)
class _Row:
    """One row of the picture: its azimuths, elevation angles and names."""

    columns: slice
    """Columns of the landscape."""
    ends_deg: tuple[float, float]
    """Azimuths of the left and the right end."""
    span_deg: tuple[float, float]
    """Elevation angles of the lower and the upper border."""
    names: list[_Name]
    in_a_deg: float
    """Inches per degree, sideways and upwards."""
    high_in: float
    """Height of the landscape."""
    names_in: float
    """Height of the names above it."""

    @classmethod
    def of(
        cls, view: PanoramaView, row: int, labels: Sequence[Label[Sighting]], figure: Figure
    ) -> _Row:
        """Return a row of a view, with its share of the labels.

        Its range of elevations is 12 degrees or more, down to 7 degrees below the lowest skyline.
        """
        columns = slice(row * COLUMNS, (row + 1) * COLUMNS)
        row_deg = view.config.fov_deg / row_count(view.config.fov_deg)
        ends = view.config.start_deg + row * row_deg, view.config.start_deg + (row + 1) * row_deg
        skyline_deg = view.landscape.skyline_deg[columns]
        highest_deg = skyline_deg if view.surface_deg is None else view.surface_deg[columns]
        high_deg = float(highest_deg.max()) + 1.0
        low_deg = max(float(skyline_deg.min()) - 7.0, -89.0)
        low_deg = min(low_deg, high_deg - 12.0)
        names = []
        names_in = 0.0
        for label in labels:
            one = label.peak
            true_deg = one.grid_azimuth_deg + view.landscape.convergence_deg
            azimuth_deg = ends[0] + (true_deg - ends[0]) % 360.0
            summit_deg = float(np.degrees(np.arctan(one.elevation_tan)))
            if azimuth_deg < ends[1] and summit_deg > low_deg:
                # The upright name is as high as the text is long.
                long_px, wide_px = label.extent_px(figure, _LAYOUT.font_pt)
                names.append(_Name(label, azimuth_deg, summit_deg, wide_px / figure.dpi))
                names_in = max(names_in, long_px / figure.dpi + 0.35)
        in_a_deg = _LAYOUT.row_in / row_deg
        high_in = in_a_deg * (high_deg - low_deg)
        return cls(columns, ends, (low_deg, high_deg), names, in_a_deg, high_in, names_in)


def _draw_row(axis: Axes, view: PanoramaView, row: _Row, colours: UInt8Array) -> None:
    """Draw the landscape of a row, and its scales."""
    begin, end = row.ends_deg
    low, high = row.span_deg
    pixel_deg = (end - begin) / COLUMNS
    azimuth = view.landscape.azimuth_deg[row.columns]
    elevation = np.arange(low + 0.5 * pixel_deg, high, pixel_deg)
    seen = view.landscape.seen(row.columns, elevation)
    axis.imshow(
        colours[seen],
        extent=(begin, end, low, high),
        origin="lower",
        aspect="auto",
        interpolation="nearest",
    )
    ridge_m, ridge_deg = view.landscape.ridges()
    haze = _haze(ridge_m, view.landscape.reach_m)[::-1, np.newaxis]
    lines = ridge_deg[::-1, row.columns]
    axis.add_collection(
        LineCollection(
            [np.stack([azimuth, line], axis=1) for line in lines],
            colors=(1.0 - haze) * 0.35 * _ROCK + haze * 0.72 * _HAZE,
            linewidths=0.7,
            capstyle="round",
        )
    )
    if view.surface_deg is not None:
        axis.plot(azimuth, view.surface_deg[row.columns], color="#2e8b57", linewidth=0.7)
    axis.set(xlim=(begin, end), ylim=(low, high), facecolor="#f4f8fb")
    _draw_compass(axis, (begin, end))


def _colours(view: PanoramaView) -> UInt8Array:
    """Return RGBA colours (P + 1, 4) of landscape and sky.

    The landscape's points come first, the sky last. Light falls over the viewer's left shoulder,
    from 60 degrees aside and 40 degrees up, in every direction of view.
    """
    landscape = view.landscape
    terrain = landscape.terrain
    eye = landscape.eye
    away_m = landscape.distance_m
    grid = np.radians(landscape.azimuth_deg - landscape.convergence_deg)[landscape.column]
    east_m = eye.easting_m[0] + away_m * np.sin(grid)
    north_m = eye.northing_m[0] + away_m * np.cos(grid)
    step_m = terrain.spacing_m
    # Rises to the east and to the north.
    east, north = (
        terrain.height_at(easting_m=east_m + right_m, northing_m=north_m + up_m)
        - terrain.height_at(easting_m=east_m - right_m, northing_m=north_m - up_m)
        for right_m, up_m in ((step_m, 0.0), (0.0, step_m))
    )
    east /= 2.0 * step_m
    north /= 2.0 * step_m
    light_up = np.radians(40.0)
    towards = grid + np.pi - np.radians(60.0)
    facing = east * np.sin(towards) + north * np.cos(towards)
    lit = np.sin(light_up) - np.cos(light_up) * facing
    light = np.nan_to_num(np.clip(lit / np.sqrt(1.0 + east**2 + north**2), 0.0, 1.0), nan=0.5)
    haze = _haze(away_m, landscape.reach_m)[:, np.newaxis]
    lighted = _ROCK * (0.25 + 1.25 * light[:, np.newaxis])
    colours = np.zeros((len(away_m) + 1, 4), np.uint8)
    colours[:-1, :3] = np.clip((1.0 - haze) * lighted + haze * _HAZE, 0.0, 1.0) * 255.0 + 0.5
    colours[:-1, 3] = 255
    return colours


def _haze(distance_m: Float64Array, reach_m: float) -> Float64Array:
    """Return the share, 0 to 1, of terrain's colour that haze hides."""
    return np.asarray(0.85 * (1.0 - np.exp(-2.0 * distance_m / reach_m)))


def _draw_compass(axis: Axes, ends: tuple[float, float]) -> None:
    """Draw the points of the compass and degrees along two sides."""
    points = {0: "N", 45: "NE", 90: "E", 135: "SE", 180: "S", 225: "SW", 270: "W", 315: "NW"}
    wide = ends[1] - ends[0]
    step, fine = (15, 1.0) if wide > 60.0 else (5, 1.0) if wide > 20.0 else (1, 0.1)
    ticks = np.arange(np.ceil(ends[0] / step) * step, ends[1] + 1e-9, step)
    names = [f"{tick % 360:.0f}°\n{points.get(int(tick) % 360, '')}" for tick in ticks]
    axis.set_xticks(ticks, names)
    axis.set_xticks(np.arange(np.ceil(ends[0] / fine) * fine, ends[1], fine), minor=True)
    axis.tick_params(labelsize=_LAYOUT.font_pt)
    axis.yaxis.set_major_locator(MaxNLocator("auto", integer=True))
    axis.yaxis.set_major_formatter("{x:.0f}°")
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)


def _draw_names(axis: Axes, row: _Row) -> list[Label[Sighting]]:
    """Write upright names with lines to summits; return their labels."""
    begin, end = row.ends_deg
    in_a_deg = row.in_a_deg
    placed = place_labels(
        [(name.azimuth_deg - begin) * in_a_deg for name in row.names],
        [name.wide_in for name in row.names],
        (end - begin) * in_a_deg,
        rows=1,
        gap=0.015,
    )
    leaders = []
    for one in placed:
        label, azimuth_deg, summit_deg, _ = row.names[one.index]
        middle = begin + 0.5 * (one.left + one.right) / in_a_deg
        high = row.span_deg[1]
        foot = high + 0.15 / in_a_deg
        leaders.append([(azimuth_deg, summit_deg), (azimuth_deg, high), (middle, foot)])
        axis.text(
            middle,
            foot + 0.04 / in_a_deg,
            label.text,
            gid=SUMMIT,
            rotation=90,
            ha="center",
            va="bottom",
            fontsize=_LAYOUT.font_pt,
            **label.style,
        )
    axis.add_collection(LineCollection(leaders, colors="#333333", linewidths=0.45, clip_on=False))
    return [row.names[one.index].label for one in placed]


def _title(view: PanoramaView) -> str:
    """Return the place and the eye's height in words."""
    landscape = view.landscape
    eye = landscape.eye
    position = {"easting_m": eye.easting_m[0], "northing_m": eye.northing_m[0]}
    lon, lat = (float(at) for at in landscape.terrain.frame.to_lonlat(*position.values()))
    surface_m = float(landscape.terrain.height_at(**position))
    ground_m = float(eye.eye_elevation_m[0]) - view.config.eye_height_m
    # A lift of less than half a metre does not show in whole metres.
    beside = ", as high as the summit beside it" if ground_m - surface_m > 0.5 else ""
    return (
        f"{degrees_in_words(lat, 'NS')}, {degrees_in_words(lon, 'EW')}, {ground_m:.0f} m{beside}, "
        f"seen from {eye.eye_elevation_m[0] - ground_m:.1f} m above ground; "
        "azimuths from true north"
        + ("; green: how far trees and houses may rise" if view.surface_deg is not None else "")
    )

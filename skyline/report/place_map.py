"""The map of the places of a store, over the shaded terrain."""

from pathlib import Path

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from skyline.report.pictures import save_figure
from skyline.report.relief import Area, draw_bearings, draw_relief
from skyline.store.places import Places
from skyline.terrain.heightfield import HeightField

_WIDTH_IN = 9.0
_INK_SHARE = 0.35
"""Of the picture, that points cover between them."""


def save_place_map(terrain: HeightField, places: Places, path: Path) -> None:
    """Save a map (PNG) of places (N), coloured by the spacing that each has there.

    Raises `InputError` where the file cannot be written.
    """
    spacing_m = 2.0 * places.tolerance_m
    easting_m, northing_m = places.easting_m, places.northing_m
    area = Area(easting_m.min(), northing_m.min(), easting_m.max(), northing_m.max())
    height_in = _WIDTH_IN * max(area.height_m, 1.0) / max(area.width_m, 1.0)
    figure = Figure(figsize=(_WIDTH_IN + 1.0, height_in + 0.7), layout="constrained")
    axis = figure.subplots()
    draw_relief(axis, terrain, area)
    points_in = 72.0 * np.sqrt(_INK_SHARE * _WIDTH_IN * height_in / len(places))
    drawn = axis.scatter(
        easting_m,
        northing_m,
        c=spacing_m,
        s=float(np.clip(points_in, 0.5, 6.0)) ** 2,
        cmap="plasma",
        norm=LogNorm(spacing_m.min(), max(spacing_m.max(), 1.01 * spacing_m.min())),
        linewidths=0.0,
    )
    draw_bearings(axis, terrain.frame, area)
    axis.set_title(f"{len(places):,} places", fontsize=10)
    bar = figure.colorbar(drawn, ax=axis, shrink=0.8, pad=0.01)
    bar.set_label("spacing of the places (m)")
    ticks = np.unique(spacing_m)
    bar.set_ticks(list(ticks), labels=[f"{tick:.0f}" for tick in ticks])
    bar.minorticks_off()
    save_figure(figure, path)

"""Predicted views: what stored views say is seen from displaced eyes."""

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, IntArray
from skyline.errors import InputError
from skyline.paper.reprojection import displacements_m
from skyline.prediction.curves import Image, Polylines, Reach, Scenery
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import FLAG_NO_DATA, Shells, Views

_POINTS_AT_ONCE = 1 << 18
"""Points projected together, which bounds the memory in use."""


def predict(
    stored: Views,
    source: NDArray[np.integer],
    targets: Viewpoints,
    columns: int | None = None,
    with_shells: bool = False,
) -> Views:
    """Predict the views of other eyes along the headings of stored views.

    From the distance shells where the stored views have them, else from the skylines. Stored
    views of the two neighbouring headings from the same eye add what they know.

    Parameters
    ----------
    stored : Views
    source : (M,) int
        The stored view that each prediction is made from; it gives the heading.
    targets : Viewpoints
        M eyes.
    columns : int, optional
        Columns of the predicted views, at most those of the stored ones, which is the default;
        fewer are means over runs of columns and are faster.
    with_shells : bool
        Whether the predicted views carry shells: each holds what the stored shell held, so its
        depths may lie beyond the shell's edges by the length of the displacement.

    Returns
    -------
    Views
        M views in order. A column of which nothing is known is NaN and flagged `FLAG_NO_DATA`.

    Raises
    ------
    InputError
        Sources and targets that differ in number, a source that is no row, or shells asked of
        views without.
    """
    source = np.asarray(source)
    _check(stored, source, targets, with_shells)
    scenery = Scenery.of(stored, columns or stored.width, use_shells=True)
    layers, width = (scenery.layers if with_shells else 1), scenery.columns
    tan = np.empty((len(source), layers, width), dtype=np.float32)
    depth = np.empty_like(tan)
    for rows in _rows_of_sources(source):
        view = int(source[rows[0]])
        there = displacements_m(
            stored[view : view + 1],
            targets.easting_m[np.newaxis, rows],
            targets.northing_m[np.newaxis, rows],
            targets.eye_elevation_m[np.newaxis, rows],
        )[0]
        polylines = scenery.polylines(view, Reach.of(there))
        some = max(1, _POINTS_AT_ONCE // max(1, len(polylines.up_m)))
        for begin in range(0, len(rows), some):
            part = slice(begin, begin + some)
            tan[rows[part]], depth[rows[part]] = _highest(polylines, there[part], layers, width)
    highest = np.where(np.isnan(tan), -np.inf, tan).argmax(axis=1)[:, np.newaxis]
    elevation_tan = np.take_along_axis(tan, highest, axis=1)[:, 0]
    shells = stored.shells if with_shells else None
    return Views(
        targets.easting_m,
        targets.northing_m,
        targets.eye_elevation_m,
        stored.heading[source],
        elevation_tan,
        np.take_along_axis(depth, highest, axis=1)[:, 0],
        np.where(np.isnan(elevation_tan), FLAG_NO_DATA, 0).astype(np.uint8),
        Shells(shells.edges_m, tan, depth) if shells is not None else None,
    )


def _rows_of_sources(source: NDArray[np.integer]) -> list[IntArray]:
    """Return, for each source in use, which targets have it."""
    order = np.argsort(source, kind="stable")
    ends = np.flatnonzero(np.diff(source[order])) + 1
    return [rows for rows in np.split(order, ends) if rows.size]


def _check(
    stored: Views, source: NDArray[np.integer], targets: Viewpoints, with_shells: bool
) -> None:
    if source.shape != (len(targets),):
        raise InputError(
            f"sources have shape {source.shape}; expected ({len(targets)},), one stored view for "
            "each target"
        )
    if source.size and (source.min() < 0 or source.max() >= len(stored)):
        raise InputError(
            f"sources run from {source.min()} to {source.max()}; expected rows of the "
            f"{len(stored)} stored views"
        )
    if with_shells and stored.shells is None:
        raise InputError(
            "predicted shells were asked for, but the stored views have none; render them with "
            "shell_edges_m"
        )


def _highest(
    polylines: Polylines, displacements_m: Float64Array, layers: int, columns: int
) -> tuple[Float32Array, Float32Array]:
    """Return what is highest for C eyes in each layer, or in the only one: tan and depth.

    Both are (C, layers, columns).
    """
    image = Image.of(polylines, displacements_m, columns)
    layer = polylines.layer[image.point()] if layers > 1 else 0
    cell, elevation_tan = image.cell(layer, layers), image.elevation_tan()
    tan = np.full(len(displacements_m) * layers * columns, -np.inf, dtype=np.float32)
    np.maximum.at(tan, cell, elevation_tan)
    highest = elevation_tan == tan[cell]
    depth = np.full_like(tan, np.nan)
    np.fmin.at(depth, cell[highest], image.depth_m()[highest])
    tan[np.isneginf(tan)] = np.nan
    shape = (len(displacements_m), layers, columns)
    return tan.reshape(shape), depth.reshape(shape)

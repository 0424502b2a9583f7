"""Predicted views: what stored views say is seen from displaced eyes."""

import numpy as np
from numpy.typing import NDArray

from skyline.errors import InputError
from skyline.prediction.curves import Samples, Scenery, sample
from skyline.prediction.displacement import Reach, displacements_m
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import FLAG_NO_DATA, Shells, Views

Float32Array = NDArray[np.float32]
IntArray = NDArray[np.intp]


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
    width, layers = scenery.elevation_tan.shape[2], scenery.layers
    tan = np.full((len(source), layers, width), np.nan, dtype=np.float32)
    depth = np.full_like(tan, np.nan)
    for view in np.unique(source):
        rows = np.flatnonzero(source == view)
        there = displacements_m(
            stored[np.full(1, view)],
            targets.easting_m[np.newaxis, rows],
            targets.northing_m[np.newaxis, rows],
            targets.eye_elevation_m[np.newaxis, rows],
        )[0]
        polylines = scenery.polylines(int(view), Reach.of(there))
        tan[rows], depth[rows] = _highest(
            sample(polylines, there, width), (len(rows), layers, width)
        )
    skyline = np.where(np.isnan(tan), -np.inf, tan).argmax(axis=1)[:, np.newaxis]
    elevation_tan = np.take_along_axis(tan, skyline, axis=1)[:, 0]
    shells = stored.shells if with_shells else None
    return Views(
        targets.easting_m,
        targets.northing_m,
        targets.eye_elevation_m,
        stored.heading[source],
        elevation_tan,
        np.take_along_axis(depth, skyline, axis=1)[:, 0],
        np.where(np.isnan(elevation_tan), FLAG_NO_DATA, 0).astype(np.uint8),
        Shells(shells.edges_m, tan, depth) if shells is not None else None,
    )


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


def _highest(samples: Samples, shape: tuple[int, int, int]) -> tuple[Float32Array, Float32Array]:
    """Return the highest samples' elevation_tan and depth in each (eye, layer, column)."""
    _, layers, columns = shape
    cell = (samples.eye * layers + samples.layer) * columns + samples.column
    tan = np.full(np.prod(shape), -np.inf, dtype=np.float32)
    np.maximum.at(tan, cell, samples.elevation_tan)
    highest = samples.elevation_tan == tan[cell]
    nearness = np.full_like(tan, np.nan)
    np.fmax.at(nearness, cell[highest], samples.nearness_per_m[highest])
    tan[np.isneginf(tan)] = np.nan
    return tan.reshape(shape), (1.0 / nearness).reshape(shape)

"""The surface of trees and houses over a terrain, on the terrain's grid: an upper bound."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from skyline.arrays import Float64Array
from skyline.errors import InputError
from skyline.terrain.cleaning import strips
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField

UNKNOWN_M = 40.0
"""Height above ground assumed where the model has no height: that of tall trees."""

_CANOPY_MOST_M = 120.0
"""The greatest height in a canopy model; a surface model of high ground has greater ones."""
_OFFSET_M = (-10.0, 60.0)
"""Lowest and highest plausible median of a surface above the ground."""


Dem = str | Path | Sequence[str | Path] | HeightField
"""A model: its file, its tiles, or the height field read from them."""


def read_surface(paths: Dem, terrain: HeightField) -> HeightField:
    """Read a surface or canopy model as an upper bound for trees and houses on a terrain.

    Raises `InputError` where the model does not cover the terrain or its heights have another
    datum, and as `read_dem`.

    Parameters
    ----------
    paths : path, paths or HeightField
        A surface model, whose heights have the terrain's datum, or a canopy model, whose heights
        are above the ground: a model that lies far below the ground is taken for a canopy model.
        Any grid and CRS; files that name none have the CRS that was given for the terrain's.
    terrain : HeightField
        The bare ground.

    Returns
    -------
    HeightField
        On the terrain's samples, nowhere lower: the ground, plus the model's greatest height above
        it within a sample's distance, or plus 40 m where the model has no height.
    """
    if not isinstance(paths, HeightField):
        crs = DemOptions.from_json(terrain.provenance.options).crs
        paths = read_dem(paths, DemOptions(crs=crs))
    above_m = _above_ground_m(paths, terrain)
    wide = [
        max(1, 2 * math.ceil(coarse / fine - 1e-6) - 1)
        for coarse, fine in (
            (terrain.spacing_north_m, paths.spacing_north_m),
            (terrain.spacing_east_m, paths.spacing_east_m),
        )
    ]
    if max(wide) > 1:
        from scipy.ndimage import maximum_filter  # noqa: PLC0415  (slow to load, seldom needed)

        highest = maximum_filter(np.nan_to_num(above_m, nan=-np.inf), wide)
        above_m = np.where(np.isinf(highest), np.nan, highest)
    rise = replace(paths, heights_m=above_m)
    heights_m = np.empty_like(terrain.heights_m)
    for rows in strips(heights_m):
        easting, northing = _samples(terrain, rows, paths)
        over_m = rise.height_at(easting_m=easting, northing_m=northing)
        over_m = np.where(np.isnan(over_m), UNKNOWN_M, np.maximum(over_m, 0.0))
        heights_m[rows] = terrain.heights_m[rows] + over_m
    heights_m.setflags(write=False)
    return replace(terrain, heights_m=heights_m, provenance=paths.provenance)


def _above_ground_m(model: HeightField, terrain: HeightField) -> Float64Array:
    """Return the heights of a model's samples above the ground, NaN where not known."""
    above_m = np.empty(model.heights_m.shape)
    west, south, east, north = terrain.bounds_m
    reach_m = max(model.spacing_east_m, model.spacing_north_m)
    for rows in strips(model.heights_m):
        easting, northing = _samples(model, rows, terrain)
        # Samples just outside are needed for the heights between them and the border.
        for at, least, most in ((easting, west, east), (northing, south, north)):
            beside = np.clip(at, least, most)
            np.copyto(at, beside, where=np.abs(at - beside) <= reach_m)
        above_m[rows] = model.heights_m[rows] - terrain.height_at(
            easting_m=easting, northing_m=northing
        )
    known = np.isfinite(above_m)
    name = ", ".join(model.provenance.files) or "the surface"
    if not known.any():
        raise InputError(
            f"{name} has no height over the DEM; give a surface model of the same area"
        )
    offset_m = float(np.median(above_m[known]))
    if offset_m < _OFFSET_M[0] and model.height_range_m[1] <= _CANOPY_MOST_M:
        return np.where(known, model.heights_m, np.nan)
    if not _OFFSET_M[0] <= offset_m <= _OFFSET_M[1]:
        raise InputError(
            f"{name} is {offset_m:+.0f} m above the DEM in the median; expected {_OFFSET_M[0]:+g} "
            f"to {_OFFSET_M[1]:+g}: give a surface model of the DEM's vertical datum, or a canopy "
            "model in metres above ground"
        )
    return above_m


def _samples(field: HeightField, rows: slice, other: HeightField) -> tuple[Float64Array, ...]:
    """Return easting and northing of the samples of some rows, in the frame of another field."""
    row = np.arange(field.rows)[rows, np.newaxis]
    place = field.to_map(*np.broadcast_arrays(row, np.arange(field.cols)))
    if field.frame == other.frame:
        return place
    return other.frame.from_lonlat(*field.frame.to_lonlat(*place))

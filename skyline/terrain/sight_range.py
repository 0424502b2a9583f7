"""How far an eye sees, and how many samples lie beyond."""

import numpy as np

from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints


def sight_range_m(field: HeightField, eye_elevation_m: float, drop_per_m2: float) -> float:
    """Return the distance beyond which nothing rises over the dip horizon.

    A line of sight from e above the lowest ground grazes that ground at sqrt(e / drop). It meets
    the highest sample, H above the lowest ground, sqrt(H / drop) farther on.
    """
    lowest, highest = field.height_range_m
    above_m = max(eye_elevation_m - lowest, 0.0)
    return float((np.sqrt(above_m) + np.sqrt(highest - lowest)) / np.sqrt(drop_per_m2))


def share_beyond(field: HeightField, eye: Viewpoints, distance_m: float) -> float:
    """Return the share of the samples that lie farther from one eye."""
    row, col = field.to_grid(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    south = (np.arange(field.rows) - row) * field.spacing_north_m
    east = (np.arange(field.cols) - col) * field.spacing_east_m
    half_chord = np.sqrt(np.maximum(distance_m**2 - south**2, 0.0))
    within = np.searchsorted(east, half_chord, "right") - np.searchsorted(east, -half_chord)
    within[np.abs(south) > distance_m] = 0
    return float(1.0 - within.sum() / (field.rows * field.cols))

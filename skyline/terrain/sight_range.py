"""How far an eye sees, and how many samples lie beyond."""

import numpy as np

from skyline.geodesy.earth import Curvature
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints


def sight_range_m(field: HeightField, eye_elevation_m: float, curvature: Curvature) -> float:
    """Return the distance beyond which nothing rises over the dip horizon.

    A line of sight grazes the lowest ground at its horizon. As far behind it, where the lowest
    ground has its horizon for the highest sample, the line meets that sample.
    """
    lowest, highest = field.height_range_m
    return float(
        curvature.horizon_m(eye_elevation_m - lowest) + curvature.horizon_m(highest - lowest)
    )


def share_beyond(field: HeightField, eye: Viewpoints, distance_m: float) -> float:
    """Return the share of the samples that lie farther from one eye."""
    row, col = field.to_grid(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    south = (np.arange(field.rows) - row) * field.spacing_north_m
    east = (np.arange(field.cols) - col) * field.spacing_east_m
    half_chord = np.sqrt(np.maximum(distance_m**2 - south**2, 0.0))
    within = np.searchsorted(east, half_chord, "right") - np.searchsorted(east, -half_chord)
    within[np.abs(south) > distance_m] = 0
    return float(1.0 - within.sum() / (field.rows * field.cols))

"""What a scene needs: bounds, in px, on what leaving a part of the model out can cost.

A tolerance is met where the parts left out cost less than it. Each bound here holds for every
column of every heading.
"""

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import pixel_size
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

BLOCK_CELLS = 16
COARSER_STEPS = (2, 4, 8)
"""Of samples, for fields of more than a block."""


def curvature_bound_px(reach_m: float, drop_per_m2: float, width: int) -> float:
    """Return what leaving curvature out can cost at most, in px of ``width`` columns.

    ``reach_m`` is the distance of the farthest sample.
    """
    # v changes by drop d^2 / z, and d is at most the root of 2 times z.
    return float(np.sqrt(2.0)) * drop_per_m2 * reach_m / pixel_size(width)


def sight_range_m(field: HeightField, eye_elevation_m: float, drop_per_m2: float) -> float:
    """Return the distance beyond which nothing rises over the dip horizon; inf on a flat Earth.

    From e above the lowest ground the line of sight that grazes it touches at sqrt(e / drop) and
    meets the highest sample, H above, at sqrt(H / drop) farther on.
    """
    if drop_per_m2 == 0.0:
        return float(np.inf)
    lowest, highest = field.height_range_m
    above_m = max(eye_elevation_m - lowest, 0.0)
    return float((np.sqrt(above_m) + np.sqrt(highest - lowest)) / np.sqrt(drop_per_m2))


def coarser_deviation_m(field: HeightField, step: int) -> Float64Array:
    """Return how far the surface of every ``step``-th sample (2, 4, 8 or 16) is from the samples.

    That is the greatest deviation in each whole block of `BLOCK_CELLS` cells (block rows, block
    columns), metres; 0 where holes leave nothing to compare.
    """
    rows, cols = ((count - 1) // BLOCK_CELLS * BLOCK_CELLS for count in (field.rows, field.cols))
    heights = field.heights_m[: rows + 1, : cols + 1].astype(np.float64)
    north_west, north_east = heights[:-1:step, :-1:step], heights[:-1:step, step::step]
    south_west, south_east = heights[step::step, :-1:step], heights[step::step, step::step]
    worst = np.zeros_like(north_west)
    for row in range(step):
        for col in range(step):
            down, right = row / step, col / step
            coarse = (
                (1.0 - max(down, right)) * north_west
                + abs(right - down) * (north_east if right >= down else south_west)
                + min(down, right) * south_east
            )
            worst = np.fmax(worst, np.abs(heights[row:rows:step, col:cols:step] - coarse))
    side = BLOCK_CELLS // step
    blocks = worst.reshape(rows // BLOCK_CELLS, side, cols // BLOCK_CELLS, side)
    return np.asarray(blocks.max(axis=(1, 3)), dtype=np.float64)


def coarser_step(
    field: HeightField, eye: Viewpoints, step: int, tolerance: float
) -> tuple[float, float]:
    """Return what the surface of every ``step``-th sample would do to the skyline of one eye.

    Every block is judged by its deviation at the least depth it can be seen at.

    Parameters
    ----------
    tolerance : float
        Of the image-plane ordinate: px times the size of one.

    Returns
    -------
    deviation_m : float
        How far it is from the full surface at most in a block, the median of the blocks.
    share : float
        Of the blocks, those that could be drawn with it within the tolerance.
    """
    deviation_m = coarser_deviation_m(field, step)
    row, col = field.to_grid(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    gaps = [
        np.maximum(np.maximum(first - place, place - first - BLOCK_CELLS), 0.0) * spacing
        for first, place, spacing in (
            (np.arange(deviation_m.shape[0]) * BLOCK_CELLS, row, field.spacing_north_m),
            (np.arange(deviation_m.shape[1]) * BLOCK_CELLS, col, field.spacing_east_m),
        )
    ]
    depth_m = np.hypot(gaps[0][:, np.newaxis], gaps[1]) / np.sqrt(2.0)
    fine = deviation_m <= tolerance * depth_m
    return float(np.median(deviation_m)), float(fine.mean())


def share_beyond(field: HeightField, eye: Viewpoints, distance_m: float) -> float:
    """Return the share of the samples that lie farther from one eye."""
    row, col = field.to_grid(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    south = (np.arange(field.rows) - row) * field.spacing_north_m
    east = (np.arange(field.cols) - col) * field.spacing_east_m
    half_chord = np.sqrt(np.maximum(distance_m**2 - south**2, 0.0))
    within = np.searchsorted(east, half_chord, "right") - np.searchsorted(east, -half_chord)
    within[np.abs(south) > distance_m] = 0
    return float(1.0 - within.sum() / (field.rows * field.cols))

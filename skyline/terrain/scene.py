"""What a scene needs: bounds, in px, on what leaving a part of the model out can cost.

A tolerance is met where the parts left out cost less than it. Each bound here holds for every
column of every heading.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import pixel_size
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

BLOCK_CELLS = 16
COARSER_STEPS = (2, 4, 8)


@dataclass(frozen=True, slots=True)
class SceneNeeds:
    """What a viewpoint's skyline needs of the model."""

    data_reach_m: float
    """Distance of the farthest sample."""
    curvature_px: float
    """What leaving curvature out can cost at most."""
    sight_m: float
    """Distance beyond which not even the highest sample rises over the dip horizon."""
    beyond_sight: float
    """Share of the samples that lie farther."""
    steps: dict[int, tuple[float, float]]
    """Of the surface of every n-th sample, by n: how far it is from the full surface at most in a
    block of `BLOCK_CELLS` cells, metres, the median; and the share of blocks that could be drawn
    with it within the tolerance."""


def scene_needs(
    field: HeightField,
    eye: Viewpoints,
    width: int,
    tolerance_px: float,
    curvature: Curvature | None = None,
) -> SceneNeeds:
    """Return what the skyline of one viewpoint needs.

    Raises `InputError` for any number of viewpoints but one.

    Parameters
    ----------
    eye : Viewpoints
        One viewpoint.
    width : int
        Columns W, which px are of.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.
    """
    if len(eye) != 1:
        raise InputError(f"{len(eye)} viewpoints given; expected one")
    curvature = curvature or Curvature()
    drop_per_m2 = curvature.drop_per_m2
    reach_m = field.reach_m(float(eye.easting_m[0]), float(eye.northing_m[0]))
    sight_m = sight_range_m(field, float(eye.eye_elevation_m[0]), drop_per_m2)
    tolerance = tolerance_px * pixel_size(width)
    steps = COARSER_STEPS if min(field.rows, field.cols) > BLOCK_CELLS else ()
    return SceneNeeds(
        data_reach_m=reach_m,
        # v changes by drop d^2 / z, and d is at most the root of 2 times z.
        curvature_px=float(np.sqrt(2.0)) * drop_per_m2 * reach_m / pixel_size(width),
        sight_m=sight_m,
        beyond_sight=_share_beyond(field, eye, sight_m),
        steps={step: _coarser_step(field, eye, step, tolerance) for step in steps},
    )


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


def _coarser_step(
    field: HeightField, eye: Viewpoints, step: int, tolerance: float
) -> tuple[float, float]:
    """Judge every block by its deviation at the least depth it can be seen at."""
    deviation_m = coarser_deviation_m(field, step)
    row, col = field.to_grid(eye.easting_m[0], eye.northing_m[0])
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


def _share_beyond(field: HeightField, eye: Viewpoints, distance_m: float) -> float:
    row, col = field.to_grid(eye.easting_m[0], eye.northing_m[0])
    south = (np.arange(field.rows) - row) * field.spacing_north_m
    east = (np.arange(field.cols) - col) * field.spacing_east_m
    half_chord = np.sqrt(np.maximum(distance_m**2 - south**2, 0.0))
    within = np.searchsorted(east, half_chord, "right") - np.searchsorted(east, -half_chord)
    within[np.abs(south) > distance_m] = 0
    return float(1.0 - within.sum() / (field.rows * field.cols))

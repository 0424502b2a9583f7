"""A height field in blocks of samples, of which only those that somebody looks at are made.

An eye sees little of a wide DEM: what lies behind a ridge need not be warped. Which blocks an eye
may see is known from where they are and from a height that nothing in them exceeds.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.geodesy import Frame
from skyline.terrain.heightfield import HeightField
from skyline.terrain.tiles import Grid

BLOCK = 64
"""Cells of a block's side."""


@dataclass(frozen=True, slots=True, eq=False)
class TerrainBlocks:
    """R x C blocks of a height field; neighbours share the samples of their edge."""

    frame: Frame
    grid: Grid
    """Of the samples, in metres of the frame."""
    highest_m: Float32Array
    """(R, C) float32. No height of a block is above it; -inf where there is none."""
    field: Callable[[BoolArray], HeightField]
    """From which blocks are wanted (R, C) to a field of these; others may be missing or NaN."""

    @classmethod
    def of(cls, field: HeightField) -> Self:
        """Return the blocks of a field that is made already."""
        highest = np.asarray(field.heights_m, np.float32)
        for axis in (0, 1):
            edges = block_edges(highest.shape[axis])
            shared = np.take(highest, edges[1:], axis)
            highest = np.fmax(np.fmax.reduceat(highest, edges[:-1], axis), shared)
        highest = np.nan_to_num(highest, nan=-np.inf)
        steps_m = field.spacing_east_m, field.spacing_north_m
        grid = Grid(field.west_m, field.north_m, *steps_m, field.rows, field.cols)
        return cls(field.frame, grid, highest, lambda _: field)

    def around_m(self, easting_m: float, northing_m: float) -> tuple[Float64Array, ...]:
        """Return how far east and north of a place the middles of the blocks are, (R, C) each."""
        rows, cols = (np.arange(count) + 0.5 for count in self.highest_m.shape)
        east_m = self.grid.west + cols * BLOCK * self.grid.step_east - easting_m
        north_m = self.grid.north - rows * BLOCK * self.grid.step_north - northing_m
        return tuple(np.meshgrid(east_m, north_m))

    @property
    def spacing_m(self) -> float:
        """The finer of the two sample spacings."""
        return min(self.grid.step_east, self.grid.step_north)

    @property
    def radius_m(self) -> float:
        """How far a block's corners are from its middle."""
        return 0.5 * BLOCK * float(np.hypot(self.grid.step_east, self.grid.step_north))


def block_edges(samples: int) -> Int64Array:
    """Return the first sample of each block along an axis, and the last sample of the last."""
    return np.append(np.arange(0, max(samples - 1, 1), BLOCK), samples - 1)

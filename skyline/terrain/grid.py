"""North-up grids of samples, and strips of their rows.

Large grids are worked on strip by strip.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS

from skyline.arrays import Float64Array

MAX_SAMPLES = 1 << 31
"""The largest grid: 8 GiB of float32."""

STRIP_SAMPLES = 1 << 22
"""Samples of a strip of rows: few enough that a copy of a strip costs next to no memory."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A north-up grid; coordinates are of its samples, in CRS units."""

    west: float
    north: float
    step_east: float
    step_north: float
    rows: int
    cols: int

    @property
    def east(self) -> float:
        """Abscissa of the easternmost samples."""
        return self.west + (self.cols - 1) * self.step_east

    @property
    def south(self) -> float:
        """Ordinate of the southernmost samples."""
        return self.north - (self.rows - 1) * self.step_north

    @property
    def centre(self) -> tuple[float, float]:
        """Abscissa and ordinate of the middle of the grid."""
        return 0.5 * (self.west + self.east), 0.5 * (self.north + self.south)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """West, south, east and north of the samples."""
        return self.west, self.south, self.east, self.north

    def at(self, row: ArrayLike, col: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return abscissas and ordinates of fractional rows and columns."""
        x = self.west + np.asarray(col, dtype=np.float64) * self.step_east
        y = self.north - np.asarray(row, dtype=np.float64) * self.step_north
        return x, y

    def index(self, x: ArrayLike, y: ArrayLike) -> tuple[Float64Array, Float64Array]:
        """Return fractional rows and columns; samples are at whole numbers."""
        row = (self.north - np.asarray(y, dtype=np.float64)) / self.step_north
        col = (np.asarray(x, dtype=np.float64) - self.west) / self.step_east
        return row, col

    def part(self, rows: slice, cols: slice) -> "Grid":
        """Return the grid of some of the rows and columns."""
        return replace(
            self,
            west=self.west + cols.start * self.step_east,
            north=self.north - rows.start * self.step_north,
            rows=rows.stop - rows.start,
            cols=cols.stop - cols.start,
        )


def full_turn(crs: CRS) -> float | None:
    """Return a full turn in a CRS's units; None unless geographic."""
    if not crs.is_geographic:
        return None
    return round(2.0 * math.pi / crs.axis_info[0].unit_conversion_factor, 9)


def row_strips(grid: Any, samples: int = STRIP_SAMPLES) -> Iterator[slice]:
    """Yield slices of rows that cover an array or open dataset.

    A slice holds about ``samples`` samples, and at least one row.
    """
    rows, cols = grid.shape
    step = max(samples // cols, 1)
    for top in range(0, rows, step):
        yield slice(top, min(top + step, rows))

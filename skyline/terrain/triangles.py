"""Which triangles make up the surface, and its rims: the edges where it ends."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Int64Array


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Which triangles belong to the surface, padded by one cell that does not."""

    north_east: BoolArray
    south_west: BoolArray
    """``north_east``, ``south_west``: (rows + 1, cols + 1) bool. Cell (row, col) has its north-west
    sample at [row, col] of the heights and its two triangles at [row + 1, col + 1] here; the
    padding answers for cells off the map."""

    @classmethod
    def of(cls, heights_m: NDArray[np.floating]) -> "Triangles":
        """Find the triangles whose three samples are all there."""
        present = ~np.isnan(heights_m)
        diagonal = present[:-1, :-1] & present[1:, 1:]
        return cls(np.pad(diagonal & present[:-1, 1:], 1), np.pad(diagonal & present[1:, :-1], 1))

    @property
    def samples(self) -> BoolArray:
        """Which samples are a corner of some triangle, shape (rows, cols)."""
        north_east, south_west = self.north_east, self.south_west
        both = north_east | south_west
        return np.asarray(
            both[:-1, :-1] | both[1:, 1:] | north_east[1:, :-1] | south_west[:-1, 1:], dtype=bool
        )

    def entries(self, north: bool, east: bool) -> BoolArray:
        """Return the samples of edges by which a ray may come upon the surface, (rows, cols).

        ``north`` and ``east`` say that the ray goes there rather than south and west.
        """
        north_east, south_west = self.north_east, self.south_west
        # By edges along rows, along columns, and diagonals: the triangles to either side.
        south_of_row, north_of_row = north_east[1:, 1:-1], south_west[:-1, 1:-1]
        east_of_col, west_of_col = south_west[1:-1, 1:], north_east[1:-1, :-1]
        upper, lower = north_east[1:-1, 1:-1], south_west[1:-1, 1:-1]
        row = north_of_row & ~south_of_row if north else south_of_row & ~north_of_row
        col = east_of_col & ~west_of_col if east else west_of_col & ~east_of_col
        # Going north-west or south-east, either way across a diagonal is possible.
        diagonal = np.zeros_like(upper)
        if north or east:
            diagonal |= upper & ~lower
        if not (north and east):
            diagonal |= lower & ~upper
        marks = np.zeros((row.shape[0], col.shape[1]), dtype=bool)
        for edges, (row_step, col_step) in ((row, (0, 1)), (col, (1, 0)), (diagonal, (1, 1))):
            marks[: edges.shape[0], : edges.shape[1]] |= edges
            marks[row_step : edges.shape[0] + row_step, col_step : edges.shape[1] + col_step] |= (
                edges
            )
        return marks

    @property
    def has_dangling_edges(self) -> bool:
        """Whether two samples of triangles are neighbours along an edge without a triangle."""
        north_east, south_west, there = self.north_east, self.south_west, self.samples
        along_row = there[:, :-1] & there[:, 1:] & ~(north_east[1:, 1:-1] | south_west[:-1, 1:-1])
        along_col = there[:-1] & there[1:] & ~(south_west[1:-1, 1:] | north_east[1:-1, :-1])
        across = (there[:-1, :-1] & there[1:, 1:]) & ~(
            north_east[1:-1, 1:-1] | south_west[1:-1, 1:-1]
        )
        return bool(along_row.any() or along_col.any() or across.any())


@dataclass(frozen=True, slots=True, eq=False)
class Rims:
    """E rim edges: those that belong to one triangle only.

    They are the border of the map, of an irregular outline and of holes. From its first sample
    to its second, an edge has the surface on its right (seen from above, north up) and nothing
    on its left.
    """

    row: Int64Array
    col: Int64Array
    """``row``, ``col``: (E, 2) int64. The first and the second sample of each edge."""

    @classmethod
    def of(cls, triangles: Triangles) -> "Rims":
        """Find the rims of a surface."""
        north_east, south_west = triangles.north_east, triangles.south_west
        south_of_row, north_of_row = north_east[1:, 1:-1], south_west[:-1, 1:-1]
        east_of_col, west_of_col = south_west[1:-1, 1:], north_east[1:-1, :-1]
        east_of_diagonal, west_of_diagonal = north_east[1:-1, 1:-1], south_west[1:-1, 1:-1]
        steps = [
            (south_of_row & ~north_of_row, (0, 1), False),
            (north_of_row & ~south_of_row, (0, 1), True),
            (west_of_col & ~east_of_col, (1, 0), False),
            (east_of_col & ~west_of_col, (1, 0), True),
            (west_of_diagonal & ~east_of_diagonal, (1, 1), False),
            (east_of_diagonal & ~west_of_diagonal, (1, 1), True),
        ]
        rows, cols = [], []
        for present, (row_step, col_step), backwards in steps:
            row, col = np.nonzero(present)
            way = slice(None, None, -1) if backwards else slice(None)
            rows.append(np.stack([row, row + row_step], axis=1)[:, way])
            cols.append(np.stack([col, col + col_step], axis=1)[:, way])
        return cls(np.concatenate(rows), np.concatenate(cols))

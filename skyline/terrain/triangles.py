"""The triangles of a height field's surface, and their edges.

Rays may enter the surface at edges with a triangle on only one side.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Masks of the surface's triangles, padded by one empty cell.

    Cell (row, col) has its north-west sample at [row, col] of the heights and its two triangles at
    [row + 1, col + 1] here; the padding stands for cells off the map.
    """

    north_east: BoolArray
    """(rows + 1, cols + 1) bool. Whether the north-eastern triangle of each cell belongs to it."""
    south_west: BoolArray
    """(rows + 1, cols + 1) bool. Whether the south-western triangle of each cell belongs to it."""

    @classmethod
    def of(cls, heights_m: FloatArray) -> "Triangles":
        """Find the triangles whose three samples are all known."""
        present = ~np.isnan(heights_m)
        diagonal = present[:-1, :-1] & present[1:, 1:]
        return cls(np.pad(diagonal & present[:-1, 1:], 1), np.pad(diagonal & present[1:, :-1], 1))

    @property
    def samples(self) -> BoolArray:
        """Mask (rows, cols) of the samples that are triangle corners."""
        north_east, south_west = self.north_east, self.south_west
        both = north_east | south_west
        return np.asarray(
            both[:-1, :-1] | both[1:, 1:] | north_east[1:, :-1] | south_west[:-1, 1:], dtype=bool
        )

    @property
    def _edges(self) -> tuple[tuple[tuple[int, int], BoolArray, BoolArray], ...]:
        """The edges along rows, along columns and across cells.

        Each kind has three parts: the step in rows and columns from an edge's first sample to its
        second, and masks of the edges with a triangle on their right, and on their left (seen from
        above, north up).
        """
        north_east, south_west = self.north_east, self.south_west
        return (
            ((0, 1), north_east[1:, 1:-1], south_west[:-1, 1:-1]),
            ((1, 0), north_east[1:-1, :-1], south_west[1:-1, 1:]),
            ((1, 1), south_west[1:-1, 1:-1], north_east[1:-1, 1:-1]),
        )

    def entries(self, north: bool, east: bool) -> BoolArray:
        """Return the ends of edges where a ray may enter the surface.

        The result is a mask (rows, cols). The ray goes ``north`` rather than south, and ``east``
        rather than west.
        """
        rows, cols = self.north_east.shape
        marks = np.zeros((rows - 1, cols - 1), dtype=bool)
        # Going north-west or south-east, either way across a diagonal is possible.
        to_left = north, east, north or east
        to_right = not north, not east, not (north and east)
        for (step, right, left), leftward, rightward in zip(
            self._edges, to_left, to_right, strict=True
        ):
            edges = left ^ right
            if not (leftward and rightward):
                edges &= left if leftward else right
            for row, col in ((0, 0), step):
                marks[row : row + edges.shape[0], col : col + edges.shape[1]] |= edges
        return marks

    @property
    def has_dangling_edges(self) -> bool:
        """Whether samples of triangles are neighbours along an edge without a triangle."""
        is_corner = self.samples
        return any(
            bool(
                (
                    is_corner[: len(left), : left.shape[1]]
                    & is_corner[row:, col:]
                    & ~(left | right)
                ).any()
            )
            for (row, col), right, left in self._edges
        )

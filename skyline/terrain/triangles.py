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

    @property
    def _edges(self) -> tuple[tuple[tuple[int, int], BoolArray, BoolArray], ...]:
        """All edges along rows, along columns and across cells.

        Of each kind: the step in rows and columns from an edge's first sample to its second, and
        which edges have a triangle on their right and on their left (seen from above, north up).
        """
        north_east, south_west = self.north_east, self.south_west
        return (
            ((0, 1), north_east[1:, 1:-1], south_west[:-1, 1:-1]),
            ((1, 0), north_east[1:-1, :-1], south_west[1:-1, 1:]),
            ((1, 1), south_west[1:-1, 1:-1], north_east[1:-1, 1:-1]),
        )

    def entries(self, north: bool, east: bool) -> BoolArray:
        """Return the samples of edges by which a ray may come upon the surface, (rows, cols).

        ``north`` and ``east`` say that the ray goes there rather than south and west.
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
        """Whether two samples of triangles are neighbours along an edge without a triangle."""
        there = self.samples
        return any(
            bool((there[: len(left), : left.shape[1]] & there[row:, col:] & ~(left | right)).any())
            for (row, col), right, left in self._edges
        )

    def rims(self) -> tuple[Int64Array, Int64Array]:
        """Return rows and columns (E, 2) of the first and second sample of E rim edges.

        Those belong to one triangle only: they are the border of the map, of an irregular outline
        and of holes. From its first sample to its second, an edge has the surface on its right
        (seen from above, north up) and nothing on its left.
        """
        rows, cols = [], []
        for (row_step, col_step), right, left in self._edges:
            for rim, way in ((right & ~left, 1), (left & ~right, -1)):
                row, col = np.nonzero(rim)
                rows.append(np.stack([row, row + row_step], axis=1)[:, ::way])
                cols.append(np.stack([col, col + col_step], axis=1)[:, ::way])
        return np.concatenate(rows), np.concatenate(cols)

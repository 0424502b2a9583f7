"""Square cells on the map, of an orthophoto or a posterior."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float64Array


@dataclass(frozen=True, slots=True)
class CellGrid:
    """Square cells on the map, from their north-western corner in a frame.

    Rows count from north to south, columns from west to east.
    """

    west_m: float
    north_m: float
    cell_m: float
    rows: int
    cols: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rows, self.cols

    def eastings_m(self) -> Float64Array:
        """Return the eastings (cols,) of the cells' middles."""
        return np.asarray(self.west_m + (np.arange(self.cols) + 0.5) * self.cell_m)

    def northings_m(self) -> Float64Array:
        """Return the northings (rows,) of the cells' middles."""
        return np.asarray(self.north_m - (np.arange(self.rows) + 0.5) * self.cell_m)

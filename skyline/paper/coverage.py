"""Sections 4 and 5.1: candidate locations, and the tolerance areas that cover them.

A planning problem is one heading. Candidates lie on a grid of rows (north to south) and columns
(west to east); a candidate's index is ``row * cols + col``. The tolerance area of a view is a
boolean window of K x K candidates around it, K = 2 * reach + 1, rows southward and columns eastward
whatever the heading.
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skyline.arrays import BoolArray, Float64Array, Int64Array
from skyline.errors import InputError


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Locations of a grid at which viewpoints may be placed.

    Raises `InputError` where no candidate is valid.
    """

    valid: BoolArray
    """(rows, cols) bool. False where no eye can stand: holes, the map's border."""
    easting_m: Float64Array
    """(cols,) float64."""
    northing_m: Float64Array
    """(rows,) float64. Descending."""
    reach: int
    """Greatest extent of a tolerance area from its view, in candidates; at least 1."""

    def __post_init__(self) -> None:
        if not self.valid.any():
            raise InputError(
                f"none of the {self.valid.size} candidate locations can be stood on: the area lies "
                "wholly in holes or off the map; choose another area"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.valid.shape
        return rows, cols

    @property
    def window(self) -> int:
        """K, the side of a tolerance area's window in candidates."""
        return 2 * self.reach + 1

    def row_col(self, candidates: Int64Array) -> tuple[Int64Array, Int64Array]:
        """Return the rows and columns of candidate indices."""
        return candidates // self.valid.shape[1], candidates % self.valid.shape[1]

    def nearest(
        self, candidates: Int64Array, others: Int64Array, number: int
    ) -> tuple[Int64Array, Float64Array]:
        """Return the nearest of others (M) to candidates (N), as indices, and their distances.

        Both are (N, min(number, M)), nearest first; distances are in candidates.
        """
        row, col = self.row_col(candidates)
        other_row, other_col = self.row_col(others)
        apart = np.hypot(row[:, None] - other_row, col[:, None] - other_col)
        chosen = np.argsort(apart, axis=1, kind="stable")[:, :number]
        return chosen, np.take_along_axis(apart, chosen, axis=1)


class Coverage:
    """The union of the tolerance areas of rendered views, which all look along one heading.

    Attributes
    ----------
    candidates : Candidates
    viewpoints : (N,) int64
        Candidates rendered so far, in the order they were added.
    areas : (N, K, K) bool
        Their tolerance areas, clipped to valid candidates.
    uncovered : (rows, cols) bool
        Valid candidates in no tolerance area.
    counts : (rows, cols) int32
        Number of tolerance areas that hold each candidate.
    """

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        reach, size = candidates.reach, (candidates.window, candidates.window)
        # Windows look into padded arrays, so that the grid's border is no special case.
        valid = np.pad(candidates.valid, reach)
        count, uncovered = np.zeros(valid.shape, dtype=np.int32), valid.copy()
        self.uncovered, self.counts = (a[reach:-reach, reach:-reach] for a in (uncovered, count))
        self._valid_windows = sliding_window_view(valid, size)
        self._open_windows = sliding_window_view(uncovered, size, writeable=True)
        self._count_windows = sliding_window_view(count, size, writeable=True)
        self.viewpoints = np.zeros(0, dtype=np.int64)
        self.areas = np.zeros((0, *size), dtype=bool)

    def add(self, viewpoints: Int64Array, areas: BoolArray) -> None:
        """Add the tolerance areas (N, K, K) of views rendered at candidates (N)."""
        row, col = self.candidates.row_col(viewpoints)
        areas = areas & self._valid_windows[row, col]
        for at, area in zip(zip(row, col, strict=True), areas, strict=True):
            self._count_windows[at] += area
            self._open_windows[at] &= ~area
        self.viewpoints = np.concatenate([self.viewpoints, viewpoints])
        self.areas = np.concatenate([self.areas, areas])

    def gains(self, candidates: Int64Array, areas: BoolArray) -> Int64Array:
        """Return how many uncovered candidates areas (N, K, K) at candidates (N) would cover."""
        gained = self._open_windows[self.candidates.row_col(candidates)] & areas
        return np.asarray(np.count_nonzero(gained, axis=(1, 2)), dtype=np.int64)

    def fraction(self, region: BoolArray | None = None) -> float:
        """Return the covered share of the valid candidates (in a region)."""
        valid = self.candidates.valid if region is None else self.candidates.valid & region
        left, whole = int((self.uncovered & valid).sum()), int(valid.sum())
        return 1.0 - left / max(whole, 1)

    @property
    def overlap(self) -> int:
        """The paper's criterion (B): inclusions in tolerance areas less covered candidates."""
        return int(self.counts.sum()) - int(np.count_nonzero(self.counts))

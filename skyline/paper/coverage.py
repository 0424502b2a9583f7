"""What a planning problem is made of: candidates on a dense grid, and how well they are covered.

One problem is one heading. Candidates lie on a grid of rows (north to south) and columns (west to
east); a candidate's index is ``row * cols + col``. The tolerance area of a view is a boolean
window of K x K candidates around it, K = 2 * reach + 1, rows southward and columns eastward
whatever the heading. Strategies see candidates, windows and nothing else: no terrain, no views.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError

_Scalar = TypeVar("_Scalar", bound=np.generic)

_INTERPOLATED_FROM = 4
"""Views, the nearest ones."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateGrid:
    """Where viewpoints may be placed.

    Raises `InputError` where no candidate is valid.
    """

    valid: BoolArray
    """(rows, cols) bool. False where no eye can stand: holes, the map's border."""
    reach: int
    """How far a tolerance area may extend, in candidates; at least 1."""

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

    def windows(self, padded: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Return the windows (rows, cols, K, K) of all candidates; they can be written to.

        ``padded`` has `reach` more rows and columns than the grid to every side.
        """
        return sliding_window_view(padded, (self.window, self.window), writeable=True)

    def inner(self, padded: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Return an array without its padding, (rows, cols)."""
        return padded[self.reach : -self.reach, self.reach : -self.reach]

    def nearest(
        self, candidates: Int64Array, others: Int64Array, number: int
    ) -> tuple[Int64Array, Float64Array]:
        """Return places in others (M) of those nearest to candidates (N), and their distances.

        Both are (N, min(number, M)), nearest first.
        """
        row, col = self.row_col(candidates)
        other_row, other_col = self.row_col(others)
        apart = np.hypot(row[:, None] - other_row, col[:, None] - other_col)
        chosen = np.argsort(apart, axis=1, kind="stable")[:, :number]
        return chosen, np.take_along_axis(apart, chosen, axis=1)

    def interpolated(
        self, candidates: Int64Array, others: Int64Array, values: Float32Array | BoolArray
    ) -> Float32Array:
        """Return values (N, ...) at candidates from those of others (M, ...), the nearest of them.

        The weight of another falls with its distance.
        """
        chosen, apart = self.nearest(candidates, others, _INTERPOLATED_FROM)
        weight = 1.0 / np.maximum(apart, 0.5)
        weight = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
        total = np.zeros((len(candidates), *values.shape[1:]), dtype=np.float32)
        for place in range(chosen.shape[1]):
            total += values[chosen[:, place]] * weight[:, place, None, None]
        return total


class Coverage:
    """Which candidates are covered by the tolerance areas of rendered views.

    Attributes
    ----------
    viewpoints : (N,) int64
        Candidates rendered so far, in the order they were added.
    areas : (N, K, K) bool
        Their tolerance areas, clipped to valid candidates.
    uncovered : (rows, cols) bool
        Valid candidates in no tolerance area.
    counts : (rows, cols) int32
        In how many tolerance areas each candidate is.
    """

    def __init__(self, grid: CandidateGrid) -> None:
        self.grid = grid
        valid = np.pad(grid.valid, grid.reach)
        count, uncovered = np.zeros(valid.shape, dtype=np.int32), valid.copy()
        self.uncovered, self.counts = grid.inner(uncovered), grid.inner(count)
        self._valid_windows = grid.windows(valid)
        self._open_windows, self._count_windows = grid.windows(uncovered), grid.windows(count)
        self.viewpoints = np.zeros(0, dtype=np.int64)
        self.areas = np.zeros((0, grid.window, grid.window), dtype=bool)

    def add(self, candidates: Int64Array, areas: BoolArray) -> None:
        """Add the tolerance areas (N, K, K) of views rendered at candidates (N)."""
        row, col = self.grid.row_col(candidates)
        areas = areas & self._valid_windows[row, col]
        for at, area in zip(zip(row, col, strict=True), areas, strict=True):
            self._count_windows[at] += area
            self._open_windows[at] &= ~area
        self.viewpoints = np.concatenate([self.viewpoints, candidates])
        self.areas = np.concatenate([self.areas, areas])

    def gains(self, candidates: Int64Array, areas: BoolArray) -> Int64Array:
        """Return how many uncovered candidates areas (N, K, K) at candidates (N) would cover."""
        row, col = self.grid.row_col(candidates)
        gained = self._open_windows[row, col] & areas
        return np.asarray(np.count_nonzero(gained, axis=(1, 2)), dtype=np.int64)

    def fraction(self, region: BoolArray | None = None) -> float:
        """Return the covered share of the valid candidates (in a region)."""
        valid = self.grid.valid if region is None else self.grid.valid & region
        left, whole = int((self.uncovered & valid).sum()), int(valid.sum())
        return 1.0 - left / max(whole, 1)

    @property
    def overlap(self) -> int:
        """The paper's criterion (B): inclusions in tolerance areas less covered candidates."""
        return int(self.counts.sum()) - int(np.count_nonzero(self.counts))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What a strategy is given."""

    coverage: Coverage
    """Kept up to date by whoever drives the strategy; strategies of one heading may share it."""
    predict_errors: Callable[[Int64Array], Float32Array]
    """Returns predicted reprojection errors of views at candidates (N), shape (N, K, K), px.

    They come from the views rendered so far. ``inf`` where a location is outside whatever the
    threshold. The view's own cell is 0.
    """
    threshold_px: float
    """A location is in a tolerance area when its reprojection error is at most this."""
    target: float
    """The share of the region's valid candidates to cover, in (0, 1]."""
    region: BoolArray
    """(rows, cols) bool. The candidates this strategy is to cover and may choose."""

    @property
    def grid(self) -> CandidateGrid:
        """The candidates."""
        return self.coverage.grid

    @property
    def done(self) -> bool:
        """Whether the region is covered as far as was asked."""
        return self.coverage.fraction(self.region) >= self.target

    def open_candidates(self) -> Int64Array:
        """Return the uncovered candidates of the region, ascending."""
        return np.flatnonzero(self.coverage.uncovered & self.region)


Requests = Generator[Int64Array, Float32Array, None]
"""Yields candidates to render (n,), is sent the reprojection errors (n, K, K) of those views.

The problem's coverage holds the views' areas before the generator is resumed.
"""

Strategy = Callable[[Problem, np.random.Generator], Requests]

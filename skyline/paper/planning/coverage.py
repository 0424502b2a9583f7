"""What a planning problem is made of: candidates on a dense grid, and how well they are covered.

One problem is one heading. Candidates lie on a grid of rows (north to south) and columns (west to
east); a candidate's index is ``row * cols + col``. The tolerance area of a view is a boolean
window of K x K candidates around it, K = 2 * reach + 1, rows southward and columns eastward
whatever the heading. Strategies see candidates, windows and nothing else: no terrain, no views.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.errors import InputError

_INTERPOLATED_FROM = 4
"""Views, the nearest ones."""


@dataclass(frozen=True, slots=True, eq=False)
class CandidateGrid:
    """Where viewpoints may be placed.

    Raises `InputError` where no candidate is valid, or the reach is below 1.
    """

    valid: BoolArray
    """(rows, cols) bool. False where no eye can stand: holes, the map's border."""
    reach: int
    """How far a tolerance area may extend, in candidates."""

    def __post_init__(self) -> None:
        if self.valid.ndim != 2 or not self.valid.any():
            raise InputError(
                f"none of the {self.valid.size} candidate locations can be stood on: the area lies "
                "wholly in holes or off the map; choose another area"
            )
        if self.reach < 1:
            raise InputError(f"reach is {self.reach} candidates; expected at least 1")

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

    def apart(self, candidates: Int64Array, others: Int64Array) -> Float64Array:
        """Return distances (N, M) between candidates (N) and others (M), in candidates."""
        row, col = self.row_col(candidates)
        other_row, other_col = self.row_col(others)
        apart = np.hypot(row[:, None] - other_row, col[:, None] - other_col)
        return np.asarray(apart, dtype=np.float64)

    def nearest(
        self, candidates: Int64Array, others: Int64Array, number: int
    ) -> tuple[Int64Array, Float64Array]:
        """Return places in others (M) of those nearest to candidates (N), and their distances.

        Both are (N, min(number, M)), nearest first.
        """
        apart = self.apart(candidates, others)
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


class AreaModel(Protocol):
    """What is known of tolerance areas without rendering, from the views rendered so far."""

    def predict_errors(self, candidates: Int64Array) -> Float32Array:
        """Return predicted reprojection errors of views at candidates (N), shape (N, K, K), px.

        ``inf`` where a location is outside whatever the threshold. The view's own cell is 0.
        """
        ...


class Coverage:
    """Which candidates are covered by the tolerance areas of rendered views.

    Attributes
    ----------
    viewpoints : (N,) int64
        Candidates rendered so far, in the order they were added.
    areas : (N, K, K) bool
        Their tolerance areas.
    """

    def __init__(self, grid: CandidateGrid) -> None:
        self.grid = grid
        side = grid.reach
        self._valid = np.pad(grid.valid, side)
        self._count = np.zeros(self._valid.shape, dtype=np.int32)
        self._open = self._valid.copy()
        self._count_windows = np.lib.stride_tricks.sliding_window_view(
            self._count, (grid.window, grid.window), writeable=True
        )
        self._open_windows = np.lib.stride_tricks.sliding_window_view(
            self._open, (grid.window, grid.window), writeable=True
        )
        self._valid_windows = np.lib.stride_tricks.sliding_window_view(
            self._valid, (grid.window, grid.window)
        )
        self._views = 0
        self._viewpoints = np.zeros(16, dtype=np.int64)
        self._areas = np.zeros((16, grid.window, grid.window), dtype=bool)

    @property
    def viewpoints(self) -> Int64Array:
        """Candidates rendered so far."""
        return self._viewpoints[: self._views]

    @property
    def areas(self) -> BoolArray:
        """Tolerance areas of the viewpoints, of shape (N, K, K), clipped to valid candidates."""
        return self._areas[: self._views]

    @property
    def uncovered(self) -> BoolArray:
        """Valid candidates in no tolerance area, (rows, cols)."""
        side = self.grid.reach
        return self._open[side:-side, side:-side]

    @property
    def counts(self) -> NDArray[np.int32]:
        """In how many tolerance areas each candidate is, (rows, cols)."""
        side = self.grid.reach
        return self._count[side:-side, side:-side]

    def add(self, candidates: Int64Array, areas: BoolArray) -> None:
        """Add the tolerance areas (N, K, K) of views rendered at candidates (N)."""
        self._make_room(len(candidates))
        for row, col, area in zip(*self.grid.row_col(candidates), areas, strict=True):
            inside = area & self._valid_windows[row, col]
            self._count_windows[row, col] += inside
            self._open_windows[row, col] &= ~inside
            self._areas[self._views] = inside
            self._viewpoints[self._views] = row * self.grid.shape[1] + col
            self._views += 1

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
        counts = self.counts
        return int(counts.sum()) - int(np.count_nonzero(counts))

    def _make_room(self, more: int) -> None:
        room = len(self._viewpoints)
        if self._views + more > room:
            grown = max(2 * room, self._views + more) - room
            self._viewpoints = np.concatenate([self._viewpoints, np.zeros(grown, np.int64)])
            self._areas = np.concatenate(
                [self._areas, np.zeros((grown, *self._areas.shape[1:]), dtype=bool)]
            )


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What a strategy is given.

    Raises `InputError` for a target outside (0, 1] or a threshold that is not positive.
    """

    coverage: Coverage
    """Kept up to date by whoever drives the strategy; strategies of one heading may share it."""
    model: AreaModel
    threshold_px: float
    """A location is in a tolerance area when its reprojection error is at most this."""
    target: float
    """The share of the region's valid candidates to cover, in (0, 1]."""
    region: BoolArray
    """(rows, cols) bool. The candidates this strategy is to cover and may choose."""

    def __post_init__(self) -> None:
        check_target(self.target)
        check_threshold(self.threshold_px)

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


def check_target(target: float) -> float:
    """Return a coverage that can be asked for, else raise `InputError`."""
    if not 0.0 < target <= 1.0:
        raise InputError(
            f"coverage is {target}; expected a share above 0 and at most 1, for example 0.98"
        )
    return target


def check_threshold(threshold_px: float) -> float:
    """Return a usable tolerance threshold, else raise `InputError`."""
    if not 0.0 < threshold_px < np.inf:
        raise InputError(
            f"threshold is {threshold_px} px; expected a positive number of pixels, for example 3"
        )
    return threshold_px

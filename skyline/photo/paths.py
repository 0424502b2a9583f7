"""Cheapest path from the left to the right edge of a cost image, one row per column."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, IntArray


@dataclass(frozen=True, slots=True)
class Steps:
    """What a step from one column to the next may do and what it costs."""

    reach_rows: int
    """Largest step that is priced by its slope."""
    price_per_row: float
    """Price of each row of such a step."""
    jump_price: float
    """Price of a step of any size: a cliff, a trunk, the edge of an occluder."""


def shortest_path(cost: Float32Array, steps: Steps) -> IntArray:
    """Return the row of the cheapest path in each column, (W,), for costs (H, W) float32."""
    from_left, arrived_from = _sweep(cost.T, steps)
    row = np.empty(len(from_left), dtype=np.intp)
    row[-1] = int(np.argmin(from_left[-1]))
    for column in range(len(row) - 1, 0, -1):
        row[column - 1] = arrived_from[column, row[column]]
    return row


def _sweep(columns: Float32Array, steps: Steps) -> tuple[Float32Array, NDArray[np.int32]]:
    """Return the cost of the cheapest path from the first column to each pixel, and its last step.

    Both are (W, H), indexed by column first.
    """
    n_columns, n_rows = columns.shape
    reach = steps.reach_rows
    offsets = np.arange(-reach, reach + 1)
    step_price = (steps.price_per_row * np.abs(offsets)).astype(np.float32)
    rows = np.arange(n_rows)
    best = np.empty_like(columns)
    arrived_from = np.zeros(columns.shape, dtype=np.int32)
    best[0] = columns[0]
    padded = np.full(n_rows + 2 * reach, np.inf, dtype=np.float32)
    reachable = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    for column in range(1, n_columns):
        padded[reach : reach + n_rows] = best[column - 1]
        candidates = reachable + step_price
        choice = np.argmin(candidates, axis=1)
        stepped = candidates[rows, choice]
        start = int(np.argmin(best[column - 1]))
        jumped = best[column - 1, start] + np.float32(steps.jump_price)
        best[column] = columns[column] + np.minimum(stepped, jumped)
        arrived_from[column] = np.where(stepped <= jumped, rows + offsets[choice], start)
    return best, arrived_from

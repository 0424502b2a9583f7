"""The cheapest path through an image's columns, from left to right."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float32Array, IntArray


@dataclass(frozen=True, slots=True)
class Steps:
    """The prices of a path's steps from one column to the next.

    Attributes
    ----------
    reach : int
        Rows by which a step may go up or down, each at `row_price`.
    row_price : float
        Price of each row of such a step.
    jump_price : float
        Price of a step of any size, as at a cliff, a trunk or the edge of an occluder.
    """

    reach: int
    row_price: float
    jump_price: float


def cheapest_path(cost: Float32Array, steps: Steps) -> IntArray:
    """Return the cheapest path's row (W,) in each column.

    Rows are intp; costs are (H, W) float32.
    """
    n_rows, n_columns = cost.shape
    offsets = np.arange(-steps.reach, steps.reach + 1)
    step_price = (steps.row_price * np.abs(offsets)).astype(np.float32)
    rows = np.arange(n_rows)
    best = cost[:, 0]
    arrived_from = np.zeros((n_columns, n_rows), dtype=np.int32)
    padded = np.full(n_rows + 2 * steps.reach, np.inf, dtype=np.float32)
    reachable = np.lib.stride_tricks.sliding_window_view(padded, 2 * steps.reach + 1)
    for column in range(1, n_columns):
        padded[steps.reach : steps.reach + n_rows] = best
        by_step = reachable + step_price
        choice = np.argmin(by_step, axis=1)
        stepped = by_step[rows, choice]
        start = int(np.argmin(best))
        jumped = best[start] + np.float32(steps.jump_price)
        best = cost[:, column] + np.minimum(stepped, jumped)
        arrived_from[column] = np.where(stepped <= jumped, rows + offsets[choice], start)
    row = np.empty(n_columns, dtype=np.intp)
    row[-1] = int(np.argmin(best))
    for column in range(n_columns - 1, 0, -1):
        row[column - 1] = arrived_from[column, row[column]]
    return row

"""Shape-Assisted Optimistic Viewpoint (SOV) of the paper's section 4.3."""

import numpy as np

from skyline.planning.coverage import BoolArray, Problem
from skyline.planning.strategies.base import Requests, best, draw, interpolated_areas
from skyline.planning.strategies.optimistic import DRAWN


def sov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Shape-Assisted Optimistic Viewpoint.

    Takes each tolerance area for an ellipse and packs candidates along its minor axis, where the
    next ellipse of its kind would touch it; selects among them as AROV does. Where no packed
    candidate is uncovered, candidates are drawn as in AROV.
    """
    coverage = problem.coverage
    packed = np.zeros(problem.grid.shape, dtype=bool)
    known = 0
    while not problem.done:
        _pack(problem, known, packed)
        known = len(coverage.viewpoints)
        candidates = np.flatnonzero(packed & coverage.uncovered & problem.region)
        if not candidates.size:
            candidates = draw(generator, problem.open_candidates(), DRAWN)
        yield best(coverage, candidates, interpolated_areas(coverage, candidates))


def _pack(problem: Problem, known: int, packed: BoolArray) -> None:
    """Mark the candidates that viewpoints after the first ``known`` put on their minor axes."""
    coverage = problem.coverage
    row, col = problem.grid.row_col(coverage.viewpoints[known:])
    axis = minor_axes(coverage.areas[known:])
    for sign in (-2.0, 2.0):
        to_row = np.rint(row + sign * axis[:, 0]).astype(np.int64)
        to_col = np.rint(col + sign * axis[:, 1]).astype(np.int64)
        rows, cols = packed.shape
        inside = (to_row >= 0) & (to_row < rows) & (to_col >= 0) & (to_col < cols)
        packed[to_row[inside], to_col[inside]] = True


def minor_axes(areas: BoolArray) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the minor semi-axes (N, 2) (rows, columns) of the ellipses with areas' moments.

    Moments are taken about the viewpoint, since that is what the ellipse is centred on. A filled
    ellipse has the variance b^2 / 4 along its semi-axis b; a cell adds its own 1 / 12.
    """
    reach = areas.shape[1] // 2
    step = np.arange(-reach, reach + 1, dtype=np.float64)
    size = np.maximum(areas.sum(axis=(1, 2)), 1)
    row_row = np.einsum("nij,i->n", areas, step**2) / size
    col_col = np.einsum("nij,j->n", areas, step**2) / size
    row_col = np.einsum("nij,i,j->n", areas, step, step) / size
    moments = np.stack([row_row, row_col, row_col, col_col], axis=1).reshape(-1, 2, 2)
    variance, direction = np.linalg.eigh(moments + np.eye(2) / 12.0)
    return np.asarray(direction[:, :, 0] * 2.0 * np.sqrt(variance[:, :1]), dtype=np.float64)

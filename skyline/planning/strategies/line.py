"""Line Planning Optimistic Viewpoint (LPOV) of the paper's section 4.3."""

import numpy as np

from skyline.planning.coverage import BoolArray, Problem
from skyline.planning.strategies.base import Requests, best, draw, interpolated_areas
from skyline.planning.strategies.optimistic import DRAWN

_RANKED = 64
"""How many pre-located candidates are ranked for each viewpoint selected."""


def lpov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Line Planning Optimistic Viewpoint.

    Pre-locates a viewpoint on each line joining a pair of rendered viewpoints; selects among
    those uncovered as AROV does. Where none is uncovered, candidates are drawn as in AROV.

    The viewpoint's distances from the two ends are in proportion to the linear sizes (square
    roots of the areas) of their tolerance areas. The paper words the weights as proportional to
    an end's size; taken as weights of the ends themselves they would draw viewpoints towards the
    large areas, against what the paper says they achieve: few viewpoints where areas are large.
    """
    coverage = problem.coverage
    located = np.zeros(problem.grid.shape, dtype=bool)
    known = 0
    while not problem.done:
        _locate(problem, known, located)
        known = len(coverage.viewpoints)
        candidates = np.flatnonzero(located & coverage.uncovered & problem.region)
        if candidates.size:
            candidates = draw(generator, candidates, _RANKED)
        else:
            candidates = draw(generator, problem.open_candidates(), DRAWN)
        yield best(coverage, candidates, interpolated_areas(coverage, candidates))


def _locate(problem: Problem, known: int, located: BoolArray) -> None:
    """Mark the candidates on the lines from viewpoints after the first ``known`` to all."""
    coverage = problem.coverage
    row, col = problem.grid.row_col(coverage.viewpoints)
    size = np.sqrt(np.count_nonzero(coverage.areas, axis=(1, 2)))
    weight = size / (size[known:, None] + size)
    to_row = weight * row[known:, None] + (1.0 - weight) * row
    to_col = weight * col[known:, None] + (1.0 - weight) * col
    located[np.rint(to_row).astype(np.int64), np.rint(to_col).astype(np.int64)] = True

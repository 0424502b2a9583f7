"""Optimistic viewpoints: ROV, AROV and HOV of the paper's section 4.3."""

import numpy as np

from skyline.planning.coverage import IntArray, Problem
from skyline.planning.strategies.base import Requests, best, draw, interpolated_areas

DRAWN = 10
"""How many candidate locations ROV and AROV draw for each viewpoint they select."""


def rov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Random Optimistic Viewpoint.

    Draws candidates from the uncovered area, computes their tolerance areas by projecting the
    known skyline points, and selects the one that overlaps most with the uncovered area.
    """
    while not problem.done:
        drawn = draw(generator, problem.open_candidates(), DRAWN)
        areas = problem.model.predict_errors(drawn) <= problem.threshold_px
        yield best(problem.coverage, drawn, areas)


def arov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Approximated Random Optimistic Viewpoint: ROV with areas interpolated, not computed."""
    while not problem.done:
        drawn = draw(generator, problem.open_candidates(), DRAWN)
        yield best(problem.coverage, drawn, interpolated_areas(problem.coverage, drawn))


def hov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Hierarchy Optimistic Viewpoint.

    Goes from coarse to fine over lattices of candidates, each half as wide as the one before. The
    candidates of a level are a fixed pattern: their areas are interpolated once, as the level
    begins, and AROV's choice among those uncovered follows until the level is covered.
    """
    spacing = 1 << (max(problem.grid.shape) // 2).bit_length() - 1
    while not problem.done:
        yield from _level(problem, spacing)
        spacing = max(1, spacing // 2)


def _level(problem: Problem, spacing: int) -> Requests:
    coverage = problem.coverage
    lattice = _lattice(problem, spacing)
    # At spacing 1 the region's own target says when to stop.
    allowed = int(len(lattice) * (1.0 - problem.target)) if spacing > 1 else 0
    left = lattice[coverage.uncovered.ravel()[lattice]]
    areas = interpolated_areas(coverage, left)
    # Gains only fall: one that was found earlier is a bound, looked at again when it is highest.
    bound = coverage.gains(left, areas)
    while not problem.done:
        uncovered = coverage.uncovered.ravel()[left]
        if np.count_nonzero(uncovered) <= allowed:
            return
        bound[~uncovered] = -1
        top = np.argmax(bound)
        while (gain := coverage.gains(left[[top]], areas[[top]])[0]) < bound[top]:
            bound[top] = gain
            top = np.argmax(bound)
        yield left[[top]]


def _lattice(problem: Problem, spacing: int) -> IntArray:
    """Return the region's candidates at whole multiples of a spacing, from half a spacing on."""
    rows, cols = problem.grid.shape
    chosen = np.zeros((rows, cols), dtype=bool)
    chosen[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
    return np.flatnonzero(chosen & problem.region)

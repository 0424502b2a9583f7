"""What strategies share: the protocol, and tolerance areas interpolated from rendered views."""

from collections.abc import Callable, Generator

import numpy as np

from skyline.planning.coverage import BoolArray, Coverage, Float32Array, IntArray, Problem

Requests = Generator[IntArray, Float32Array, None]
"""Yields candidates to render (n,), is sent the reprojection errors (n, K, K) of those views.

The problem's coverage holds the views' areas before the generator is resumed.
"""

Strategy = Callable[[Problem, np.random.Generator], Requests]


def interpolated_areas(coverage: Coverage, candidates: IntArray, nearest: int = 4) -> BoolArray:
    """Return areas of candidates (N), interpolated linearly from the nearest rendered views.

    The weight of a view falls with its distance; a location is inside where the weighted areas
    say so by half. Before anything is rendered an area is the candidate itself.

    Returns
    -------
    (N, K, K) bool
    """
    grid = coverage.grid
    areas = np.zeros((len(candidates), grid.window, grid.window), dtype=bool)
    if len(coverage.viewpoints):
        chosen, apart = grid.nearest(candidates, coverage.viewpoints, nearest)
        weight = 1.0 / np.maximum(apart, 0.5)
        weight = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
        share = np.zeros(areas.shape, dtype=np.float32)
        for place in range(chosen.shape[1]):
            share += coverage.areas[chosen[:, place]] * weight[:, place, None, None]
        areas = share >= np.float32(0.5)
    areas[:, grid.reach, grid.reach] = True
    return areas


def best(coverage: Coverage, candidates: IntArray, areas: BoolArray) -> IntArray:
    """Return the one candidate, shape (1,), whose area covers most uncovered ground."""
    return candidates[[np.argmax(coverage.gains(candidates, areas))]]


def draw(generator: np.random.Generator, candidates: IntArray, number: int) -> IntArray:
    """Return up to a number of candidates drawn at random without repetition."""
    if len(candidates) <= number:
        return candidates
    return generator.choice(candidates, number, replace=False)

"""The paper's five strategies: which viewpoint to render next (section 4.3)."""

from collections.abc import Callable

import numpy as np

from skyline.arrays import BoolArray, Float64Array, Int64Array
from skyline.paper.coverage import Coverage, Problem, Requests, Strategy

_DRAWN = 10
"""How many candidate locations ROV and AROV draw for each viewpoint they select."""

_RANKED = 64
"""How many pre-located candidates are ranked for each viewpoint selected."""


def rov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Random Optimistic Viewpoint.

    Draws candidates from the uncovered area, computes their tolerance areas by projecting the
    known skyline points, and selects the one that overlaps most with the uncovered area.
    """
    while not problem.done:
        drawn = draw(generator, problem.open_candidates(), _DRAWN)
        areas = problem.predict_errors(drawn) <= problem.threshold_px
        yield best(problem.coverage, drawn, areas)


def arov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Approximated Random Optimistic Viewpoint: ROV with areas interpolated, not computed."""
    while not problem.done:
        drawn = draw(generator, problem.open_candidates(), _DRAWN)
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
    """Select among the region's candidates at whole multiples of a spacing, from half of it on."""
    coverage = problem.coverage
    chosen = np.zeros(problem.grid.shape, dtype=bool)
    chosen[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
    lattice = np.flatnonzero(chosen & problem.region)
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


def sov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Shape-Assisted Optimistic Viewpoint.

    Takes each tolerance area for an ellipse and packs candidates along its minor axis, where the
    next ellipse of its kind would touch it; selects among them as AROV does. Where no packed
    candidate is uncovered, candidates are drawn as in AROV.
    """
    yield from _preselected(problem, generator, _pack)


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


def minor_axes(areas: BoolArray) -> Float64Array:
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


def lpov(problem: Problem, generator: np.random.Generator) -> Requests:
    """Line Planning Optimistic Viewpoint.

    Pre-locates a viewpoint on each line joining a pair of rendered viewpoints; selects among
    those uncovered as AROV does. Where none is uncovered, candidates are drawn as in AROV.

    The viewpoint's distances from the two ends are in proportion to the linear sizes (square
    roots of the areas) of their tolerance areas. The paper words the weights as proportional to
    an end's size; taken as weights of the ends themselves they would draw viewpoints towards the
    large areas, against what the paper says they achieve: few viewpoints where areas are large.
    """
    yield from _preselected(problem, generator, _locate, _RANKED)


def _locate(problem: Problem, known: int, located: BoolArray) -> None:
    """Mark the candidates on the lines from viewpoints after the first ``known`` to all."""
    coverage = problem.coverage
    row, col = problem.grid.row_col(coverage.viewpoints)
    size = np.sqrt(np.count_nonzero(coverage.areas, axis=(1, 2)))
    weight = size / (size[known:, None] + size)
    to_row = weight * row[known:, None] + (1.0 - weight) * row
    to_col = weight * col[known:, None] + (1.0 - weight) * col
    located[np.rint(to_row).astype(np.int64), np.rint(to_col).astype(np.int64)] = True


def _preselected(
    problem: Problem,
    generator: np.random.Generator,
    mark: Callable[[Problem, int, BoolArray], None],
    ranked: int | None = None,
) -> Requests:
    """Select among candidates that the rendered viewpoints mark, at most so many drawn of them."""
    coverage = problem.coverage
    marked = np.zeros(problem.grid.shape, dtype=bool)
    known = 0
    while not problem.done:
        mark(problem, known, marked)
        known = len(coverage.viewpoints)
        candidates = np.flatnonzero(marked & coverage.uncovered & problem.region)
        if not candidates.size:
            candidates = draw(generator, problem.open_candidates(), _DRAWN)
        elif ranked is not None:
            candidates = draw(generator, candidates, ranked)
        yield best(coverage, candidates, interpolated_areas(coverage, candidates))


def interpolated_areas(coverage: Coverage, candidates: Int64Array) -> BoolArray:
    """Return areas (N, K, K) of candidates (N), interpolated from the nearest rendered views.

    A location is inside where the weighted areas say so by half. Before anything is rendered an
    area is the candidate itself.
    """
    grid = coverage.grid
    areas = np.zeros((len(candidates), grid.window, grid.window), dtype=bool)
    if len(coverage.viewpoints):
        share = grid.interpolated(candidates, coverage.viewpoints, coverage.areas)
        areas = share >= np.float32(0.5)
    areas[:, grid.reach, grid.reach] = True
    return areas


def best(coverage: Coverage, candidates: Int64Array, areas: BoolArray) -> Int64Array:
    """Return the one candidate, shape (1,), whose area covers most uncovered ground."""
    return candidates[[np.argmax(coverage.gains(candidates, areas))]]


def draw(generator: np.random.Generator, candidates: Int64Array, number: int) -> Int64Array:
    """Return up to a number of candidates drawn at random without repetition."""
    if len(candidates) <= number:
        return candidates
    return generator.choice(candidates, number, replace=False)


STRATEGIES: dict[str, Strategy] = {
    "rov": rov,
    "arov": arov,
    "hov": hov,
    "sov": sov,
    "lpov": lpov,
}

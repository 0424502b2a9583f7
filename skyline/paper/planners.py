"""The paper's five planners of viewpoints (section 4.3).

Each chooses the next viewpoint. A planning problem is one heading. Sites, at which views may be
rendered, lie on a grid of rows (north to south) and columns (west to east); the index of a site is
``row * cols + col``. The tolerance area of a view is a boolean window of K x K sites around it, K =
2 * reach + 1. Its rows go southward and its columns eastward whatever the heading.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from skyline.arrays import BoolArray, Float64Array, Int64Array

PLANNERS = "skyline.planners"
"""Group of the entry points that are planners."""

_DRAWN = 10
"""Number of sites that ROV and AROV draw for each viewpoint they select. The paper gives none."""


@dataclass(frozen=True, slots=True, eq=False)
class Sites:
    """The grid of locations from which viewpoints are chosen."""

    valid: BoolArray
    """(rows, cols) bool. False where no eye can stand: on holes and on the map's border."""
    easting_m: Float64Array
    """(cols,) float64."""
    northing_m: Float64Array
    """(rows,) float64. Descending."""
    reach: int
    """Greatest extent of a tolerance area from its view, in sites; at least 1."""

    @property
    def window(self) -> int:
        """The side K of a tolerance area's window, in sites."""
        return 2 * self.reach + 1

    def row_col(self, sites: Int64Array) -> tuple[Int64Array, Int64Array]:
        """Return the rows and columns of sites."""
        return sites // self.valid.shape[1], sites % self.valid.shape[1]

    def nearest(
        self, sites: Int64Array, others: Int64Array, number: int
    ) -> tuple[Int64Array, Float64Array]:
        """Return which of the ``others`` (M) are nearest to each site (N).

        Indices into ``others`` and distances in sites are (N, min(number, M)), the nearest first.
        """
        row, col = self.row_col(sites)
        other_row, other_col = self.row_col(others)
        apart = np.hypot(row[:, None] - other_row, col[:, None] - other_col)
        chosen = np.argsort(apart, axis=1, kind="stable")[:, :number]
        return chosen, np.take_along_axis(apart, chosen, axis=1)


class Coverage:
    """The union of the tolerance areas of views along one heading.

    Attributes
    ----------
    sites : Sites
    viewpoints : (N,) int64
        Sites rendered so far, in the order in which they were added.
    areas : (N, K, K) bool
        Their tolerance areas, without sites that are not valid.
    uncovered : (rows, cols) bool
        Valid sites in no tolerance area.
    """

    def __init__(self, sites: Sites) -> None:
        self.sites = sites
        reach = sites.reach
        size = (sites.window, sites.window)
        # Windows look into padded arrays, so that the grid's border is no special case.
        valid = np.pad(sites.valid, reach)
        uncovered = valid.copy()
        self.uncovered = uncovered[reach:-reach, reach:-reach]
        self._valid_windows = sliding_window_view(valid, size)
        self._open_windows = sliding_window_view(uncovered, size, writeable=True)
        self.viewpoints = np.zeros(0, dtype=np.int64)
        self.areas = np.zeros((0, *size), dtype=bool)

    def add(self, viewpoints: Int64Array, areas: BoolArray) -> None:
        """Add the tolerance areas (N, K, K) of views at sites (N,)."""
        row, col = self.sites.row_col(viewpoints)
        areas = areas & self._valid_windows[row, col]
        for at, area in zip(zip(row, col, strict=True), areas, strict=True):
            self._open_windows[at] &= ~area
        self.viewpoints = np.concatenate([self.viewpoints, viewpoints])
        self.areas = np.concatenate([self.areas, areas])

    def gains(self, sites: Int64Array, areas: BoolArray) -> Int64Array:
        """Return how many sites each area (N, K, K) would newly cover."""
        gained = self._open_windows[self.sites.row_col(sites)] & areas
        return np.asarray(np.count_nonzero(gained, axis=(1, 2)), dtype=np.int64)

    def fraction(self, region: BoolArray | None = None) -> float:
        """Return the covered share of the valid sites.

        With a region, only its sites count.
        """
        valid = self.sites.valid if region is None else self.sites.valid & region
        left = int((self.uncovered & valid).sum())
        return 1.0 - left / max(int(valid.sum()), 1)

    @property
    def overlap(self) -> int:
        """The paper's criterion (B): inclusions of sites in areas, minus covered sites."""
        covered = self.sites.valid & ~self.uncovered
        return int(np.count_nonzero(self.areas)) - int(np.count_nonzero(covered))


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """A region to cover along one heading: all that a planner knows."""

    coverage: Coverage
    """The views rendered so far, up to date whenever a planner goes on. All regions of one heading
    share it."""
    region: BoolArray
    """(rows, cols) bool. The sites to cover, from which viewpoints are chosen."""
    target: float
    """Share of the region's valid sites to cover, in (0, 1]."""
    projected_areas: Callable[[Int64Array], BoolArray]
    """Returns the tolerance areas (N, K, K) of unrendered views at sites (N), to which skyline
    points of rendered views are projected. Only ROV calls it."""

    @property
    def is_covered(self) -> bool:
        """True if the region is covered to the target."""
        return self.coverage.fraction(self.region) >= self.target

    def open_sites(self) -> Int64Array:
        """Return the uncovered sites of the region, ascending."""
        return np.flatnonzero(self.coverage.uncovered & self.region)


class Planner(Protocol):
    """Chooses viewpoints of a region until it is covered.

    A package offers a planner as an entry point of the group `PLANNERS`. ``skyline render
    --planner`` then takes its name.
    """

    def __call__(self, problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
        """Yield sites (n,) of the problem's region to render, by their indices.

        When the planner goes on, ``problem.coverage`` has the tolerance areas of the views at these
        sites. The planner ends when the region is covered. All its random choices come from
        ``generator``, so that the same seed gives the same plan.
        """


def rov(problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
    """Random Optimistic Viewpoint.

    Draws sites from the uncovered area, computes their tolerance areas by projecting known skyline
    points, and selects the site whose area has the largest overlap with the uncovered area.
    """
    while not problem.is_covered:
        drawn = draw(generator, problem.open_sites(), _DRAWN)
        yield best(problem.coverage, drawn, problem.projected_areas(drawn))


def arov(problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
    """Approximated Random Optimistic Viewpoint: ROV with interpolated areas."""
    while not problem.is_covered:
        drawn = draw(generator, problem.open_sites(), _DRAWN)
        yield best(problem.coverage, drawn, interpolated_areas(problem.coverage, drawn))


def hov(problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
    """Hierarchy Optimistic Viewpoint.

    Goes from coarse to fine over lattices of sites, each with half the spacing of the one before.
    The sites of a level are a fixed pattern: their areas are interpolated once, as the level
    begins, and AROV's choice among the uncovered ones follows until the level is covered.
    """
    spacing = 1 << (max(problem.coverage.sites.valid.shape) // 2).bit_length() - 1
    while not problem.is_covered:
        yield from _level(problem, spacing)
        spacing = max(1, spacing // 2)


def _level(problem: Problem, spacing: int) -> Iterator[Int64Array]:
    """Select among the sites of one level of `hov`, ``spacing`` sites apart."""
    coverage = problem.coverage
    chosen = np.zeros(problem.coverage.sites.valid.shape, dtype=bool)
    chosen[spacing // 2 :: spacing, spacing // 2 :: spacing] = True
    lattice = np.flatnonzero(chosen & problem.region)
    # At spacing 1 the strategy stops at the region's own target.
    allowed = int(len(lattice) * (1.0 - problem.target)) if spacing > 1 else 0
    left = lattice[coverage.uncovered.ravel()[lattice]]
    areas = interpolated_areas(coverage, left)
    # Gains only fall, so an earlier gain is an upper bound; it is computed anew when it is highest.
    bound = coverage.gains(left, areas)
    while not problem.is_covered:
        uncovered = coverage.uncovered.ravel()[left]
        if np.count_nonzero(uncovered) <= allowed:
            return
        bound[~uncovered] = -1
        top = np.argmax(bound)
        while (gain := coverage.gains(left[[top]], areas[[top]])[0]) < bound[top]:
            bound[top] = gain
            top = np.argmax(bound)
        yield left[[top]]


def sov(problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
    """Shape-Assisted Optimistic Viewpoint.

    Takes each tolerance area for an ellipse and packs sites along its minor axis, where an equal
    ellipse would touch it; selects among them as AROV does. Where no packed site is uncovered,
    sites are drawn as in AROV.
    """
    yield from _preselected(problem, generator, _pack)


def _pack(problem: Problem, known: int, packed: BoolArray) -> None:
    """Mark the sites on the minor axes of new viewpoints.

    The first ``known`` viewpoints are not new.
    """
    coverage = problem.coverage
    row, col = coverage.sites.row_col(coverage.viewpoints[known:])
    axis = minor_axes(coverage.areas[known:])
    for sign in (-2.0, 2.0):
        to_row = np.rint(row + sign * axis[:, 0]).astype(np.int64)
        to_col = np.rint(col + sign * axis[:, 1]).astype(np.int64)
        rows, cols = packed.shape
        inside = (to_row >= 0) & (to_row < rows) & (to_col >= 0) & (to_col < cols)
        packed[to_row[inside], to_col[inside]] = True


def minor_axes(areas: BoolArray) -> Float64Array:
    """Return the minor semi-axes (N, 2) of areas (N, K, K).

    The areas are taken for ellipses. A semi-axis is a step along rows and columns. The ellipse has
    the area's moments about the viewpoint, its centre: a filled ellipse has the variance b^2 / 4
    along its semi-axis b, and a cell adds its own 1 / 12.
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


def lpov(problem: Problem, generator: np.random.Generator) -> Iterator[Int64Array]:
    """Line Planning Optimistic Viewpoint.

    Locates a site on each line joining a pair of rendered viewpoints; selects among the uncovered
    ones, of which at most 64 are compared, as AROV does. Where none is uncovered, sites are drawn
    as in AROV.

    The distances of a site from the two ends are in proportion to the linear sizes (square roots of
    the areas) of their tolerance areas. The paper calls the weights proportional to an end's size.
    Taken as weights of the ends' positions, they would draw sites towards large areas, but the
    paper describes the opposite effect: few viewpoints where areas are large.
    """
    yield from _preselected(problem, generator, _locate, ranked=64)


def _locate(problem: Problem, known: int, located: BoolArray) -> None:
    """Mark sites on the lines from viewpoints after the first ``known``."""
    coverage = problem.coverage
    row, col = coverage.sites.row_col(coverage.viewpoints)
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
) -> Iterator[Int64Array]:
    """Select among the sites that ``mark`` marks, as AROV does.

    If more than ``ranked`` are uncovered, only ``ranked`` of them, drawn at random, are compared.
    """
    coverage = problem.coverage
    marked = np.zeros(problem.coverage.sites.valid.shape, dtype=bool)
    known = 0
    while not problem.is_covered:
        mark(problem, known, marked)
        known = len(coverage.viewpoints)
        sites = np.flatnonzero(marked & coverage.uncovered & problem.region)
        if not sites.size:
            sites = draw(generator, problem.open_sites(), _DRAWN)
        elif ranked is not None:
            sites = draw(generator, sites, ranked)
        yield best(coverage, sites, interpolated_areas(coverage, sites))


def interpolated_areas(coverage: Coverage, sites: Int64Array) -> BoolArray:
    """Return tolerance areas (N, K, K), interpolated between views.

    The four nearest rendered views count, each with a weight that falls with its distance. A site
    is inside if the areas of views with at least half of the weight contain it. Before anything is
    rendered an area is the site itself.
    """
    grid = coverage.sites
    share = np.zeros((len(sites), grid.window, grid.window), dtype=np.float32)
    chosen, apart = grid.nearest(sites, coverage.viewpoints, 4)
    weight = 1.0 / np.maximum(apart, 0.5)
    weight = (weight / weight.sum(axis=1, keepdims=True)).astype(np.float32)
    for place in range(chosen.shape[1]):
        share += coverage.areas[chosen[:, place]] * weight[:, place, None, None]
    areas = share >= np.float32(0.5)
    areas[:, grid.reach, grid.reach] = True
    return areas


def best(coverage: Coverage, sites: Int64Array, areas: BoolArray) -> Int64Array:
    """Return the site (1,) whose area covers most uncovered ground."""
    return sites[[np.argmax(coverage.gains(sites, areas))]]


def draw(generator: np.random.Generator, sites: Int64Array, number: int) -> Int64Array:
    """Return up to a number of sites, drawn at random without repetition."""
    if len(sites) <= number:
        return sites
    return generator.choice(sites, number, replace=False)

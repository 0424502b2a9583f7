"""Verification of a plan: locations that it covers are rendered and compared.

A stored skyline is compared with the one rendered at another eye, after the best affine warp. The
paper's matcher allows for such a warp, and reprojection errors predict the distance after it.
"""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray, Int64Array, Rows
from skyline.paper.plan import CoveragePlan, Render
from skyline.paper.planners import Coverage
from skyline.paper.tolerance_areas import (
    IDENTITY,
    affine_least_squares,
    affine_median,
    displacements_m,
    non_affine,
    skyline_points_m,
)
from skyline.skylines import HEADINGS, Views, columns_u, pixel_size


@dataclass(frozen=True, slots=True)
class _WarpFit:
    """Limits and steps of the fit of a warp between skylines."""

    max_change: float = 0.25
    """Greatest change of each entry of the warp's linear part from the identity: if any warp were
    allowed, all skylines would be alike."""
    min_share: float = 0.5
    """Least share of the columns that must land on known columns of the other curve."""
    outlier_px: float = 3.0
    """Huber's threshold: a column farther off counts by its distance, a nearer one by its
    square."""
    rounds: int = 6
    """Steps of Gauss-Newton at each number of columns."""
    damping: float = 1e-3
    """Share of the diagonal that is first added to it."""
    ridge: float = 1e-9
    """Share of the greatest diagonal entry that is always added: curves without slope leave the
    equations singular."""
    steepest: float = 0.3
    """Least stretch of the abscissa at which the slope of a warped curve is used."""
    columns: tuple[int, ...] = (20, 40, 80, 160, 320)
    """Columns of the coarser curves on which a warp is found first: on a rough skyline the cost has
    many local minima."""
    at_once: int = 64
    """Views fitted together, whose arrays stay in the processor's cache."""

    @property
    def bounds(self) -> tuple[Float64Array, Float64Array]:
        """The least and the greatest entries (6,) of a warp.

        Shifts are free.
        """
        most = self.max_change * np.array([1.0, 1.0, np.inf, 1.0, 1.0, np.inf])
        return IDENTITY.ravel() - most, IDENTITY.ravel() + most


_FIT = _WarpFit()


@dataclass(frozen=True, slots=True)
class Verification:
    """The share of a plan's coverage that a rendered sample confirms."""

    share: float
    """Share of the sample in which the rendering comes within the threshold of some stored view,
    after the best affine warp."""
    low: float
    """Lower end of the 95 % interval (Wilson) of ``share``."""
    high: float
    """Upper end of that interval."""
    sampled: int
    """Number of locations in the sample."""
    predicted: float
    """Coverage that the plan predicts."""

    @property
    def verified(self) -> float:
        """Predicted coverage times the share of it that renderings confirm."""
        return self.predicted * self.share


def verify_coverage(plan: CoveragePlan, render: Render) -> Verification:
    """Render covered locations and compare them with the views that cover them.

    The 400 locations are drawn at random, and may be viewpoints themselves. Of the views whose
    tolerance areas hold a location, the nearest four are compared.
    """
    from scipy.stats import binomtest  # noqa: PLC0415  (slow to load)

    held = [one.sites.valid & ~one.uncovered for one in plan.coverages]
    covered = np.flatnonzero(np.stack(held))
    drawn = np.sort(np.random.default_rng(0).choice(covered, min(400, len(covered)), False))
    heading, location = np.divmod(drawn, plan.sites.valid.size)
    rendered = render(plan.viewpoints(location), heading.astype(np.uint8))
    # The views of a heading are in the order of its viewpoints.
    views_of = [np.flatnonzero(plan.views.heading == one) for one in HEADINGS]
    covering = [
        views_of[one][_covering(plan.coverages[one], where)]
        for one, where in zip(heading.tolist(), location.tolist(), strict=True)
    ]
    pair = np.repeat(np.arange(len(covering)), [len(found) for found in covering])
    stored = plan.views[np.concatenate(covering)]
    within = true_errors_px(stored, rendered[pair]) <= plan.config.threshold_px
    true = int(np.count_nonzero(np.bincount(pair[within], minlength=len(location))))
    interval = binomtest(true, len(location)).proportion_ci(0.95, "wilson")
    return Verification(
        share=true / len(location),
        low=float(interval.low),
        high=float(interval.high),
        sampled=len(location),
        predicted=plan.coverage,
    )


def _covering(coverage: Coverage, location: int) -> Int64Array:
    """Return the four nearest views (rows) whose areas hold a location."""
    grid = coverage.sites
    reach = grid.reach
    row, col = grid.row_col(coverage.viewpoints)
    at_row, at_col = divmod(location, len(grid.easting_m))
    down = at_row - row
    across = at_col - col
    near = np.flatnonzero(np.maximum(np.abs(down), np.abs(across)) <= reach)
    holds = near[coverage.areas[near, down[near] + reach, across[near] + reach]]
    apart = np.hypot(down[holds], across[holds])
    return holds[np.argsort(apart, kind="stable")[:4]]


def true_errors_px(stored: Views, rendered: Views) -> Float32Array:
    """Return distances (N,) of warped stored skylines from rendered ones.

    They are means, in px. The N views of both kinds have one width, and each pair one heading. The
    warp is the best affine one whose linear part differs from the identity by at most 0.25 in each
    entry. The distance is vertical, over the columns that land in frame; it is infinite where these
    are fewer than half of them.
    """
    errors = np.empty(len(stored), dtype=np.float32)
    for begin in range(0, len(stored), _FIT.at_once):
        part = slice(begin, begin + _FIT.at_once)
        errors[part] = _errors_px(stored[part], rendered[part])
    return errors


def _errors_px(stored: Views, rendered: Views) -> Float64Array:
    """Return the least distances of all starts, fitted from coarse to fine."""
    best = np.full(len(stored), np.inf)
    counts = (*(c for c in _FIT.columns if c < stored.width), stored.width)
    pairs = [(block_means(stored.v, count), block_means(rendered.v, count)) for count in counts]
    for warp in np.moveaxis(_starts(stored, rendered), 1, 0):
        found = warp
        for curves, targets in pairs:
            distances, found = fitted_warps(curves, targets, found, stored.width)
        best = np.minimum(best, distances)
    return best


def _starts(stored: Views, rendered: Views) -> Float64Array:
    """Return the warps (N, 3, 2, 3) from which fits start.

    They are the identity, Equation 4, and least squares.
    """
    there = displacements_m(
        stored,
        stored.heading,
        rendered.easting_m[:, np.newaxis],
        rendered.northing_m[:, np.newaxis],
        rendered.eye_elevation_m[:, np.newaxis],
    )
    points = skyline_points_m(stored, stored.width)
    warps = non_affine, affine_median, affine_least_squares
    return np.concatenate([warp(points, there) for warp in warps], axis=1)


def block_means(rows: FloatArray, blocks: int) -> Float32Array:
    """Return means (..., blocks) of columns' runs in rows (..., W).

    Runs are as equal as can be, and at most W. An unknown value, NaN, is left out of its mean; the
    mean of a run without any number is NaN.
    """
    starts = np.arange(blocks) * rows.shape[-1] // blocks
    known = np.isfinite(rows)
    count = np.add.reduceat(known, starts, axis=-1, dtype=np.float32)
    total = np.add.reduceat(np.where(known, rows, 0.0), starts, axis=-1)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan).astype(np.float32)


def fitted_warps(
    curves: FloatArray, targets: FloatArray, starts: Float64Array, width: int
) -> tuple[Float64Array, Float64Array]:
    """Fit affine warps of curves onto targets, within bounds.

    Returns the distances and the warps. Curves and targets (B, Q) are ordinates v at Q column
    centres; NaN is unknown. Warps to start from are (B, 2, 3); NaN is none. A distance (B,) in px,
    2 / W, is the mean vertical distance of the warped columns from the target; infinite where too
    few of them land on it.
    """
    pixel = pixel_size(width)
    pair = _Pair(curves, targets, pixel)
    state = pair.state(np.clip(np.nan_to_num(starts.reshape(-1, 6)), *_FIT.bounds))
    damping = np.full(len(starts), _FIT.damping)
    for _ in range(_FIT.rounds):
        trial = pair.state(pair.step(state, damping))
        better = trial.error < state.error
        state = state.replaced(better, trial)
        damping = np.where(better, 0.3 * damping, 8.0 * damping)
    return state.error / pixel, state.affine.reshape(-1, 2, 3)


@dataclass(slots=True, eq=False)
class _State(Rows):
    """B warps, and how far they put Q columns from the targets."""

    affine: Float64Array
    """(B, 6) float64. Entries of the warps, row by row."""
    error: Float64Array
    """(B,) float64. Mean distance of the columns, a tangent."""
    miss: Float64Array
    """(B, Q) float64. Each column's ordinate minus the target's; 0 where not usable."""
    slope: Float64Array
    """(B, Q) float64. Slope of the target where the column lands; 0 where not usable."""
    usable: BoolArray
    """(B, Q) bool. Whether the column lands on a known part of the target."""


class _Pair:
    """B curves, and the targets onto which they are warped."""

    def __init__(self, curves: FloatArray, targets: FloatArray, pixel: float) -> None:
        self.columns = curves.shape[1]
        self.u = columns_u(self.columns)
        self.v = curves.astype(np.float64)
        self.targets = targets.astype(np.float64)
        self.outlier = _FIT.outlier_px * pixel
        padded = np.concatenate([self.v[:, :1], self.v, self.v[:, -1:]], axis=1)
        self.slope = (padded[:, 2:] - padded[:, :-2]) / (4.0 / self.columns)
        known = np.nan_to_num(self.v)
        self.design = np.stack(
            [np.broadcast_to(self.u, known.shape), known, np.ones_like(known)], 1
        )
        self.row = np.arange(len(curves))[:, np.newaxis] * self.columns

    def state(self, affine: Float64Array) -> _State:
        """Return the state of warps (B, 6)."""
        a, b, c, d, e, f = affine.T[:, :, np.newaxis]
        position = (a * self.u + b * self.v + (c + 1.0)) * (self.columns / 2.0) - 0.5
        usable = (position >= 0.0) & (position <= self.columns - 1)
        position = np.where(usable, position, 0.0)
        left = np.minimum(position.astype(np.intp), self.columns - 2)
        index = self.row + left
        flat = self.targets.ravel()
        begin = flat[index]
        rise = flat[index + 1] - begin
        miss = d * self.u + e * self.v + f - begin - (position - left) * rise
        usable &= np.isfinite(miss)
        miss = np.where(usable, miss, 0.0)
        rise = np.where(usable, rise, 0.0)
        count = usable.sum(axis=1)
        error = np.abs(miss).sum(axis=1) / np.maximum(count, 1)
        error[count < _FIT.min_share * self.columns] = np.inf
        return _State(affine, error, miss, rise * (self.columns / 2.0), usable)

    def step(self, state: _State, damping: Float64Array) -> Float64Array:
        """Return the warps (B, 6) after a damped Gauss-Newton step, within bounds.

        The slope is the mean of both curves' slopes, as in efficient second-order minimization:
        this needs a third of the rounds that the slope of the other curve needs.
        """
        a, b, _, d, e, _ = state.affine.T[:, :, np.newaxis]
        stretch = np.maximum(a + b * self.slope, _FIT.steepest)
        warped_slope = np.where(state.usable, (d + e * self.slope) / stretch, 0.0)
        slope = 0.5 * (state.slope + np.nan_to_num(warped_slope))
        weight = state.usable / np.maximum(np.abs(state.miss), self.outlier)
        change = np.concatenate([-slope[:, np.newaxis] * self.design, self.design], axis=1)
        weighted = change * weight[:, np.newaxis]
        normal = weighted @ change.transpose(0, 2, 1)
        gradient = (weighted @ state.miss[:, :, np.newaxis])[:, :, 0]
        diagonal = np.einsum("bii->bi", normal)
        diagonal += damping[:, np.newaxis] * diagonal
        diagonal += _FIT.ridge * (1.0 + diagonal.max(axis=1, keepdims=True))
        return _bounded_step(state.affine, normal, gradient)


def _bounded_step(
    affine: Float64Array, normal: Float64Array, gradient: Float64Array
) -> Float64Array:
    """Return affine - normal^-1 gradient, with all entries within bounds.

    An entry that would leave the bounds is held there. The other entries are then solved for again,
    since their steps depend on it.
    """
    bounds = _FIT.bounds
    moved = affine
    held = np.zeros(affine.shape, dtype=bool)
    for _ in range(3):
        step = np.where(held, affine - moved, 0.0)
        rest = gradient - (normal @ step[:, :, np.newaxis])[:, :, 0]
        free = ~(held[:, :, np.newaxis] | held[:, np.newaxis])
        system = normal * free + held[:, :, np.newaxis] * np.eye(6)
        step = np.linalg.solve(system, np.where(held, step, rest)[:, :, np.newaxis])[:, :, 0]
        moved = np.clip(affine - step, *bounds)
        held |= moved != affine - step
    return moved

"""Verification of a plan: covered locations are rendered and compared with its prediction.

A stored skyline is compared with the one rendered at another eye, after the best affine warp. The
paper's matcher allows for such a warp, and reprojection errors predict the distance after it.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, FloatArray, Int64Array, Rows
from skyline.paper.reprojection import (
    IDENTITY,
    affine_least_squares,
    affine_median,
    displacements_m,
    non_affine,
    skyline_points_m,
)
from skyline.paper.strategies import Coverage
from skyline.skylines import HEADINGS, Views, columns_u, pixel_size

if TYPE_CHECKING:
    from skyline.paper.plan import Plan, Render

_Z_95 = 1.959963984540054
_SAMPLE, _VIEWS_COMPARED = 400, 4

MAX_CHANGE = 0.25
"""Greatest change of the warp's linear part from the identity, each entry: with any warp
allowed all skylines are alike."""

_MAX_CHANGES = MAX_CHANGE * np.array([1.0, 1.0, np.inf, 1.0, 1.0, np.inf])
_BOUNDS = IDENTITY.ravel() - _MAX_CHANGES, IDENTITY.ravel() + _MAX_CHANGES

_MIN_SHARE = 0.5
"""Least share of the columns that must land on known columns of the other curve."""

_OUTLIER_PX = 3.0
"""Huber's threshold: a column farther off counts by its distance, a nearer one by its square."""

_ROUNDS, _DAMPING, _RIDGE = 6, 1e-3, 1e-9

_STEEPEST = 0.3
"""Least stretch of the abscissa at which the slope of a warped curve is used."""

_COLUMNS = (20, 40, 80, 160, 320)
"""Columns of the coarser curves on which a warp is found first: on a rough skyline the cost has
many local minima."""

_AT_ONCE = 64


@dataclass(frozen=True, slots=True)
class Verification:
    """The share of a plan's coverage that renderings of a sample of locations confirm."""

    share: float
    """Share of the sample in which the rendering comes within the threshold of some stored view,
    after the best affine warp; its 95 % interval (Wilson) is from ``low`` to ``high``."""
    low: float
    high: float
    sampled: int
    predicted: float
    """Coverage that the plan predicts."""

    @property
    def verified(self) -> float:
        """Predicted coverage times the share of it that renderings confirm."""
        return self.predicted * self.share


def verify_coverage(plan: "Plan", render: "Render") -> Verification:
    """Render a random sample of covered locations and compare them with the views that cover them.

    Locations that were rendered themselves may be in the sample. Of the views whose tolerance areas
    hold a location, the nearest four are compared.
    """
    held = [one.candidates.valid & ~one.uncovered for one in plan.coverages]
    covered = np.flatnonzero(np.stack(held))
    drawn = np.sort(np.random.default_rng(0).choice(covered, min(_SAMPLE, len(covered)), False))
    heading, location = np.divmod(drawn, plan.candidates.valid.size)
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
    low, high = wilson_interval(true, len(location))
    return Verification(true / len(location), low, high, len(location), plan.coverage)


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, after Wilson."""
    share = successes / trials
    middle = share + _Z_95**2 / (2 * trials)
    half = _Z_95 * np.sqrt(share * (1 - share) / trials + _Z_95**2 / (4 * trials**2))
    scale = 1 + _Z_95**2 / trials
    return float((middle - half) / scale), float((middle + half) / scale)


def _covering(coverage: Coverage, location: int) -> Int64Array:
    """Return the rows of the views whose areas hold a location, nearest first, at most four."""
    grid, reach = coverage.candidates, coverage.candidates.reach
    row, col = grid.row_col(coverage.viewpoints)
    at_row, at_col = divmod(location, len(grid.easting_m))
    down, across = at_row - row, at_col - col
    near = np.flatnonzero(np.maximum(np.abs(down), np.abs(across)) <= reach)
    holds = near[coverage.areas[near, down[near] + reach, across[near] + reach]]
    apart = np.hypot(down[holds], across[holds])
    return holds[np.argsort(apart, kind="stable")[:_VIEWS_COMPARED]]


def true_errors_px(stored: Views, rendered: Views) -> Float32Array:
    """Return mean distances (N,) in px of stored skylines from rendered ones after the best warp.

    The N views of either kind have one width, and row by row one heading. The warp is affine, and
    bounded by `MAX_CHANGE`. The distance is vertical, over the columns that land in frame; it is
    infinite where these are fewer than half of them.
    """
    errors = np.empty(len(stored), dtype=np.float32)
    for begin in range(0, len(stored), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        errors[part] = _errors_px(stored[part], rendered[part])
    return errors


def _errors_px(stored: Views, rendered: Views) -> Float64Array:
    """Return the least distances from all starts, each fitted from coarse curves to fine."""
    best = np.full(len(stored), np.inf)
    counts = (*(c for c in _COLUMNS if c < stored.width), stored.width)
    pairs = [(block_means(stored.v, count), block_means(rendered.v, count)) for count in counts]
    for warp in np.moveaxis(_starts(stored, rendered), 1, 0):
        found = warp
        for curves, targets in pairs:
            distances, found = fitted_warps(curves, targets, found, stored.width)
        best = np.minimum(best, distances)
    return best


def _starts(stored: Views, rendered: Views) -> Float64Array:
    """Return warps (N, 3, 2, 3): the identity, Equation 4, the least squares of the points."""
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
    """Return means (..., blocks) over runs of the columns of rows (..., W), at most W runs.

    Runs are as equal as can be. NaN is unknown: left out of the mean; the mean of a run without any
    number is NaN.
    """
    starts = np.arange(blocks) * rows.shape[-1] // blocks
    known = np.isfinite(rows)
    count = np.add.reduceat(known, starts, axis=-1, dtype=np.float32)
    total = np.add.reduceat(np.where(known, rows, 0.0), starts, axis=-1)
    return np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan).astype(np.float32)


def fitted_warps(
    curves: FloatArray, targets: FloatArray, starts: Float64Array, width: int
) -> tuple[Float64Array, Float64Array]:
    """Fit affine maps within bounds that warp curves onto others; return distances and maps.

    Curves and targets (B, Q) are ordinates v at Q column centres; NaN is unknown. Warps to begin
    with are (B, 2, 3); NaN is none. A distance (B,) in px, 2 / W, is the mean vertical distance of
    the warped columns from the other curve; infinite where too few of them land on it.
    """
    pixel = pixel_size(width)
    pair = _Pair(curves, targets, pixel)
    state = pair.state(np.clip(np.nan_to_num(starts.reshape(-1, 6)), *_BOUNDS))
    damping = np.full(len(starts), _DAMPING)
    for _ in range(_ROUNDS):
        trial = pair.state(pair.step(state, damping))
        better = trial.error < state.error
        state = state.replaced(better, trial)
        damping = np.where(better, 0.3 * damping, 8.0 * damping)
    return state.error / pixel, state.affine.reshape(-1, 2, 3)


@dataclass(slots=True, eq=False)
class _State(Rows):
    """B warps and the misses of the curves under them; arrays of columns are (B, Q)."""

    affine: Float64Array
    error: Float64Array
    miss: Float64Array
    slope: Float64Array
    usable: BoolArray


class _Pair:
    """B curves and the curves onto which they are warped."""

    def __init__(self, curves: FloatArray, targets: FloatArray, pixel: float) -> None:
        self.columns = curves.shape[1]
        self.u = columns_u(self.columns)
        self.v = curves.astype(np.float64)
        self.targets = targets.astype(np.float64)
        self.outlier = _OUTLIER_PX * pixel
        padded = np.concatenate([self.v[:, :1], self.v, self.v[:, -1:]], axis=1)
        self.slope = (padded[:, 2:] - padded[:, :-2]) / (4.0 / self.columns)
        known = np.nan_to_num(self.v)
        self.design = np.stack(
            [np.broadcast_to(self.u, known.shape), known, np.ones_like(known)], 1
        )
        self.row = np.arange(len(curves))[:, np.newaxis] * self.columns

    def state(self, affine: Float64Array) -> _State:
        """Return the misses of the curves under warps (B, 2, 3), and the slopes there."""
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
        miss, rise = np.where(usable, miss, 0.0), np.where(usable, rise, 0.0)
        count = usable.sum(axis=1)
        error = np.abs(miss).sum(axis=1) / np.maximum(count, 1)
        error[count < _MIN_SHARE * self.columns] = np.inf
        return _State(affine, error, miss, rise * (self.columns / 2.0), usable)

    def step(self, state: _State, damping: Float64Array) -> Float64Array:
        """Return warps one damped Gauss-Newton step on, inside the bounds.

        The slope is the mean of the two curves', as in efficient second-order minimization: it
        needs a third of the rounds that the other curve's alone does.
        """
        a, b, _, d, e, _ = state.affine.T[:, :, np.newaxis]
        stretch = np.maximum(a + b * self.slope, _STEEPEST)
        warped_slope = np.where(state.usable, (d + e * self.slope) / stretch, 0.0)
        slope = 0.5 * (state.slope + np.nan_to_num(warped_slope))
        weight = state.usable / np.maximum(np.abs(state.miss), self.outlier)
        change = np.concatenate([-slope[:, np.newaxis] * self.design, self.design], axis=1)
        weighted = change * weight[:, np.newaxis]
        normal = weighted @ change.transpose(0, 2, 1)
        gradient = (weighted @ state.miss[:, :, np.newaxis])[:, :, 0]
        diagonal = np.einsum("bii->bi", normal)
        diagonal += damping[:, np.newaxis] * diagonal
        diagonal += _RIDGE * (1.0 + diagonal.max(axis=1, keepdims=True))
        return _bounded_step(state.affine, normal, gradient)


def _bounded_step(
    affine: Float64Array, normal: Float64Array, gradient: Float64Array
) -> Float64Array:
    """Return affine - normal^-1 gradient, entries that would leave the bounds held at them.

    The other entries are solved for again: their step was made for the entries before clipping.
    """
    moved, held = affine, np.zeros(affine.shape, dtype=bool)
    for _ in range(3):
        step = np.where(held, affine - moved, 0.0)
        rest = gradient - (normal @ step[:, :, np.newaxis])[:, :, 0]
        free = ~(held[:, :, np.newaxis] | held[:, np.newaxis])
        system = normal * free + held[:, :, np.newaxis] * np.eye(6)
        step = np.linalg.solve(system, np.where(held, step, rest)[:, :, np.newaxis])[:, :, 0]
        moved = np.clip(affine - step, *_BOUNDS)
        held |= moved != affine - step
    return moved

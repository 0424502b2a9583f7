"""The affine warp that takes one curve nearest to another; see `Reprojection` for warps."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array, FloatArray
from skyline.camera import columns_u, pixel_size
from skyline.paper.planning.reprojection import IDENTITY
from skyline.rows import Rows

_DAMPING = 1e-3
_RIDGE = 1e-9

_STEEPEST = 0.3
"""Least stretch of the abscissa that the slope of a warped curve is trusted for."""


@dataclass(frozen=True, slots=True)
class WarpFit:
    """How a curve is warped onto another."""

    rounds: int = 3
    """Gauss-Newton steps."""
    max_change: float = 0.25
    """Greatest change of the warp's linear part from the identity, each entry: a matcher that takes
    any warp tells no two skylines apart."""
    min_share: float = 0.5
    """Least share of the columns that must land on known columns of the other curve."""
    outlier_px: float = 3.0
    """A column farther off than this counts by its distance, a nearer one by its square."""

    def distances_px(
        self,
        curves: FloatArray,
        targets: FloatArray,
        starts: Float64Array,
        width: int,
    ) -> tuple[Float64Array, Float64Array]:
        """Warp curves onto others as well as an affine map within bounds can.

        Parameters
        ----------
        curves, targets : (B, Q) floating
            elevation_tan at Q column centres; NaN is unknown.
        starts : (B, S, 2, 3) float64
            Warps to begin with: the best of them is improved. NaN is none.
        width : int
            Columns W of the view, which say what a px is.

        Returns
        -------
        distances_px : (B,) float64
            Mean vertical distance of the warped columns from the other curve, inf where too few
            of them land on it.
        affine : (B, 2, 3) float64
        """
        pixel = pixel_size(width)
        pair = _Pair(curves, targets, self, pixel)
        starts = np.clip(
            np.where(np.isnan(starts), 0.0, starts).reshape(*starts.shape[:2], 6), *pair.bounds
        )
        errors = np.stack([pair.state(start).error for start in np.moveaxis(starts, 1, 0)], axis=1)
        state = pair.state(starts[np.arange(len(starts)), errors.argmin(axis=1)])
        damping = np.full(len(starts), _DAMPING)
        for _ in range(self.rounds):
            trial = pair.state(pair.step(state, damping))
            better = trial.error < state.error
            state = state.replaced(better, trial)
            damping = np.where(better, 0.3 * damping, 8.0 * damping)
        return state.error / pixel, state.affine.reshape(-1, 2, 3)


@dataclass(slots=True, eq=False)
class _State(Rows):
    """B warps and how the curves miss each other under them; arrays of columns are (B, Q)."""

    affine: Float64Array
    error: Float64Array
    miss: Float64Array
    slope: Float64Array
    usable: BoolArray


class _Pair:
    """B curves and what each is warped onto."""

    def __init__(
        self, curves: FloatArray, targets: FloatArray, settings: WarpFit, pixel: float
    ) -> None:
        self.settings, self.pixel = settings, pixel
        self.columns = curves.shape[1]
        self.u = columns_u(self.columns)
        self.v = curves.astype(np.float64)
        self.targets = targets.astype(np.float64)
        self.least = settings.min_share * self.columns
        self.outlier = settings.outlier_px * pixel
        change = settings.max_change
        free = [1.0, 1.0, np.inf, 1.0, 1.0, np.inf]
        middle = IDENTITY.ravel()
        self.bounds = middle - change * np.array(free), middle + change * np.array(free)
        padded = np.concatenate([self.v[:, :1], self.v, self.v[:, -1:]], axis=1)
        self.slope = (padded[:, 2:] - padded[:, :-2]) / (4.0 / self.columns)
        known = np.nan_to_num(self.v)
        self.design = np.stack(
            [np.broadcast_to(self.u, known.shape), known, np.ones_like(known)], 1
        )
        self.row = np.arange(len(curves))[:, np.newaxis] * self.columns

    def state(self, affine: Float64Array) -> _State:
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
        error[count < self.least] = np.inf
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
        return _bounded_step(state.affine, normal, gradient, self.bounds)


def _bounded_step(
    affine: Float64Array,
    normal: Float64Array,
    gradient: Float64Array,
    bounds: tuple[Float64Array, Float64Array],
) -> Float64Array:
    """Return affine - normal^-1 gradient, entries that would leave the bounds held at them.

    Only clipping would leave the other entries where the ones that were clipped wanted them.
    """
    moved = affine - np.linalg.solve(normal, gradient[:, :, np.newaxis])[:, :, 0]
    held = np.zeros(affine.shape, dtype=bool)
    for _ in range(2):
        outside = (moved < bounds[0]) | (moved > bounds[1])
        held |= outside
        rows = np.flatnonzero(outside.any(axis=1))
        if not rows.size:
            break
        fixed = held[rows]
        fixed_step = np.where(fixed, affine[rows] - np.clip(moved[rows], *bounds), 0.0)
        free = ~(fixed[:, :, np.newaxis] | fixed[:, np.newaxis, :])
        system = normal[rows] * free + fixed[:, :, np.newaxis] * np.eye(6)
        rest = gradient[rows] - (normal[rows] @ fixed_step[:, :, np.newaxis])[:, :, 0]
        step = np.linalg.solve(system, np.where(fixed, fixed_step, rest)[:, :, np.newaxis])
        moved[rows] = affine[rows] - step[:, :, 0]
    return np.clip(moved, *bounds)

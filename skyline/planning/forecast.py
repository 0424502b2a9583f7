"""Predicted tolerance areas of all candidates, corrected by what renderings have shown."""

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.coverage import Problem

_CAP = np.float32(4.0)
"""Errors above this many thresholds are all alike; a cap lets them be interpolated."""

_PRIOR_VIEWS = 1.0
"""How many rendered views the forecast's own word weighs."""


class Forecast:
    """The areas of all candidates, as far as the model's predictions go.

    Errors are predicted on a lattice of candidates and interpolated linearly in between. When a
    view has been rendered, its true errors are compared with the predicted ones. The logarithm of
    their ratio is taken to grow in proportion to the distance from the nearest view a prediction
    could go by; how fast, is averaged over the neighbourhood, and scales the next predictions.

    Parameters
    ----------
    problem : Problem
    step : int
        Of the lattice, in candidates.

    Attributes
    ----------
    areas : (rows * cols, K, K) bool
        Predicted areas; empty for candidates that may not be chosen.
    sizes : (rows * cols) int64
        Their sizes.
    """

    def __init__(self, problem: Problem, step: int) -> None:
        self._problem = problem
        self._seen = np.zeros(0, dtype=np.int64)
        self._log_ratio = np.zeros(0)
        self._distance = np.zeros(0)
        self.refresh(step)

    def refresh(self, step: int) -> None:
        """Predict again, from all views rendered so far and with all that was learned."""
        problem, grid = self._problem, self._problem.grid
        rows, cols = grid.shape
        self._rows = np.unique(np.append(np.arange(0, rows, step), rows - 1))
        self._cols = np.unique(np.append(np.arange(0, cols, step), cols - 1))
        lattice = (self._rows[:, None] * grid.shape[1] + self._cols).ravel()
        known = grid.valid.ravel()[lattice]
        errors = np.minimum(
            problem.model.predict_errors(lattice[known]), _CAP * np.float32(problem.threshold_px)
        )
        nearest = grid.nearest(lattice, lattice[known], 1)[0][:, 0]
        self._sources = problem.coverage.viewpoints.copy()
        shape = (len(self._rows), len(self._cols), grid.window, grid.window)
        self._lattice = errors[nearest].reshape(shape)
        scale = np.exp(self._correction(lattice)).astype(np.float32)
        self._corrected = self._lattice * scale.reshape(*shape[:2], 1, 1)
        self.areas = self._predict_areas()
        self.sizes = np.count_nonzero(self.areas, axis=(1, 2))

    def learn(self, candidates: Int64Array, errors: Float32Array) -> float:
        """Compare true errors (N, K, K) of views just rendered with what was predicted.

        Returns
        -------
        float
            The share by which predicted and true areas differ, 0 where they are the same.
        """
        threshold_px = self._problem.threshold_px
        predicted, true = self.areas[candidates], errors <= threshold_px
        ratio = [
            _log_ratio(one, other, threshold_px)
            for one, other in zip(errors, self._interpolate(self._lattice, candidates), strict=True)
        ]
        self._seen = np.concatenate([self._seen, candidates])
        self._log_ratio = np.concatenate([self._log_ratio, ratio])
        self._distance = np.concatenate([self._distance, self._from_sources(candidates)])
        return float(np.count_nonzero(predicted ^ true) / np.count_nonzero(predicted | true))

    def _predict_areas(self) -> BoolArray:
        problem, grid = self._problem, self._problem.grid
        areas = np.zeros((grid.valid.size, grid.window, grid.window), dtype=bool)
        chosen = np.flatnonzero(grid.valid & problem.region)
        # A row of candidates at a time, so that the errors stay in the processor's cache.
        for part in np.split(np.arange(len(chosen)), np.arange(128, len(chosen), 128)):
            errors = self._interpolate(self._corrected, chosen[part])
            areas[chosen[part]] = errors <= problem.threshold_px
        areas[chosen, grid.reach, grid.reach] = True
        return areas

    def _interpolate(self, lattice: Float32Array, candidates: Int64Array) -> Float32Array:
        """Return errors of candidates (N) between those of the lattice, (N, K, K) px."""
        row, col = self._problem.grid.row_col(candidates)
        top, bottom, down = _between(self._rows, row)
        left, right, across = _between(self._cols, col)
        down, across = down[:, None, None], across[:, None, None]
        errors = lattice[top, left] * ((1 - down) * (1 - across))
        errors += lattice[top, right] * ((1 - down) * across)
        errors += lattice[bottom, left] * (down * (1 - across))
        errors += lattice[bottom, right] * (down * across)
        return np.asarray(errors, dtype=np.float32)

    def _correction(self, candidates: Int64Array) -> Float64Array:
        """Return the logarithm of true over predicted errors to expect at candidates (N)."""
        grid = self._problem.grid
        weight = np.exp(-(grid.apart(candidates, self._seen) ** 2) / (2.0 * grid.reach**2))
        slope = weight @ (self._distance * self._log_ratio)
        slope /= weight @ self._distance**2 + _PRIOR_VIEWS * grid.reach**2
        return np.asarray(slope * self._from_sources(candidates), dtype=np.float64)

    def _from_sources(self, candidates: Int64Array) -> Float64Array:
        """Return distances of candidates (N) from the nearest view the prediction went by."""
        if not len(self._sources):
            return np.zeros(len(candidates))
        apart = self._problem.grid.apart(candidates, self._sources)
        return np.asarray(apart.min(axis=1), dtype=np.float64)


def _between(marks: Int64Array, value: Int64Array) -> tuple[Int64Array, Int64Array, Float32Array]:
    """Return the marks on either side of values and the share of the way from one to the other."""
    lower = np.clip(np.searchsorted(marks, value, side="right") - 1, 0, max(len(marks) - 2, 0))
    upper = np.minimum(lower + 1, len(marks) - 1)
    gap = np.maximum(marks[upper] - marks[lower], 1)
    return lower, upper, ((value - marks[lower]) / gap).astype(np.float32)


def _log_ratio(true: Float32Array, predicted: Float32Array, threshold_px: float) -> float:
    """Return the median logarithm of true over predicted error about the rim of an area."""
    near = (true > 0.3 * threshold_px) & (true < 3.0 * threshold_px)
    near &= (predicted > 0.3 * threshold_px) & (predicted < 3.0 * threshold_px)
    return float(np.median(np.log(true[near] / predicted[near]))) if near.any() else 0.0

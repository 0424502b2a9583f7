"""What is known of tolerance areas on real terrain before a view is rendered."""

from collections.abc import Callable

import numpy as np

from skyline.arrays import Float32Array, Int64Array
from skyline.camera import HEADINGS
from skyline.paper.candidates import CandidateMap
from skyline.paper.prediction import predict
from skyline.skylines import Views

Measure = Callable[[Views], Float32Array]
"""Reprojection errors of views over their neighbourhoods: (N, K, K) px, rows southward.

`inf` where a view says nothing; the view's own cell is 0.
"""

_PREDICTED_AT_ONCE = 256

_BELIEVED_PX = (0.05, 12.0)
"""Errors beyond are clipped before they are averaged: what is wrong is not a matter of degree."""

_FAR_PX = np.float32(30.0)


class InterpolatedModel:
    """Interpolates errors between the views rendered in one heading, two ways at once.

    Of the nearest views the inverse errors are averaged, weighted by inverse distance: how far one
    can go for one pixel. So a location that one view says nothing about does not spoil the others.
    That knows the shape of areas, but little of the candidate itself. Every view that a location
    is in reach of, though, says how fast the skyline changes on the way to it, px per candidate;
    an error is also this rate, the mean of its two ends, times the distance. The geometric mean of
    both is predicted: on Davos it picks areas that need a tenth fewer renderings than the first
    alone.
    """

    def __init__(self, candidates: CandidateMap) -> None:
        self._grid = candidates.grid
        window, reach = candidates.grid.window, candidates.grid.reach
        self._viewpoints = np.zeros(0, dtype=np.int64)
        self._inverse = np.zeros((0, window, window), dtype=np.float32)
        step = np.arange(-reach, reach + 1)
        self._apart = np.hypot(step[:, None], step).astype(np.float32)
        padded = np.pad(candidates.grid.valid, reach).shape
        self._weight, self._log_rate = np.zeros(padded), np.zeros(padded)

    def learn(self, candidates: Int64Array, views: Views, errors: Float32Array) -> None:
        """Add views rendered at candidates (N) and their errors (N, K, K)."""
        with np.errstate(divide="ignore"):
            inverse = np.float32(1.0) / errors
        self._inverse = np.concatenate([self._inverse, inverse])
        self._viewpoints = np.concatenate([self._viewpoints, candidates])
        apart = np.maximum(self._apart, 0.5)
        weight = (self._apart > 0.0) / apart
        log_rate = np.log(np.clip(errors, *_BELIEVED_PX) / apart) * weight
        weights, log_rates = self._grid.windows(self._weight), self._grid.windows(self._log_rate)
        for row, col, one in zip(*self._grid.row_col(candidates), log_rate, strict=True):
            weights[row, col] += weight
            log_rates[row, col] += one

    def predict_errors(self, candidates: Int64Array) -> Float32Array:
        """Return predicted reprojection errors of views at candidates (N), (N, K, K) px."""
        inverse = self._grid.interpolated(candidates, self._viewpoints, self._inverse)
        with np.errstate(divide="ignore"):
            by_shape = np.float32(1.0) / inverse
        by_rate = self._by_rate(candidates)
        mean = np.sqrt(np.minimum(by_shape, _FAR_PX) * by_rate)
        return np.where(np.isnan(mean), by_shape, mean).astype(np.float32)

    def _by_rate(self, candidates: Int64Array) -> Float32Array:
        """Return errors (N, K, K) by the rates at both ends, NaN where no view reaches one."""
        reach = self._grid.reach
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = np.exp(self._log_rate / self._weight).astype(np.float32)
        windows = self._grid.windows(rate)[self._grid.row_col(candidates)]
        return 0.5 * (windows + windows[:, reach, reach][:, None, None]) * self._apart


class PredictedModel:
    """Measures views predicted from the nearest view rendered in one heading.

    ``archive`` holds the views rendered so far by candidate and heading. The models of all headings
    share it: what was rendered in other headings shows what enters a predicted view at its sides.
    """

    def __init__(
        self,
        candidates: CandidateMap,
        heading: int,
        measure: Measure,
        archive: dict[tuple[int, int], Views],
    ) -> None:
        self._candidates, self._heading = candidates, heading
        self._measure, self._archive = measure, archive
        self._viewpoints = np.zeros(0, dtype=np.int64)

    def learn(self, candidates: Int64Array, views: Views, errors: Float32Array) -> None:
        """Add views rendered at candidates (N)."""
        self._viewpoints = np.concatenate([self._viewpoints, candidates])
        for row, candidate in enumerate(candidates.tolist()):
            self._archive[candidate, self._heading] = views[row : row + 1]

    def predict_errors(self, candidates: Int64Array) -> Float32Array:
        """Return predicted reprojection errors of views at candidates (N), (N, K, K) px."""
        chosen, _ = self._candidates.grid.nearest(candidates, self._viewpoints, 1)
        source = self._viewpoints[chosen[:, 0]]
        window = self._candidates.grid.window
        errors = np.empty((len(candidates), window, window), dtype=np.float32)
        # Neighbours share their sources, so that few stored views are gathered at a time.
        order = np.argsort(source, kind="stable")
        for start in range(0, len(order), _PREDICTED_AT_ONCE):
            part = order[start : start + _PREDICTED_AT_ONCE]
            targets = self._candidates.viewpoints(candidates[part])
            errors[part] = self._measure(predict(*self._stored(source[part]), targets))
        return errors

    def _stored(self, viewpoints: Int64Array) -> tuple[Views, Int64Array]:
        """Return the views rendered at viewpoints (N), and the row of each one's own heading."""
        places = np.unique(viewpoints).tolist()
        keys = [(place, heading) for place in places for heading in HEADINGS]
        keys = [key for key in keys if key in self._archive]
        row = {key: number for number, key in enumerate(keys)}
        rows = np.array([row[place, self._heading] for place in viewpoints.tolist()])
        return Views.concatenate([self._archive[key] for key in keys]), rows

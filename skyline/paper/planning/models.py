"""What is known of tolerance areas on real terrain before a view is rendered."""

from collections.abc import Callable

import numpy as np

from skyline.arrays import Float32Array, Int64Array
from skyline.paper.planning.candidates import CandidateMap
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

Measure = Callable[[Views], Float32Array]
"""Reprojection errors of views over their neighbourhoods: (N, K, K) px, rows southward.

`inf` where a view says nothing; the view's own cell is 0.
"""

Predict = Callable[[Views, Int64Array, Viewpoints], Views]
"""Views predicted at viewpoints (M), each from one of the stored views (M indices)."""

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
        window = self._grid.window
        for row, col, one in zip(*self._grid.row_col(candidates), log_rate, strict=True):
            place = slice(row, row + window), slice(col, col + window)
            self._weight[place] += weight
            self._log_rate[place] += one

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
        reach, window = self._grid.reach, self._grid.window
        with np.errstate(invalid="ignore", divide="ignore"):
            rate = np.exp(self._log_rate / self._weight).astype(np.float32)
        row, col = self._grid.row_col(candidates)
        windows = np.lib.stride_tricks.sliding_window_view(rate, (window, window))[row, col]
        return 0.5 * (windows + windows[:, reach, reach][:, None, None]) * self._apart


class PredictedModel:
    """Measures views predicted from the nearest view rendered in one heading.

    ``archive`` holds the views rendered in all headings.
    """

    def __init__(
        self,
        candidates: CandidateMap,
        heading: int,
        predict: Predict,
        measure: Measure,
        archive: "Archive",
    ) -> None:
        self._candidates = candidates
        self._heading = heading
        self._predict = predict
        self._measure = measure
        self._archive = archive
        self._viewpoints = np.zeros(0, dtype=np.int64)

    def learn(self, candidates: Int64Array, views: Views, errors: Float32Array) -> None:
        """Add views rendered at candidates (N)."""
        self._viewpoints = np.concatenate([self._viewpoints, candidates])

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
            stored, rows = self._archive.at(source[part], self._heading)
            targets = self._candidates.viewpoints(candidates[part])
            errors[part] = self._measure(self._predict(stored, rows, targets))
        return errors


class Archive:
    """Rendered views by candidate and heading, for predictions to start from."""

    def __init__(self) -> None:
        self._views: dict[tuple[int, int], Views] = {}

    def add(self, candidates: Int64Array, views: Views) -> None:
        """Add views rendered at candidates (N)."""
        for row, key in enumerate(zip(candidates.tolist(), views.heading.tolist(), strict=True)):
            self._views[key] = views[row : row + 1]

    def at(self, candidates: Int64Array, heading: int) -> tuple[Views, Int64Array]:
        """Return views and, for each candidate (N), the row of its view in a heading.

        The other headings rendered there come along: they show what enters at the sides.
        """
        places, place_of = np.unique(candidates, return_inverse=True)
        parts: list[Views] = []
        row_of = np.zeros(len(places), dtype=np.int64)
        for place, candidate in enumerate(places.tolist()):
            for other in range(4):
                view = self._views.get((candidate, other))
                if view is not None:
                    if other == heading:
                        row_of[place] = len(parts)
                    parts.append(view)
        return Views.concatenate(parts), row_of[place_of]

"""Tolerance areas: where around a view its skyline still serves (paper 4.2)."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError
from skyline.paper.reprojection import AFFINE_MEAN, displacements_m
from skyline.prediction import Predictor
from skyline.terrain.heightfield import Ground
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M
from skyline.views import Views

_CAP = np.float32(4.0)
"""Errors above this many thresholds are all alike; a cap lets them be interpolated."""

_DOUBT = (0.5, 2.0)
"""Interpolated errors between these multiples of the threshold are not to be relied on."""


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """The locations around a view that are asked whether its skyline serves them.

    Attributes
    ----------
    size : int
        K: rows and columns of locations; 10 in the paper. The view is at [K // 2, K // 2].
    spacing_m : float
        Distance between neighbouring locations.
    """

    size: int = 10
    spacing_m: float = 30.0

    def __post_init__(self) -> None:
        if not 1 <= self.size <= 1001:
            raise InputError(
                f"neighbourhood is {self.size} locations wide; expected 1 to 1001 (the paper "
                "takes 10)"
            )
        if not (np.isfinite(self.spacing_m) and self.spacing_m > 0.0):
            raise InputError(
                f"neighbourhood has a spacing of {self.spacing_m} m; expected a positive number"
            )

    @property
    def centre(self) -> int:
        """Row and column of the view itself."""
        return self.size // 2

    def offsets_m(self) -> tuple[Float64Array, Float64Array]:
        """Return east and north of each location from the view, both (K, K).

        Row 0 is the northernmost, column 0 the westernmost.
        """
        steps = (np.arange(self.size) - self.centre) * self.spacing_m
        east, south = np.meshgrid(steps, steps)
        return east, -south


@dataclass(frozen=True, slots=True)
class ToleranceMeter:
    """Measures tolerance areas of views; a call returns `errors_px`.

    Attributes
    ----------
    ground : callable
        Heights at map coordinates: `HeightField.height_at`.
    neighbourhood : Neighbourhood
    predictor : Predictor
        The paper's by default.
    eye_height_m : float
        Of the eyes at the other locations, above the ground.
    threshold_px : float, optional
        The threshold that areas are measured for. Where it is given, every second location is
        computed in both directions, those between are interpolated, and computed where that
        leaves them in doubt: little more than half the work, and 98 of 100 locations inside stay.
    """

    ground: Ground
    neighbourhood: Neighbourhood = Neighbourhood()
    predictor: Predictor = AFFINE_MEAN
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    threshold_px: float | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.eye_height_m) and self.eye_height_m >= 0.0):
            raise InputError(f"eye height is {self.eye_height_m} m; expected at least 0")

    def __call__(self, views: Views) -> Float32Array:
        """Return `errors_px`."""
        return self.errors_px(views)

    def errors_px(self, views: Views) -> Float32Array:
        """Return the reprojection errors of the neighbourhoods of N views.

        Returns
        -------
        (N, K, K) float32
            In px; row 0 is the northernmost, column 0 the westernmost, whatever the heading. inf
            off the map, on holes and where the predictor has no answer; 0 at the view itself.

        Raises
        ------
        InputError
            Views without the shells that the predictor needs.
        """
        size, centre = self.neighbourhood.size, self.neighbourhood.centre
        east, north = (offset.ravel() for offset in self.neighbourhood.offsets_m())
        easting = views.easting_m[:, np.newaxis] + east
        northing = views.northing_m[:, np.newaxis] + north
        eye_elevation = self.ground(easting, northing) + self.eye_height_m
        moved = displacements_m(views, easting, northing, eye_elevation)
        if self.threshold_px is None:
            errors = self.predictor.errors_px(views, moved).reshape(len(views), size, size)
        else:
            errors = self._sparsely(views, moved, self.threshold_px)
        errors[:, centre, centre] = 0.0
        return errors

    def _sparsely(self, views: Views, moved: Float64Array, threshold_px: float) -> Float32Array:
        """Return errors (N, K, K), computed only where interpolating leaves doubt."""
        size, centre = self.neighbourhood.size, self.neighbourhood.centre
        even = np.arange(size) % 2 == centre % 2
        even[[0, -1]] = True
        wanted = even[:, np.newaxis] & even
        wanted[centre - 1 : centre + 2, centre - 1 : centre + 2] = True
        known = np.broadcast_to(wanted, (len(views), size, size))
        errors = self._computed(views, moved, known, threshold_px)
        between = _fill_in(np.minimum(errors, _CAP * threshold_px), even)
        there = np.isfinite(moved).all(axis=2).reshape(known.shape)
        between = np.where(there, between, np.float32(np.inf))
        doubt = (between > _DOUBT[0] * threshold_px) & (between < _DOUBT[1] * threshold_px) & ~known
        errors = np.where(known, errors, between)
        return np.where(doubt, self._computed(views, moved, doubt, threshold_px), errors)

    def _computed(
        self, views: Views, moved: Float64Array, wanted: BoolArray, threshold_px: float
    ) -> Float32Array:
        """Return errors (N, K, K) where wanted, inf elsewhere."""
        asked = np.where(wanted.reshape(len(views), -1, 1), moved, np.nan)
        return self.predictor.errors_px(views, asked, threshold_px).reshape(wanted.shape)

    def areas(self, views: Views, threshold_px: float) -> BoolArray:
        """Return the tolerance areas (N, K, K) bool: where the error is within a threshold.

        Raises
        ------
        InputError
            A threshold that is not above 0.
        """
        if not threshold_px > 0.0:
            raise InputError(
                f"threshold is {threshold_px} px; expected above 0 (the measurements use 3)"
            )
        return self.errors_px(views) <= threshold_px


def _fill_in(errors: Float32Array, known: BoolArray) -> Float32Array:
    """Interpolate windows (N, K, K) linearly between their known rows and columns (K)."""
    for axis in (1, 2):
        before, after = np.roll(errors, 1, axis), np.roll(errors, -1, axis)
        own = np.expand_dims(known, (0, 3 - axis))
        errors = np.where(own, errors, np.float32(0.5) * (before + after))
    return errors

"""Tolerance areas: where around a view its skyline still serves (paper 4.2)."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import Float32Array, Float64Array
from skyline.errors import InputError
from skyline.paper.planning.reprojection import AFFINE_MEAN, Reprojection, displacements_m
from skyline.terrain.heightfield import Ground
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M
from skyline.views import Views


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """The locations around a view that are asked whether its skyline serves them."""

    size: int = 10
    """K: rows and columns of locations; 10 in the paper. The view is at [K // 2, K // 2]."""
    spacing_m: float = 30.0
    """Distance between neighbouring locations."""

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
    """Measures how far around views their skylines serve: a call returns reprojection errors."""

    ground: Ground
    """Heights at map coordinates: `HeightField.height_at`."""
    neighbourhood: Neighbourhood = Neighbourhood()
    predictor: Reprojection = AFFINE_MEAN
    """The paper's by default."""
    eye_height_m: float = DEFAULT_EYE_HEIGHT_M
    """Of the eyes at the other locations, above the ground."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.eye_height_m) and self.eye_height_m >= 0.0):
            raise InputError(f"eye height is {self.eye_height_m} m; expected at least 0")

    def __call__(self, views: Views) -> Float32Array:
        """Return the reprojection errors of the neighbourhoods of N views.

        Returns
        -------
        (N, K, K) float32
            In px; row 0 is the northernmost, column 0 the westernmost, whatever the heading. inf
            off the map, on holes and where the predictor has no answer; 0 at the view itself.
        """
        size, centre = self.neighbourhood.size, self.neighbourhood.centre
        east, north = (offset.ravel() for offset in self.neighbourhood.offsets_m())
        easting = views.easting_m[:, np.newaxis] + east
        northing = views.northing_m[:, np.newaxis] + north
        eye_elevation = self.ground(easting, northing) + self.eye_height_m
        moved = displacements_m(views, easting, northing, eye_elevation)
        errors = self.predictor.errors_px(views, moved).reshape(len(views), size, size)
        errors[:, centre, centre] = 0.0
        return errors

"""Where viewpoints may stand on real terrain: candidates on a dense grid of the map."""

from dataclasses import dataclass

import numpy as np

from skyline.arrays import BoolArray, Float64Array, Int64Array
from skyline.errors import InputError
from skyline.geodesy import Rectangle
from skyline.paper.coverage import CandidateGrid
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints, stand_on

_MOST_CANDIDATES = 20_000_000


@dataclass(frozen=True, slots=True)
class Spacing:
    """Distances between viewpoints, metres.

    Raises `InputError` for distances that are not positive or do not fit each other.
    """

    coarse_m: float = 1000.0
    """Of the grid that is rendered to begin with; a whole multiple of ``candidate_m``."""
    candidate_m: float = 50.0
    """Of the candidates."""
    reach_m: float = 300.0
    """How far a tolerance area may extend from its view."""

    def __post_init__(self) -> None:
        for name, value in (("coarse", self.coarse_m), ("candidate", self.candidate_m)):
            if not 0.0 < value < np.inf:
                raise InputError(
                    f"{name} spacing is {value} m; expected a positive number of metres"
                )
        if not self.candidate_m <= self.reach_m < np.inf:
            raise InputError(
                f"reach is {self.reach_m} m; expected at least the candidates' {self.candidate_m} m"
            )
        if abs(self.coarse_m / self.candidate_m - self.stride) > 1e-9 * self.stride:
            raise InputError(
                f"spacing of {self.coarse_m} m is no whole multiple of the candidates' "
                f"{self.candidate_m} m; choose one that is, for example "
                f"{self.stride * self.candidate_m} m"
            )

    @property
    def stride(self) -> int:
        """Candidates from one viewpoint of the coarse grid to the next."""
        return max(1, round(self.coarse_m / self.candidate_m))


@dataclass(frozen=True, slots=True, eq=False)
class CandidateMap:
    """Candidates at whole multiples of their spacing, in the frame of a field."""

    field: HeightField
    grid: CandidateGrid
    """Valid where an eye can stand off the holes and off the map's border."""
    easting_m: Float64Array
    """(cols,) float64."""
    northing_m: Float64Array
    """(rows,) float64. Descending."""
    square: Int64Array
    """(rows, cols) int64. A number for each square of the coarse grid that candidates lie in."""
    coarse: Int64Array
    """(N,) int64. The valid candidates on the coarse grid."""

    def viewpoints(self, candidates: Int64Array) -> Viewpoints:
        """Return viewpoints at candidates (N)."""
        row, col = self.grid.row_col(candidates)
        return stand_on(self.field, easting_m=self.easting_m[col], northing_m=self.northing_m[row])


def lay_out(
    field: HeightField,
    spacing: Spacing,
    bounds_m: Rectangle | None = None,
) -> CandidateMap:
    """Lay candidates over an area.

    Raises `InputError` for a spacing larger than the area, or an area wholly in holes.
    """
    west, south, east, north = bounds_m or field.bounds_m
    if spacing.coarse_m > max(east - west, north - south):
        raise InputError(
            f"spacing of {spacing.coarse_m:g} m is larger than the area of {east - west:.0f} x "
            f"{north - south:.0f} m; choose a smaller spacing or a larger area"
        )
    apart = spacing.candidate_m
    col = np.arange(np.ceil(west / apart), np.floor(east / apart) + 1.0)
    row = np.arange(np.floor(north / apart), np.ceil(south / apart) - 1.0, -1.0)
    if len(row) * len(col) > _MOST_CANDIDATES:
        raise InputError(
            f"{len(row) * len(col)} candidates {apart:g} m apart are too many to plan at once; "
            "plan smaller bounds one after the other, or put the candidates further apart"
        )
    easting, northing = np.meshgrid(col * apart, row * apart)
    grid = CandidateGrid(_can_stand(field, easting, northing), int(spacing.reach_m // apart))
    stride = spacing.stride
    on_coarse = (row[:, None] % stride == 0) & (col % stride == 0) & grid.valid
    if not on_coarse.any():
        raise InputError(
            f"no viewpoint of the {spacing.coarse_m:g} m grid falls on the surface in easting "
            f"{west:.0f} to {east:.0f}, northing {south:.0f} to {north:.0f}; choose a smaller "
            "spacing or a larger area"
        )
    coarse = np.flatnonzero(on_coarse)
    # Ascending from south to north, and in a row from west to east.
    square = (row // stride)[:, None] * len(col) + col // stride
    return CandidateMap(field, grid, col * apart, row * apart, square.astype(np.int64), coarse)


def _can_stand(field: HeightField, easting: Float64Array, northing: Float64Array) -> BoolArray:
    """Return where the surface goes on for a sample to every side."""
    ground = field.height_at(easting_m=easting, northing_m=northing)
    for east, north in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        ground = ground + field.height_at(
            easting_m=easting + east * field.spacing_east_m,
            northing_m=northing + north * field.spacing_north_m,
        )
    return ~np.isnan(ground)

"""What the rims of the surface do to a skyline: the flags of columns.

A column that crosses a rim from its bare side has looked over a hole. A column whose skyline is
no higher than the rim behind which the data end may hide more terrain, and is truncated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float64Array
from skyline.camera import columns_u, rotation
from skyline.geodesy import Curvature
from skyline.terrain.heightfield import HeightField
from skyline.terrain.triangles import Triangles
from skyline.terrain.viewpoints import Viewpoints


@dataclass(frozen=True, slots=True, eq=False)
class RimColumns:
    """What the columns of one view meet of the rims; arrays are (W,)."""

    border_tan: Float64Array
    """Greatest v over the rims behind which the data end; -inf where there is none."""
    over_hole: BoolArray
    """The column enters the surface again after having left it."""

    @property
    def meets_data(self) -> BoolArray:
        """Whether the column meets any surface: what is entered or stood on must end."""
        return np.isfinite(self.border_tan)


class RimFinder:
    """Projects the rims of a height field into views, in float64."""

    def __init__(self, field: HeightField, curvature: Curvature) -> None:
        self._curvature = curvature
        rims = Triangles.of(field.heights_m).rims()
        self._easting_m, self._northing_m = field.to_map(*rims)
        self._height_m = field.heights_m[rims].astype(np.float64)

    def columns(self, viewpoints: Viewpoints, index: int, heading: int, width: int) -> RimColumns:
        """Return what the W columns of one view meet."""
        east = self._easting_m - viewpoints.easting_m[index]
        north = self._northing_m - viewpoints.northing_m[index]
        up = self._height_m - viewpoints.eye_elevation_m[index]
        up -= self._curvature.drop_per_m2 * (east**2 + north**2)
        # The eye is left of the way along an edge, on its bare side, where this is positive.
        entered = np.diff(north)[:, 0] * east[:, 0] - np.diff(east)[:, 0] * north[:, 0] > 0.0
        ends = np.stack([east, up, north], axis=-1) @ rotation(heading).T
        edge, column = _columns_crossed(ends[..., 0], ends[..., 2], width)
        v = _ordinate(ends[edge], columns_u(width)[column])
        border_tan = np.full(width, -np.inf)
        leaving = ~entered[edge]
        np.maximum.at(border_tan, column[leaving], v[leaving])
        over_hole = np.zeros(width, dtype=bool)
        over_hole[column[~leaving & np.isfinite(v)]] = True
        return RimColumns(border_tan, over_hole)


def _columns_crossed(
    x: Float64Array, z: Float64Array, width: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs (edge, column) whose half-planes cross edges with ends (E, 2) ahead."""
    # An end behind the eye is moved along its edge to just before it.
    ahead = np.maximum(np.abs(z).max(axis=1, keepdims=True) * 1e-12, 1e-12)
    behind = z < ahead
    step = np.where(behind, (ahead - z) / _nonzero(z[:, ::-1] - z), 0.0)
    u = (x + step * (x[:, ::-1] - x)) / np.maximum(z + step * (z[:, ::-1] - z), ahead)
    position = np.clip(((u + 1.0) * width - 1.0) / 2.0, -1.0, width)
    first = np.ceil(position.min(axis=1) - 1e-9).astype(np.int64).clip(0)
    last = np.floor(position.max(axis=1) + 1e-9).astype(np.int64).clip(max=width - 1)
    count = np.where(behind.all(axis=1), 0, (last - first + 1).clip(0))
    edge = np.repeat(np.arange(len(x)), count)
    within = np.arange(count.sum()) - np.repeat(count.cumsum() - count, count)
    return edge, first[edge] + within


def _ordinate(ends: Float64Array, u: Float64Array) -> Float64Array:
    """Return v where half-planes at ``u`` cross edges with ``ends`` (M, 2, 3); -inf if behind."""
    offset = ends[..., 0] - u[:, np.newaxis] * ends[..., 2]
    share = np.clip(offset[:, 0] / _nonzero(offset[:, 0] - offset[:, 1]), 0.0, 1.0)
    crossing = ends[:, 0] + share[:, np.newaxis] * (ends[:, 1] - ends[:, 0])
    in_front = crossing[:, 2] > 0.0
    return np.where(in_front, crossing[:, 1] / np.where(in_front, crossing[:, 2], 1.0), -np.inf)


def _nonzero(value: Float64Array) -> Float64Array:
    return np.where(value == 0.0, 1.0, value)

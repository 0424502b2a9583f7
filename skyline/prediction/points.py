"""Points of stored skylines and their images at displaced eyes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.camera import columns_u
from skyline.prediction.affine import SAFE_DEPTH_SHARE
from skyline.views import Views

FloatArray = NDArray[np.floating]
Float64Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Projected:
    """P skyline points of N views and their images at C displaced eyes.

    Attributes
    ----------
    points_uv : (N, P, 2) float64
        Abscissa and ordinate in the view, NaN where it has no skyline.
    there_uv : (N, C, P, 2) float64
        The same from the displaced eyes; finite where usable.
    usable : (N, C, P) bool
        Whether a point is safely in front of the displaced eye and in its frame. A frame has
        sides, but neither top nor bottom.
    depth_m : (N, P) float64
    displacements_m : (N, C, 3) float64
    """

    points_uv: Float64Array
    there_uv: Float64Array
    usable: BoolArray
    depth_m: Float64Array
    displacements_m: Float64Array

    @classmethod
    def of(cls, views: Views, displacements_m: FloatArray, columns: int) -> "Projected":
        """Project at most so many evenly spread points of each view."""
        # Points of the skyline itself, not means: a mean of two ridges is on neither.
        stride = slice(0, None, -(-views.width // columns))
        u = columns_u(views.width)[stride]
        v = views.elevation_tan[:, stride].astype(np.float64)
        depth = views.depth_m[:, stride].astype(np.float64)
        moved = np.asarray(displacements_m, dtype=np.float64)
        right, up, forward = np.moveaxis(moved, 2, 0)[..., np.newaxis]
        z = depth[:, np.newaxis]
        ahead = z - forward
        usable = (ahead > SAFE_DEPTH_SHARE * z) & np.isfinite(v[:, np.newaxis] - up - right)
        ahead = np.where(usable, ahead, 1.0)
        abscissa = (u * z - right) / ahead
        ordinate = (v[:, np.newaxis] * z - up) / ahead
        usable &= np.abs(abscissa) <= 1.0
        points = np.stack([np.broadcast_to(u, v.shape), v], axis=-1)
        return cls(points, np.stack([abscissa, ordinate], axis=-1), usable, depth, moved)

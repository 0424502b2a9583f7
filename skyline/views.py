"""Views: arrays of many rendered skylines, and what derives from them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float64Array, FloatArray
from skyline.camera import columns_u, elevation_deg, rotation
from skyline.row_arrays import Rows

FLAG_TRUNCATED = 1
"""The skyline lies on the border of the data."""
FLAG_HOLE = 2
"""The column passes over a hole with data behind it."""
FLAG_NO_DATA = 4
"""The column meets no data; its values are NaN."""
FLAG_OUT_OF_IMAGE = 8
"""Depth images only: the skyline lies above the image's top or below its bottom."""


@dataclass(frozen=True, slots=True, eq=False)
class Views(Rows):
    """N views of W columns each.

    Attributes
    ----------
    easting_m, northing_m, eye_elevation_m : (N,) float64
        The eye, in the DEM's frame and above its datum.
    heading : (N,) uint8
        0, 1, 2, 3 = grid north, east, south, west.
    elevation_tan : (N, W) float32 (float64 from the oracle)
        Image-plane ordinate v of the skyline; NaN where a column meets no data.
    depth_m : (N, W) float32 (float64 from the oracle)
        Forward distance of the skyline; NaN where a column meets no data.
    flags : (N, W) uint8
        Bits `FLAG_TRUNCATED`, `FLAG_HOLE`, `FLAG_NO_DATA`, `FLAG_OUT_OF_IMAGE`.
    """

    easting_m: Float64Array
    northing_m: Float64Array
    eye_elevation_m: Float64Array
    heading: NDArray[np.uint8]
    elevation_tan: FloatArray
    depth_m: FloatArray
    flags: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.heading)

    @property
    def width(self) -> int:
        """Number of columns W."""
        return int(self.elevation_tan.shape[1])

    @classmethod
    def empty(cls, width: int) -> "Views":
        """Return zero views of the given width."""
        none = np.zeros(0)
        rows = np.zeros((0, width), dtype=np.float32)
        return cls(none, none, none, none.astype(np.uint8), rows, rows, rows.astype(np.uint8))

    def azimuth_deg(self) -> Float64Array:
        """Return grid azimuths of the columns, shape (N, W), degrees in [0, 360).

        They are `skyline.Frame.convergence_deg` less than azimuths from true north.
        """
        u = columns_u(self.width)
        turn_deg = 90.0 * self.heading[:, np.newaxis].astype(np.float64)
        return np.asarray((turn_deg + np.degrees(np.arctan(u))) % 360.0, dtype=np.float64)

    def elevation_deg(self) -> Float64Array:
        """Return elevation angles of the skyline, shape (N, W), degrees."""
        return elevation_deg(self.elevation_tan.astype(np.float64), columns_u(self.width))

    def skyline_points_m(self) -> Float64Array:
        """Return the skyline's 3-D points X_i, shape (N, W, 3): east, up, north minus the eye."""
        depth = self.depth_m.astype(np.float64)
        camera = np.stack(
            [columns_u(self.width) * depth, self.elevation_tan * depth, depth], axis=-1
        )
        turns = np.stack([rotation(heading) for heading in range(4)])[self.heading]
        return np.asarray(np.einsum("nwc,nck->nwk", camera, turns), dtype=np.float64)

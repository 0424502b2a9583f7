"""Tiles of shaded relief with contour lines, for the page's map.

A tile is a part of the Web Mercator map (EPSG:3857): 2**zoom tiles span the world, x counts from
the west, y from the north.
"""

import cv2
import numpy as np
from scipy import ndimage

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError
from skyline.geodesy.earth import EQUATOR_RADIUS_M
from skyline.report.relief import relief, tint_range_m
from skyline.terrain.dem import Dem, read_dem

_TILE_PX = 256
"""Pixels along a tile's side."""
_MAX_ZOOM = 20
_CONTOURS_M = (10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
"""Intervals of contour lines, as on printed maps."""


class ReliefTiles:
    """Draws tiles of one elevation model, from any thread."""

    def __init__(self, terrain: Dem) -> None:
        self._terrain = terrain = read_dem(terrain)
        step = max(1, max(terrain.rows, terrain.cols) // 512)
        self._range_m = tint_range_m(terrain.heights_m[::step, ::step])
        self.bounds_deg = terrain.box_deg
        """West, south, east and north of the model, degrees; west > east across the
        antimeridian."""

    def contours_m(self, zoom: int) -> float | None:
        """Return the contour lines' interval at a zoom; None without lines.

        Lines on a slope of 45 degrees lie at least five pixels apart.
        """
        _, south, _, north = self.bounds_deg
        around_m = 2.0 * np.pi * EQUATOR_RADIUS_M * np.cos(np.radians((south + north) / 2.0))
        least_m = 5.0 * around_m / (_TILE_PX * 2.0**zoom)
        return next((one for one in _CONTOURS_M if one >= least_m), None)

    def png(self, zoom: int, x: int, y: int) -> bytes:
        """Return a tile as PNG, transparent where there is no terrain.

        Raises
        ------
        InputError
            There is no such tile.
        """
        if not (0 <= zoom <= _MAX_ZOOM and 0 <= x < 2**zoom and 0 <= y < 2**zoom):
            raise InputError(
                f"tile {zoom}/{x}/{y}; expected a zoom of 0 to {_MAX_ZOOM}, x and y below 2**zoom"
            )
        mesh = 9
        step = (_TILE_PX + 2) / (mesh - 1)
        easting, northing = self._terrain.frame.from_lonlat(*_lonlat(zoom, x, y, mesh))
        across = np.hypot(np.diff(easting, axis=1), np.diff(northing, axis=1)).mean() / step
        pixel_m = float(across) if np.isfinite(across) else 1e6
        # Far from a frame's middle its projection may be undefined.
        known = (np.where(np.isfinite(at), at, -1e9) for at in (easting, northing))
        east, north = (
            ndimage.zoom(at, (_TILE_PX + 2) / mesh, order=1, mode="nearest") for at in known
        )
        heights_m = self._terrain.height_at(easting_m=east, northing_m=north).astype(np.float32)
        picture = relief(heights_m, pixel_m, self._range_m)[..., [2, 1, 0, 3]]
        interval_m = self.contours_m(zoom)
        if interval_m is not None:
            # Every fifth line is darker.
            for every_m, shade in ((interval_m, 0.75), (5.0 * interval_m, 0.55)):
                line = contours(heights_m, every_m)
                picture[line, :3] = shade * picture[line, :3]
        return bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1])


def _lonlat(zoom: int, x: int, y: int, mesh: int) -> tuple[Float64Array, Float64Array]:
    """Return longitude and latitude of a mesh (M, M) over a tile.

    The mesh reaches one pixel beyond each side. The projection is computed only at the mesh, and
    interpolated in between.
    """
    along = (np.linspace(-1.0, _TILE_PX, mesh) + 0.5) / _TILE_PX
    east, south = np.meshgrid((x + along) / 2.0**zoom, (y + along) / 2.0**zoom)
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1.0 - 2.0 * south))))
    return 360.0 * east - 180.0, lat


def contours(heights_m: Float32Array, interval_m: float) -> BoolArray:
    """Return the pixels (H, W) that contour lines cross.

    ``heights_m`` (H + 2, W + 2) are as for `relief`.
    """
    band = np.floor(heights_m / interval_m)
    inner = band[1:-1, 1:-1]
    # Where a neighbour is unknown, the difference is too, and no line is crossed.
    right, below = band[1:-1, 2:] - inner, band[2:, 1:-1] - inner
    return np.asarray((np.nan_to_num(right) != 0.0) | (np.nan_to_num(below) != 0.0))

"""Shaded relief: terrain lit from the north-west and tinted by height, also as tiles for viewers.

A tile is a part of the Web Mercator map (EPSG:3857): 2**zoom tiles span the world, x counts from
the west, y from the north.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, UInt8Array
from skyline.errors import InputError
from skyline.terrain.heightfield import HeightField

_TINTS = ("#7fa87a", "#a9bd8b", "#d3c79b", "#c4a983", "#b59f8d", "#d9d5d1", "#ffffff")
"""Colours of heights, low to high."""
_DARKEST = 0.35
"""Brightness of a slope facing away from the light, relative to level ground."""
TILE_PX = 256
MAX_ZOOM = 20
_MESH = 9
"""Points along a tile's side at which the projection is computed; between them it is
interpolated."""
_NOWHERE_M = -1e9
_STOPS = np.array([list(bytes.fromhex(tint[1:])) for tint in _TINTS])
_AT = np.linspace(0.0, len(_TINTS) - 1.0, 256)
_RGB = np.stack(
    [np.interp(_AT, range(len(_TINTS)), stop) for stop in _STOPS.T], axis=1, dtype=np.float32
)
"""Colours (256, 3) from the lowest height to the highest."""
_LIGHT = np.array([-0.5, 0.5, np.sqrt(0.5)], dtype=np.float32)
"""Direction to the light (east, north, up): from the north-west, halfway up."""


def relief(
    heights: Float32Array, east_m: float, north_m: float, range_m: tuple[float, float]
) -> UInt8Array:
    """Return shaded relief as RGBA (H, W, 4) uint8, transparent where there is no height.

    The heights (H + 2, W + 2), metres, are those of the picture's pixels and of the pixels one
    beyond; rows run south. ``range_m`` are the heights of the lowest and the highest tint.
    """
    east = (heights[1:-1, 2:] - heights[1:-1, :-2]) / np.float32(2.0 * east_m)
    north = (heights[:-2, 1:-1] - heights[2:, 1:-1]) / np.float32(2.0 * north_m)
    up = 1.0 / np.sqrt(1.0 + east**2 + north**2)
    lit = (_LIGHT[2] - _LIGHT[0] * east - _LIGHT[1] * north) * up
    inner, (low, high) = heights[1:-1, 1:-1], range_m
    known = np.isfinite(inner)
    share = np.clip((np.where(known, inner, low) - low) / (high - low), 0.0, 1.0)
    tinted = _RGB[np.rint(share * (len(_RGB) - 1)).astype(np.uint8)]
    shade = _DARKEST + (1.0 - _DARKEST) * np.clip(np.nan_to_num(lit, nan=0.7), 0.0, 1.0)
    picture = np.empty((*inner.shape, 4), dtype=np.uint8)
    picture[..., :3] = np.rint(tinted * shade[..., np.newaxis])
    picture[..., 3] = np.where(known, 255, 0)
    return picture


def tint_range_m(heights: NDArray[np.floating]) -> tuple[float, float]:
    """Return the heights of the lowest and the highest tint of terrain: all but its extremes."""
    low, high = np.nanpercentile(heights, [0.5, 99.5])
    return float(low), max(float(high), float(low) + 1.0)


class ReliefTiles:
    """Draws tiles of one elevation model, from any thread."""

    def __init__(self, terrain: HeightField) -> None:
        self._terrain = terrain
        step = max(1, max(terrain.rows, terrain.cols) // 512)
        self._range_m = tint_range_m(terrain.heights_m[::step, ::step])
        west, south, east, north = terrain.bounds_m
        self.bounds_deg = terrain.frame.box_deg(easting_m=[west, east], northing_m=[south, north])
        """West, south, east and north of the model, degrees; west > east across the
        antimeridian."""

    def png(self, zoom: int, x: int, y: int) -> bytes:
        """Return a tile as PNG, transparent where there is no terrain.

        Raises
        ------
        InputError
            There is no such tile.
        """
        if not (0 <= zoom <= MAX_ZOOM and 0 <= x < 2**zoom and 0 <= y < 2**zoom):
            raise InputError(
                f"tile {zoom}/{x}/{y}; expected a zoom of 0 to {MAX_ZOOM}, x and y below 2**zoom"
            )
        frame, step = self._terrain.frame, (TILE_PX + 2) / (_MESH - 1)
        easting, northing = frame.from_lonlat(*_lonlat(zoom, x, y))
        across = np.hypot(np.diff(easting, axis=1), np.diff(northing, axis=1)).mean() / step
        pixel_m = float(across) if np.isfinite(across) else 1e6
        # Far from a frame's middle its projection may be undefined.
        places = (np.where(np.isfinite(at), at, _NOWHERE_M) for at in (easting, northing))
        east, north = map(_on_pixels, places)
        heights = self._terrain.height_at(easting_m=east, northing_m=north).astype(np.float32)
        picture = relief(heights, pixel_m, pixel_m, self._range_m)[..., [2, 1, 0, 3]]
        return bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1])


def _lonlat(zoom: int, x: int, y: int) -> tuple[Float64Array, Float64Array]:
    """Return longitude and latitude (M, M) of a mesh over a tile with a border of one pixel."""
    along = (np.linspace(-1.0, TILE_PX, _MESH) + 0.5) / TILE_PX
    east, south = np.meshgrid((x + along) / 2.0**zoom, (y + along) / 2.0**zoom)
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1.0 - 2.0 * south))))
    return 360.0 * east - 180.0, lat


def _on_pixels(mesh: Float64Array) -> Float64Array:
    """Return values (T + 2, T + 2) at pixels, linearly interpolated from a mesh (M, M)."""
    position = np.linspace(0.0, _MESH - 1.0, TILE_PX + 2)
    weight = np.maximum(0.0, 1.0 - np.abs(position[:, np.newaxis] - np.arange(_MESH)))
    return np.asarray(weight @ mesh @ weight.T)

"""Shaded relief: terrain lit from the north-west and tinted by height, also as tiles for viewers.

A tile is a part of the Web Mercator map (EPSG:3857): 2**zoom tiles span the world, x counts from
the west, y from the north.
"""

import warnings

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
_NOWHERE = -1e6
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
        self._levels: list[Float32Array] = [np.asarray(terrain.heights_m, dtype=np.float32)]
        while min(self._levels[-1].shape) >= 4:
            self._levels.append(_halved(self._levels[-1]))
        coarse = max(0, int(np.log2(max(terrain.rows, terrain.cols) / 512.0)))
        self._range_m = tint_range_m(self._levels[min(coarse, len(self._levels) - 1)])
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
        heights, pixel_m = self._heights(zoom, x, y)
        picture = relief(heights, pixel_m, pixel_m, self._range_m)[..., [2, 1, 0, 3]]
        return bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 3])[1])

    def _heights(self, zoom: int, x: int, y: int) -> tuple[Float32Array, float]:
        """Return heights (T + 2, T + 2) at a tile's pixels and one beyond, and the pixel size."""
        lon, lat = _lonlat(zoom, x, y)
        easting, northing = self._terrain.frame.from_lonlat(lon, lat)
        row, col = self._terrain.to_grid(easting_m=easting, northing_m=northing)
        # Far from a frame's middle its projection may be undefined.
        row, col = (np.where(np.isfinite(at), at, _NOWHERE) for at in (row, col))
        step = (TILE_PX + 2) / (_MESH - 1)
        across = np.hypot(np.diff(easting, axis=1), np.diff(northing, axis=1)).mean() / step
        pixel_m = float(across) if np.isfinite(across) else 1e6
        level = int(np.log2(max(pixel_m / self._terrain.spacing_m, 1.0)))
        level = min(level, len(self._levels) - 1)
        rows, cols = (_on_pixels((at + 0.5) * 2.0**-level - 0.5) for at in (row, col))
        return _sampled(self._levels[level], rows, cols), pixel_m


def _lonlat(zoom: int, x: int, y: int) -> tuple[Float64Array, Float64Array]:
    """Return longitude and latitude (M, M) of a mesh over a tile with a border of one pixel."""
    along = (np.linspace(-1.0, TILE_PX, _MESH) + 0.5) / TILE_PX
    east, south = np.meshgrid((x + along) / 2.0**zoom, (y + along) / 2.0**zoom)
    lat = np.degrees(np.arctan(np.sinh(np.pi * (1.0 - 2.0 * south))))
    return 360.0 * east - 180.0, lat


def _on_pixels(mesh: Float64Array) -> Float32Array:
    """Return values (T + 2, T + 2) at pixels, linearly interpolated from a mesh (M, M)."""
    position = np.linspace(0.0, _MESH - 1.0, TILE_PX + 2)
    weight = np.maximum(0.0, 1.0 - np.abs(position[:, np.newaxis] - np.arange(_MESH)))
    return np.asarray(weight @ mesh @ weight.T, dtype=np.float32)


def _sampled(heights: Float32Array, rows: Float32Array, cols: Float32Array) -> Float32Array:
    """Return heights at fractional rows and columns, NaN outside the model."""
    (top, bottom), (left, right) = (
        np.clip([at.min() - 2, at.max() + 3], 0, length).astype(int).tolist()
        for at, length in zip((rows, cols), heights.shape, strict=True)
    )
    if bottom - top < 2 or right - left < 2:
        return np.full(rows.shape, np.nan, dtype=np.float32)
    part = np.ascontiguousarray(heights[top:bottom, left:right])
    return np.asarray(
        cv2.remap(
            part,
            cols - left,
            rows - top,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        ),
        dtype=np.float32,
    )


def _halved(heights: Float32Array) -> Float32Array:
    """Return the means of 2 by 2 samples, without unknown samples."""
    rows, cols = heights.shape[0] // 2 * 2, heights.shape[1] // 2 * 2
    blocks = heights[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # All four may be unknown.
        return np.asarray(np.nanmean(blocks, axis=(1, 3)), dtype=np.float32)

"""Photos laid on the ground: orthophotos, as Cloud-Optimized GeoTIFFs.

Each cell of a grid on the map takes its colours from the pixels that show it. If several photos
show a cell, the photo with the finest pixels there gives the colours.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.camera.camera import Camera
from skyline.errors import InputError, suffix_of
from skyline.files.disk import write_whole
from skyline.geodesy.cell_grid import CellGrid
from skyline.ground.ground_view import GroundErrors, GroundPoints, GroundView
from skyline.report.geotiff import GEOTIFFS, geotiff
from skyline.terrain.heightfield import HeightField


@dataclass(frozen=True, slots=True)
class OrthoSettings:
    """How far and how finely photos are laid on the ground."""

    most_cells: int = 25_000_000
    """A finer grid is made coarser."""
    coarsest: float = 5.0
    """Pixels that are longer on the ground than so many cells are left out."""
    samples: int = 4000
    """Pixels of a photo from which its detail is estimated."""
    levels: int = 5
    """Times that a photo is halved for cells larger than its pixels."""
    most_off: float = 0.5
    """A cell is hidden if the photo shows ground there that is nearer by more than so many
    cells."""
    reach: float = 2.0
    """Cells nearer to hidden ground than so many pixels, or cells where these are longer, are left
    out: their colours would mix with those beyond the edge. A pixel of a halved photo mixes pixels
    up to two of its own sides away."""


_SETTINGS = OrthoSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """A picture on a grid.

    Attributes
    ----------
    values : (rows, cols, C)
        The picture's values; 0 where nothing is seen.
    pixel_m : (rows, cols) float32
        Length of the picture's pixels on the ground, in the direction in which they are longest;
        NaN where nothing is seen.
    """

    values: NDArray[Any]
    pixel_m: Float32Array

    @property
    def is_seen(self) -> BoolArray:
        """(rows, cols) bool."""
        return np.isfinite(self.pixel_m)


def grid_of(views: Sequence[GroundView], resolution_m: float | None = None) -> CellGrid:
    """Return the grid that holds what cameras see.

    By default its cells are half as large as the median pixel is long on the ground, or larger.
    Raises `InputError` where no camera sees ground, and for a resolution that is too fine.
    """
    seen = [_detail(view) for view in views]
    position_m, length_m = (np.concatenate(part) for part in zip(*seen, strict=True))
    if not len(length_m):
        raise InputError("the photos show no ground of the DEM; check the poses and the DEM")
    cell_m = resolution_m or float(np.median(length_m)) / 2.0
    while True:
        near = length_m <= _SETTINGS.coarsest * cell_m
        if not near.any():
            raise InputError(
                f"the resolution is {cell_m:g} m, and all pixels are longer than "
                f"{_SETTINGS.coarsest * cell_m:g} m on the ground; give a coarser one, of about "
                f"{float(np.median(length_m)):.1g} m"
            )
        west, south = np.floor(position_m[near].min(axis=0) / cell_m - 1.0) * cell_m
        east, north = np.ceil(position_m[near].max(axis=0) / cell_m + 1.0) * cell_m
        rows, cols = round((north - south) / cell_m), round((east - west) / cell_m)
        if rows * cols <= _SETTINGS.most_cells:
            return CellGrid(float(west), float(north), cell_m, rows, cols)
        coarser_m = cell_m * math.sqrt(rows * cols / _SETTINGS.most_cells)
        if resolution_m is not None:
            raise InputError(
                f"the resolution is {resolution_m:g} m, which gives {rows} x {cols} cells; give "
                f"{coarser_m:.2g} m or more"
            )
        cell_m = coarser_m


def place_sd_m(views: Sequence[GroundView], grid: CellGrid) -> float:
    """Return the median standard error of places on a grid, metres."""
    errors_m = []
    for view in views:
        column_px, row_px = _sample(view.camera)
        near = _lengths_m(_exact(view, column_px, row_px)) <= _SETTINGS.coarsest * grid.cell_m
        errors_m.append(view.points(column_px[near], row_px[near]).error_m)
    return float(np.median(np.concatenate(errors_m)))


def _detail(view: GroundView) -> tuple[Float64Array, Float64Array]:
    """Return places (N, 2) and greatest ground lengths (N,) of some pixels."""
    points = _exact(view, *_sample(view.camera))
    points = points[~points.is_sky]
    return np.stack([points.easting_m, points.northing_m], axis=1), _lengths_m(points)


def _sample(camera: Camera) -> tuple[Float64Array, Float64Array]:
    """Return columns and rows (N,) of some pixels all over a photo."""
    step = max(1.0, math.sqrt(camera.width_px * camera.height_px / _SETTINGS.samples))
    row, column = np.mgrid[0 : camera.height_px : step, 0 : camera.width_px : step]
    return column.ravel().astype(np.float64), row.ravel().astype(np.float64)


def _exact(view: GroundView, column_px: Float64Array, row_px: Float64Array) -> GroundPoints:
    """Return the ground of pixels, with pose and model taken as exact.

    The length of a pixel on the ground does not depend on how well they are known.
    """
    view = replace(view, covariance=np.zeros_like(view.covariance))
    return view.points(column_px, row_px, GroundErrors(pixel_sd_px=0.0, height_sd_m=0.0))


def _lengths_m(points: GroundPoints) -> Float64Array:
    """Return the greatest lengths (N,) of pixels; infinite for sky."""
    lengths_m = np.full(len(points), np.inf)
    by_pixel = points.by_pixel[~points.is_sky, :2]
    lengths_m[~points.is_sky] = np.linalg.svd(by_pixel, compute_uv=False)[:, 0]
    return lengths_m


def lay(view: GroundView, picture: NDArray[Any], grid: CellGrid) -> Laid:
    """Lay a camera's picture (H, W, C) on a grid."""
    shape = grid.shape
    east_m, north_m = np.meshgrid(grid.eastings_m(), grid.northings_m())
    found = view.pixels(east_m.ravel(), north_m.ravel(), _SETTINGS.most_off * grid.cell_m)
    column, row = (one.reshape(shape) for one in (found.column_px, found.row_px))
    height_px, width_px = picture.shape[:2]
    longest_m = _pixel_lengths_m(column, row, grid.cell_m)
    with np.errstate(invalid="ignore"):
        seen = longest_m <= _SETTINGS.coarsest * grid.cell_m
        mixed = _SETTINGS.reach * np.maximum(longest_m / grid.cell_m, 1.0)
        seen &= _from_hidden(found.is_hidden.reshape(shape)) > mixed
        seen &= (column >= 0.0) & (column <= width_px - 1.0)
        seen &= (row >= 0.0) & (row <= height_px - 1.0)
    values = np.zeros((*shape, picture.shape[2]), dtype=picture.dtype)
    with np.errstate(divide="ignore", invalid="ignore"):
        level = np.nan_to_num(np.log2(grid.cell_m / longest_m))
    level = np.clip(np.floor(level), 0, _SETTINGS.levels).astype(int)
    halved = picture
    for number in range(int(level[seen].max(initial=0)) + 1):
        if number:
            halved = cv2.pyrDown(halved)
        chosen = seen & (level == number)
        if chosen.any():
            # Pixel k of a halved picture lies over pixel 2 k.
            at = [(one[chosen] / 2**number).astype(np.float32) for one in (column, row)]
            values[chosen] = _sampled(halved, *at)
    return Laid(values, np.where(seen, longest_m, np.nan).astype(np.float32))


def _from_hidden(is_hidden: BoolArray) -> Float32Array:
    """Return the distance to the nearest hidden cell, in cells, or infinity."""
    if not is_hidden.any():
        return np.full(is_hidden.shape, np.inf, dtype=np.float32)
    shown = (~is_hidden).astype(np.uint8)
    return np.asarray(cv2.distanceTransform(shown, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def _sampled(picture: NDArray[Any], column: Float32Array, row: Float32Array) -> NDArray[Any]:
    """Return bilinear values (N, C) of a picture."""
    width = 4096  # OpenCV's maps have at most 32767 rows and columns.
    count = -(-len(column) // width)
    maps = [np.resize(one, (count, width)) for one in (column, row)]
    parts = [
        cv2.remap(
            picture,
            maps[0][begin : begin + width],
            maps[1][begin : begin + width],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for begin in range(0, count, width)
    ]
    found = np.concatenate(parts).reshape(count * width, -1)
    return np.asarray(found[: len(column)])


def _pixel_lengths_m(column: Float64Array, row: Float64Array, cell_m: float) -> Float64Array:
    """Return the greatest length of pixels on the ground, by cell."""
    if min(column.shape) < 2:
        return np.full(column.shape, np.nan)
    a, b = np.gradient(column, cell_m)
    c, d = np.gradient(row, cell_m)
    # The least singular value of the pixels per metre.
    total, product = a**2 + b**2 + c**2 + d**2, np.abs(a * d - b * c)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.maximum(total**2 - 4.0 * product**2, 0.0))
        return np.asarray(np.sqrt((total + root) / 2.0) / product)


def mosaic(laid: Sequence[Laid]) -> Laid:
    """Join pictures on one grid; the finest pixels fill each cell."""
    best = laid[0]
    for other in laid[1:]:
        finer = other.is_seen & ~(best.pixel_m <= other.pixel_m)
        best = Laid(
            np.where(finer[..., np.newaxis], other.values, best.values),
            np.where(finer, other.pixel_m, best.pixel_m),
        )
    return best


def write_ortho(path: Path, laid: Laid, grid: CellGrid, terrain: HeightField) -> None:
    """Write red, green, blue and alpha as a Cloud-Optimized GeoTIFF.

    Raises `InputError` for another suffix, and where the file cannot be written.
    """
    alpha = np.where(laid.is_seen, 255, 0).astype(np.uint8)
    bands = np.concatenate([laid.values, alpha[..., np.newaxis]], axis=2)
    _write(path, np.moveaxis(bands, -1, 0), grid, terrain, ("red", "green", "blue", "alpha"))


def write_pixel_lengths(path: Path, laid: Laid, grid: CellGrid, terrain: HeightField) -> None:
    """Write pixels' lengths on the ground, metres, as `write_ortho` does."""
    _write(path, laid.pixel_m[np.newaxis], grid, terrain, ("gray",), nodata=np.nan)


def _write(
    path: Path,
    bands: NDArray[Any],
    grid: CellGrid,
    terrain: HeightField,
    colours: Sequence[str],
    **options: Any,
) -> None:
    suffix_of(path, GEOTIFFS)
    write_whole(path, geotiff(bands, grid, terrain.frame, colours=colours, **options))

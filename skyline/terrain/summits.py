"""Local maxima of a DEM, and the samples of a warped grid that take their heights."""

import numpy as np
from pyproj import Transformer

from skyline.arrays import Float32Array, Float64Array, Int64Array
from skyline.terrain.cleaning import strips
from skyline.terrain.tiles import Grid

_AROUND = [(down, right) for down in range(3) for right in range(3) if (down, right) != (1, 1)]


def local_maxima(heights_m: Float32Array) -> tuple[Int64Array, Int64Array]:
    """Return row and column (n,), in order, of the samples that no neighbour of eight overtops.

    All eight are known, so a sample at the border or beside a hole (NaN) is none of them; nor is
    one in the midst of a level place.
    """
    found = []
    for strip in strips(heights_m):
        top = max(strip.start - 1, 0)
        block = heights_m[top : strip.stop + 1]
        own = block[1:-1, 1:-1]
        # Most fall out by the four beside them; only what is left is compared with all eight.
        likely = (own >= block[:-2, 1:-1]) & (own >= block[2:, 1:-1])
        likely &= (own >= block[1:-1, :-2]) & (own >= block[1:-1, 2:])
        row, col = np.nonzero(likely)
        height = own[row, col]
        around = np.stack([block[row + down, col + right] for down, right in _AROUND])
        summit = (around <= height).all(axis=0) & (around < height).any(axis=0)
        found.append((row[summit] + top + 1, col[summit] + 1))
    row, col = (np.concatenate(part) for part in zip(*found, strict=True))
    return row, col


def keep_summits(
    warped_m: Float32Array,
    target: Grid,
    heights_m: Float32Array,
    grid: Grid,
    to_target: Transformer,
) -> None:
    """Lift, in place, the sample of a warped grid nearest to each local maximum to its height.

    The nearest is looked for among the samples at the corners of the cell that the maximum lies
    in, and holes stay holes. So every summit is as high as it was, at most 0.71 of the target's
    spacing aside, and nothing is higher than some sample of the source.

    Parameters
    ----------
    warped_m : (rows, cols) float32
        On ``target``.
    heights_m : (rows, cols) float32
        The source's, on ``grid``.
    to_target : Transformer
        From the source's CRS to the target's.
    """
    row, col = local_maxima(heights_m)
    easting, northing = to_target.transform(
        grid.west + col * grid.step_east, grid.north - row * grid.step_north
    )
    nearest = _nearest_known(
        warped_m,
        (target.north - northing) / target.step_north,
        (easting - target.west) / target.step_east,
    )
    np.maximum.at(warped_m.reshape(-1), nearest[nearest >= 0], heights_m[row, col][nearest >= 0])


def _nearest_known(heights_m: Float32Array, row: Float64Array, col: Float64Array) -> Int64Array:
    """Return flat indices of the nearest known corners of cells, -1 where there is none."""
    rows, cols = heights_m.shape
    top, left = np.floor(row).astype(np.int64), np.floor(col).astype(np.int64)
    nearest = np.full(row.shape, -1, dtype=np.int64)
    least = np.full(row.shape, np.inf)
    for corner_row in (top, top + 1):
        for corner_col in (left, left + 1):
            inside = (corner_row >= 0) & (corner_row < rows)
            inside &= (corner_col >= 0) & (corner_col < cols)
            at = np.where(inside, corner_row * cols + corner_col, 0)
            known = inside & ~np.isnan(heights_m.reshape(-1)[at])
            apart = np.where(known, (row - corner_row) ** 2 + (col - corner_col) ** 2, np.inf)
            nearest = np.where(apart < least, at, nearest)
            least = np.minimum(apart, least)
    return nearest

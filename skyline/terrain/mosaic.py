"""Tiles laid onto the one grid that they share."""

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from skyline.arrays import Float32Array
from skyline.errors import InputError
from skyline.terrain.tiles import Grid, Tile, full_turn, opened, read_into

MAX_SAMPLES = 1 << 31
"""The largest mosaic: 8 GiB of float32."""

GRID_TOLERANCE = 0.01
"""How far a tile's samples may lie off the grid of the first, in samples."""

AGREEMENT_M = 1.0
"""Neighbouring tiles may differ by this much where they overlap, from rounding to whole metres."""

_log = logging.getLogger(__name__)


def mosaic_grid(tiles: Sequence[Tile]) -> tuple[Grid, list[tuple[int, int]]]:
    """Return the common grid of tiles and the row and column each one's first sample has on it.

    Raises `InputError` for tiles of different CRS or spacing, off the first one's grid, or too far
    apart.
    """
    first = tiles[0]
    offsets = []
    for tile in tiles:
        grid = _nearest_turn(tile, first)
        _check_fits(tile, grid, first)
        row = (first.grid.north - grid.north) / first.grid.step_north
        col = (grid.west - first.grid.west) / first.grid.step_east
        if max(abs(row - round(row)), abs(col - round(col))) > GRID_TOLERANCE:
            raise InputError(
                f"{tile.source} lies {abs(row - round(row)):.2f} rows and "
                f"{abs(col - round(col)):.2f} columns off the grid of {first.source}; tiles must "
                "share one grid: merge them beforehand (gdalwarp) or give them one at a time"
            )
        offsets.append((round(row), round(col)))
    top, left = (min(values) for values in zip(*offsets, strict=True))
    offsets = [(row - top, col - left) for row, col in offsets]
    grid = replace(
        first.grid,
        west=first.grid.west + left * first.grid.step_east,
        north=first.grid.north - top * first.grid.step_north,
        rows=max(row + tile.grid.rows for (row, _), tile in zip(offsets, tiles, strict=True)),
        cols=max(col + tile.grid.cols for (_, col), tile in zip(offsets, tiles, strict=True)),
    )
    if grid.rows * grid.cols > MAX_SAMPLES:
        raise InputError(
            f"the DEM spans {grid.rows} x {grid.cols} samples, more than {MAX_SAMPLES}; give "
            "fewer or adjacent tiles, or a coarser DEM"
        )
    return grid, offsets


def read_mosaic(
    tiles: Sequence[Tile], grid: Grid, offsets: Sequence[tuple[int, int]]
) -> Float32Array:
    """Read tiles onto their common grid, in metres.

    NaN marks voids, -inf undeclared ones, +inf samples that no tile covers. Where tiles
    overlap, the first that has a height gives it; a warning says by how much they disagree if that
    is more than `AGREEMENT_M`.
    """
    heights = np.full((grid.rows, grid.cols), np.inf, dtype=np.float32)
    for tile, (row, col) in zip(tiles, offsets, strict=True):
        place = heights[row : row + tile.grid.rows, col : col + tile.grid.cols]
        with opened(tile.source) as dataset:
            disagreement_m = read_into(dataset, tile, place)
        if disagreement_m > AGREEMENT_M:
            _log.warning(
                "%s differs by up to %.2f m from tiles named before it, whose heights are kept",
                tile.source,
                disagreement_m,
            )
    return heights


def _nearest_turn(tile: Tile, first: Tile) -> Grid:
    """Return the tile's grid moved by whole turns next to the first's: W180 is east of E179."""
    turn = full_turn(tile.crs)
    if turn is None:
        return tile.grid
    turns = round((first.grid.centre[0] - tile.grid.centre[0]) / turn)
    return replace(tile.grid, west=tile.grid.west + turns * turn)


def _check_fits(tile: Tile, grid: Grid, first: Tile) -> None:
    if not tile.crs.equals(first.crs, ignore_axis_order=True):
        raise InputError(
            f"{tile.source} is in {tile.crs.name} and {first.source} in {first.crs.name}; tiles "
            "must share one coordinate reference system: warp them beforehand (gdalwarp)"
        )
    drift_east = abs(grid.step_east / first.grid.step_east - 1.0) * grid.cols
    drift_north = abs(grid.step_north / first.grid.step_north - 1.0) * grid.rows
    if max(drift_east, drift_north) > GRID_TOLERANCE:
        raise InputError(
            f"{tile.source} has a sample spacing of {grid.step_east:.9g} x {grid.step_north:.9g} "
            f"and {first.source} of {first.grid.step_east:.9g} x {first.grid.step_north:.9g}; "
            "tiles must share one grid: resample them beforehand (gdalwarp -tr)"
        )

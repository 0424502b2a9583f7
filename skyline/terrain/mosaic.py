"""The mosaic of an elevation model's tiles.

It checks whether the tiles fit together, and reads their heights.
"""

import itertools
import logging
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import InputError, some_of
from skyline.terrain.datums import ELLIPSOID, GEOID, merged_conventions
from skyline.terrain.grid import MAX_SAMPLES, STRIP_SAMPLES, Grid, full_turn
from skyline.terrain.raster_tiles import Tile
from skyline.terrain.repair import ABSURD_M

GRID_TOLERANCE = 0.01
"""Greatest distance of a tile's samples from the grid of the first tile, in samples."""

AGREEMENT_M = 1.0
"""Tiles may differ by this much where they overlap or meet, because of rounding to whole metres."""

OTHER_GROUND_M = 30.0
"""Two models of one ground differ by less at most samples that they share, and at most of their
border: by trees, houses, and errors. Rasters of slopes or errors, and heights in another unit or
above another datum, differ by more."""

BORDER_SAMPLES = 64
"""Least length of a border at which steps are searched; along shorter ones, ridges and valleys look
like steps."""

STANDARD_ERRORS = 8.0
"""Least height of a step, in its standard errors. A cut through a whole DEM must never be reported
as a step: tests/unit/test_dem_tiles.py tries some thousands, of 128 samples."""

_CAUSE = (
    "one of them holds no heights, or heights in another unit or datum: name the files of one model"
)
"""Why tiles differ, and what to do, for errors."""

_READERS = 2
"""Tiles that are read at a time, and tiles that wait to be laid."""

Parts = Iterable[tuple[slice, Float32Array]]
"""Slices of a tile's rows, and their heights."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class Mosaic:
    """The heights of tiles on one grid; other fields as in `Tile`."""

    heights_m: Float32Array
    """(rows, cols) float32. NaN marks voids, -inf voids that no file declares, +inf samples that no
    tile covers."""
    source: str
    crs: CRS
    grid: Grid
    conventions: Mapping[str, str]
    files: tuple[str, ...]


def read_mosaic(tiles: Sequence[Tile]) -> Mosaic:
    """Read tiles onto their common grid.

    Where tiles overlap, the first tile that has a height gives it. If tiles differ by more than
    `AGREEMENT_M` there, or where they meet, a warning gives the difference. Tiles in degrees that
    agree only in their spacing of latitude, as Copernicus tiles north and south of 50 degrees do,
    are resampled to the finest spacing of longitude.

    Raises `InputError` if tiles differ in CRS or spacing, lie off the grid of the first or too far
    apart, if one has heights above the geoid and another above the ellipsoid, or if a tile differs
    from others by more than `OTHER_GROUND_M` at most samples where they overlap or meet.
    """
    _check_vertical(tiles)
    groups = _by_spacing(tiles)
    if len(groups) > 1:
        finest = min((group[0].grid for group in groups), key=lambda grid: grid.step_east)
        tiles = [_with_columns_of(finest, _read(group), group[0]) for group in groups]
    return _read(tiles)


def _read(tiles: Sequence[Tile]) -> Mosaic:
    grid, offsets = _common_grid(tiles)
    heights = np.full((grid.rows, grid.cols), np.inf, dtype=np.float32)
    for (tile, parts), (row, col) in zip(_read_ahead(tiles), offsets, strict=True):
        borders = _free_borders(heights, row, col, tile.grid)
        target = heights[row : row + tile.grid.rows, col : col + tile.grid.cols][tile.north_up]
        _lay_tile(target, tile, parts)
        _check_step(borders, tile)
    return Mosaic(
        heights,
        ", ".join(tile.source for tile in tiles),
        tiles[0].crs,
        grid,
        merged_conventions([tile.conventions for tile in tiles]),
        tuple(file for tile in tiles for file in tile.files),
    )


def _read_ahead(tiles: Sequence[Tile]) -> Iterator[tuple[Tile, Parts]]:
    """Yield tiles with their heights.

    While the caller works on one tile, the next ones are read and unpacked.
    """
    if len(tiles) == 1:
        yield tiles[0], tiles[0].read()
        return
    with ThreadPoolExecutor(_READERS) as pool:
        waiting: deque[Future[Parts]] = deque()
        ahead = iter(tiles)
        for tile in tiles:
            for one in itertools.islice(ahead, _READERS - len(waiting)):
                # A larger tile would take much memory beside the mosaic: it is read strip by strip.
                is_small = one.grid.rows * one.grid.cols <= 4 * STRIP_SAMPLES
                waiting.append(pool.submit(list if is_small else iter, one.read()))
            yield tile, waiting.popleft().result()


def _lay_tile(target: Float32Array, tile: Tile, parts: Parts) -> None:
    """Read a tile into the mosaic; heights of earlier tiles stay.

    ``target`` is the tile's part of the mosaic, in the order of its rows and columns. Warns if
    heights differ, and raises `InputError` if the tiles show different ground.
    """
    disagreement_m = 0.0
    shared = 0
    other = 0
    has_level = False
    for rows, fresh in parts:
        old = target[rows]
        # A height beyond all ground is an undeclared void.
        known = np.isfinite(old) & (np.abs(old) <= ABSURD_M)
        both = known & np.isfinite(fresh)
        apart_m = np.abs(old[both] - fresh[both])
        disagreement_m = max(disagreement_m, float(apart_m.max(initial=0.0)))
        shared += apart_m.size
        other += int(np.count_nonzero(apart_m > OTHER_GROUND_M))
        has_level |= _is_level(old[both]) or _is_level(fresh[both])
        np.copyto(old, fresh, where=~known)
    is_same_area = shared > tile.grid.rows * tile.grid.cols / 2
    if 2 * other > shared >= BORDER_SAMPLES and (is_same_area or not has_level):
        raise InputError(
            f"{tile.source} covers ground of the tiles before it, and differs from them by more "
            f"than {OTHER_GROUND_M:g} m at most samples there; {_CAUSE}"
        )
    if disagreement_m > AGREEMENT_M:
        _log.warning(
            "%s differs by up to %.2f m from the tiles before it, whose heights are kept",
            tile.source,
            disagreement_m,
        )


def _check_step(borders: Sequence[tuple[Float32Array, BoolArray]], tile: Tile) -> None:
    """Warn where a tile just read stands above or below its neighbours.

    Raises `InputError` if it stands far above or below.
    """
    step_m = max((border_step_m(*border) for border in borders), key=abs, default=0.0)
    side = "above" if step_m > 0.0 else "below"
    said = f"{tile.source} stands {abs(step_m):.1f} m {side} the tiles beside it"
    if abs(step_m) > OTHER_GROUND_M:
        raise InputError(f"{said}, a wall that no ground makes; {_CAUSE}")
    if step_m:
        _log.warning(
            "%s, and the border is a wall; check that all have the same datum and unit, and are of "
            "one survey",
            said,
        )


def _free_borders(
    heights: Float32Array, row: int, col: int, grid: Grid
) -> list[tuple[Float32Array, BoolArray]]:
    """Return the borders of a tile with samples on both sides.

    The tile has not been read yet. ``row`` and ``col`` are the position of its north-west sample in
    ``heights``. A border is a view of four lines of samples (4, n), two inside the tile and two
    outside, and a mask (n,) of the columns whose sample at the tile's edge no other tile has given.
    """
    borders = []
    for across, first, along, count in (
        (heights, row, slice(col, col + grid.cols), grid.rows),
        (heights.T, col, slice(row, row + grid.rows), grid.cols),
    ):
        for inner, outward in ((first, -1), (first + count - 1, 1)):
            begin, end = sorted((inner - outward, inner + 2 * outward))
            if begin >= 0 and end < len(across) and count > 1:
                lines = across[begin : end + 1, along][::outward]
                borders.append((lines, ~np.isfinite(lines[1])))
    return borders


def border_step_m(lines: Float32Array, is_free: BoolArray) -> float:
    """Return how far a tile stands above its neighbours.

    The step is 0 along a border where the tile fits them. ``lines`` (4, n) are samples from within
    the tile outwards, two on either side of the border; samples marked in ``is_free`` (n,) count.
    The slopes on both sides explain their share of a step.
    """
    inside, edge, beside, beyond = lines[:, is_free].astype(np.float64)
    with np.errstate(invalid="ignore"):  # Samples without a height are infinite.
        step_m = edge - beside - 0.5 * ((inside - edge) + (beside - beyond))
    is_known = np.isfinite(step_m)
    if np.count_nonzero(is_known) < BORDER_SAMPLES:
        return 0.0
    step_m = step_m[is_known]
    if _is_level(edge[is_known]) or _is_level(beside[is_known]):
        return 0.0
    median_m = float(np.median(step_m))
    error_m = 1.4826 * np.median(np.abs(step_m - median_m)) / math.sqrt(len(step_m))
    return median_m if abs(median_m) > AGREEMENT_M + STANDARD_ERRORS * error_m else 0.0


def _is_level(heights: Float64Array | Float32Array) -> bool:
    """Return whether most heights are equal: a sea, or an undeclared void."""
    return heights.size > 0 and bool(np.mean(heights == np.median(heights)) > 0.5)


def _by_spacing(tiles: Sequence[Tile]) -> list[list[Tile]]:
    """Return tiles in degrees in groups of one spacing of longitude.

    Tiles that differ in their spacing of latitude, or are not in degrees, form one group.
    """
    first = tiles[0]
    groups: dict[float, list[Tile]] = {}
    for tile in tiles:
        step = round(tile.grid.step_east / first.grid.step_east, 3)
        groups.setdefault(step, []).append(tile)
    alike = all(
        abs(tile.grid.step_north / first.grid.step_north - 1.0) * tile.grid.rows <= GRID_TOLERANCE
        for tile in tiles
    )
    return list(groups.values()) if alike and first.crs.is_geographic else [list(tiles)]


def _with_columns_of(finest: Grid, mosaic: Mosaic, first: Tile) -> Tile:
    """Return a mosaic as a tile on a finer grid's columns.

    Heights are interpolated linearly between two samples; where either is a void, the nearest
    sample gives the height. A sample higher than its neighbours passes its height to the nearest
    column, so that no crest sinks. ``first`` is one of the tiles of the mosaic.
    """
    grid = mosaic.grid
    step = finest.step_east
    # Samples stand for their pixels, which reach half a sample beyond the outermost.
    half = 0.5 * grid.step_east
    left = math.ceil((grid.west - half - finest.west) / step - GRID_TOLERANCE)
    right = math.floor((grid.east + half - finest.west) / step + GRID_TOLERANCE)
    west = finest.west + left * step
    cols = right - left + 1
    at = np.clip((west + step * np.arange(cols) - grid.west) / grid.step_east, 0, grid.cols - 1)
    before = np.minimum(at.astype(np.intp), max(grid.cols - 2, 0))
    after = np.minimum(before + 1, grid.cols - 1)
    share = (at - before).astype(np.float32)
    own = mosaic.heights_m
    heights = np.where(share < 0.5, own[:, before], own[:, after])
    known = np.isfinite(own[:, before]) & np.isfinite(own[:, after])
    between = np.multiply(own[:, after] - own[:, before], share, where=known, out=heights.copy())
    np.add(own[:, before], between, where=known, out=heights)
    row, col = np.nonzero(
        (own[:, 1:-1] > own[:, :-2]) & (own[:, 1:-1] >= own[:, 2:]) & np.isfinite(own[:, 1:-1])
    )
    nearest = np.rint((grid.west + (col + 1) * grid.step_east - west) / step).astype(np.intp)
    heights[row, nearest] = np.maximum(heights[row, nearest], own[row, col + 1])
    return replace(
        first,
        source=mosaic.source,
        grid=replace(grid, west=west, step_east=step, cols=cols),
        north_up=(slice(None), slice(None)),
        conventions=mosaic.conventions,
        read=lambda: iter([(slice(None), heights)]),
        files=mosaic.files,
    )


def _common_grid(tiles: Sequence[Tile]) -> tuple[Grid, list[tuple[int, int]]]:
    """Return the common grid, and each tile's first row and column."""
    base = tiles[0].grid
    offsets = [_offset_on_grid(tile, tiles[0]) for tile in tiles]
    top, left = (min(firsts) for firsts in zip(*offsets, strict=True))
    ends = [(r + t.grid.rows, c + t.grid.cols) for (r, c), t in zip(offsets, tiles, strict=True)]
    bottom, right = (max(lasts) for lasts in zip(*ends, strict=True))
    common = base.part(slice(top, bottom), slice(left, right))
    if common.rows * common.cols > MAX_SAMPLES:
        raise InputError(
            f"the DEM spans {common.rows} x {common.cols} samples, more than {MAX_SAMPLES}; give "
            "fewer or adjacent tiles, or a coarser DEM"
        )
    return common, [(row - top, col - left) for row, col in offsets]


def _offset_on_grid(tile: Tile, first: Tile) -> tuple[int, int]:
    """Return a tile's first row and column on the first tile's grid.

    Raises `InputError` where the tile does not lie on that grid.
    """
    grid = tile.grid
    base = first.grid
    turn = full_turn(first.crs)
    if not tile.crs.equals(first.crs, ignore_axis_order=True):
        raise InputError(
            f"{tile.source} is in {tile.crs.name} and {first.source} in {first.crs.name}; "
            "tiles must share one coordinate reference system: warp them beforehand (gdalwarp)"
        )
    drift_east = abs(grid.step_east / base.step_east - 1.0) * grid.cols
    drift_north = abs(grid.step_north / base.step_north - 1.0) * grid.rows
    if max(drift_east, drift_north) > GRID_TOLERANCE:
        raise InputError(
            f"{tile.source} has a sample spacing of {grid.step_east:.9g} x "
            f"{grid.step_north:.9g} and {first.source} of {base.step_east:.9g} x "
            f"{base.step_north:.9g}; tiles must share one grid: resample them beforehand "
            "(gdalwarp -tr)"
        )
    west = grid.west
    if turn is not None:
        # Whole turns bring W180 east of E179.
        west += turn * round((base.centre[0] - grid.centre[0]) / turn)
    row = (base.north - grid.north) / base.step_north
    col = (west - base.west) / base.step_east
    if max(abs(row - round(row)), abs(col - round(col))) > GRID_TOLERANCE:
        raise InputError(
            f"{tile.source} lies {abs(row - round(row)):.2f} rows and "
            f"{abs(col - round(col)):.2f} columns off the grid of {first.source}; tiles must "
            "share one grid: merge them beforehand (gdalwarp) or give them one at a time"
        )
    return round(row), round(col)


def _check_vertical(tiles: Sequence[Tile]) -> None:
    """Warn of assumptions about heights, and of different vertical datums.

    Raises `InputError` where one tile has heights above the geoid and another above the ellipsoid.
    """
    sources: dict[str, list[str]] = {}
    datums: dict[str, str] = {}
    references: dict[str, str] = {}
    for tile in tiles:
        for note in tile.vertical.notes:
            sources.setdefault(note, []).append(tile.source)
        datums.setdefault(tile.vertical.datum or "a datum that is not named", tile.source)
        references.setdefault(tile.vertical.reference, tile.source)
    for note, named in sources.items():
        _log.warning("%s: %s", some_of(named, 1), note)
    if {GEOID, ELLIPSOID} <= references.keys():
        raise InputError(
            f"{references[GEOID]} has heights above the geoid and {references[ELLIPSOID]} above "
            "the ellipsoid, tens of metres apart; tiles must share one vertical datum: convert "
            "them beforehand (gdalwarp)"
        )
    if len(datums) > 1:
        listed = " and ".join(f"{datum} ({source})" for datum, source in datums.items())
        _log.warning("tiles have heights of %s; steps between the tiles are kept", listed)

"""Raster files, each a tile of a north-up grid: opening, checking, reading onto one grid."""

import gzip
import logging
import math
import re
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.enums import MaskFlags
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window

from skyline.arrays import Float32Array
from skyline.errors import FetchError, InputError, MissingFileError
from skyline.files import for_gdal, is_file
from skyline.geodesy import horizontal
from skyline.terrain.cleaning import strips
from skyline.terrain.conventions import (
    ELLIPSOID,
    GEOID,
    Vertical,
    conventions_of,
    merged,
    vertical_of,
)

MAX_UNPACKED_BYTES = 1 << 28
"""The largest file behind a .gz; the largest .hgt, of half an arc-second, has 99 MiB."""

UNDECLARED_VOIDS = (-32768.0, -9999.0)
"""Values that mark a void in DEMs that do not declare them as nodata."""

MAX_SAMPLES = 1 << 31
"""The largest mosaic: 8 GiB of float32."""

GRID_TOLERANCE = 0.01
"""How far a tile's samples may lie off the grid of the first, in samples."""

AGREEMENT_M = 1.0
"""Neighbouring tiles may differ by this much where they overlap, from rounding to whole metres."""

# Enough to decode a row of tiles; GDAL's own default is a twentieth of the machine's memory.
_GDAL_CACHE_BYTES = 64 << 20
_COMPOUND = {"GTIFF_REPORT_COMPD_CS": "YES"}
"""GDAL leaves the vertical part of a GeoTIFF's CRS out otherwise."""
_ON_NETWORKS = {
    "GDAL_HTTP_CONNECTTIMEOUT": "30",
    "GDAL_HTTP_LOW_SPEED_LIMIT": "1000",
    "GDAL_HTTP_LOW_SPEED_TIME": "30",
    "GDAL_HTTP_MAX_RETRY": "3",
}
"""A server that sends less than 1 kB a second for 30 seconds is given up."""
_NO_NEIGHBOURS = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR"}
"""GDAL asks a server for a dozen files beside the DEM otherwise."""
_SECRET = re.compile(r"(?<=://)[^/@\s]*@|\?[^\"'\s)]*")
"""Of an address: user and password, and the query, which may be a signature."""
_NO_ANSWER = re.compile(
    r"HTTP (response|error) code|CURL error|[Ff]ailed to connect|open /vsicurl/"
)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Grid:
    """A north-up grid of samples in the units of its CRS; coordinates are of the samples."""

    west: float
    north: float
    step_east: float
    step_north: float
    rows: int
    cols: int

    @property
    def east(self) -> float:
        """Abscissa of the last column."""
        return self.west + (self.cols - 1) * self.step_east

    @property
    def south(self) -> float:
        """Ordinate of the last row."""
        return self.north - (self.rows - 1) * self.step_north

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east, north of the outermost samples."""
        return self.west, self.south, self.east, self.north

    @property
    def centre(self) -> tuple[float, float]:
        """Abscissa and ordinate of the middle of the grid."""
        return 0.5 * (self.west + self.east), 0.5 * (self.north + self.south)

    def part(self, rows: slice, cols: slice) -> "Grid":
        """Return the grid of some of the rows and columns."""
        return replace(
            self,
            west=self.west + cols.start * self.step_east,
            north=self.north - rows.start * self.step_north,
            rows=rows.stop - rows.start,
            cols=cols.stop - cols.start,
        )


@dataclass(frozen=True, slots=True)
class Tile:
    """One raster that has been looked at but not read."""

    source: str
    """What rasterio opens: an absolute path, or a GDAL name such as ``netcdf:/data/t.nc:dem``."""
    crs: CRS
    """Of the map; its vertical part is in ``vertical``."""
    grid: Grid
    """North-up, whichever way the file runs."""
    north_up: tuple[slice, slice]
    """From an array of the file's rows and columns to one of the grid's, and back."""
    vertical: Vertical
    conventions: Mapping[str, str]
    """By name, in words."""
    files: tuple[str, ...] = ()
    """From which its heights can be read again."""


def open_tile(path: str | Path, default_crs: CRS | None) -> Tile:
    """Look at a file; `InputError` or `MissingFileError` where it is not a usable DEM."""
    source = absolute_name(path)
    with opened(source) as dataset:
        return tile_of(source, dataset, default_crs)


def tile_of(source: str, dataset: Any, default_crs: CRS | None) -> Tile:
    """Look at an open rasterio dataset; `InputError` where it is not a usable DEM."""
    if dataset.count == 0 and dataset.subdatasets:
        raise InputError(
            f"{source} holds several rasters; name one of them: {', '.join(dataset.subdatasets)}"
        )
    if dataset.count != 1:
        raise InputError(
            f"{source} has {dataset.count} bands; a DEM has one band of heights: extract it "
            "(gdal_translate -b 1)"
        )
    if dataset.dtypes[0].startswith("complex"):
        raise InputError(f"{source} holds {dataset.dtypes[0]} numbers; expected real heights")
    crs = crs_of(source, None if dataset.crs is None else dataset.crs.to_wkt(), default_crs)
    grid, north_up = grid_of(source, dataset.transform, dataset.shape)
    positive = dataset.tags(1).get("positive", "up")
    vertical = vertical_of(source, crs, dataset.units[0] or "", positive)
    pixel = dataset.tags().get("AREA_OR_POINT", "Area, assumed").lower()
    nodata = "none declared" if dataset.nodata is None else f"{dataset.nodata:g}"
    if MaskFlags.per_dataset in dataset.mask_flag_enums[0]:
        nodata = "by a mask"
    return tile_in(source, crs, (grid, north_up), vertical, {"pixel_is": pixel, "nodata": nodata})


def tile_in(
    source: str,
    crs: CRS,
    turned: tuple[Grid, tuple[slice, slice]],
    vertical: Vertical,
    others: Mapping[str, str],
) -> Tile:
    """Return the tile of a raster in a CRS with its vertical part, and with other conventions.

    Raises `InputError` for another kind of CRS than degrees or a projection.
    """
    on_map = horizontal(crs)
    if not (crs.is_geographic or crs.is_projected):
        raise InputError(
            f"{source} is in {crs.name!r}, a {crs.type_name}; expected a geographic or "
            "projected coordinate reference system: warp it first with gdalwarp"
        )
    conventions = {**conventions_of(on_map), **vertical.conventions, **others}
    return Tile(source, on_map, *turned, vertical, conventions)


def read_tiles(
    paths: str | Path | Sequence[str | Path], default_crs: CRS | None
) -> tuple[Tile, Float32Array]:
    """Read files as one tile; `read_mosaic` says how. Errors are those of `read_dem`."""
    if isinstance(paths, str | Path):
        paths = [paths]
    if not paths:
        raise InputError("no DEM file was given; name one or more")
    tiles = [open_tile(path, default_crs) for path in paths]
    grid, offsets = mosaic_grid(tiles)
    files = tuple(tile.source for tile in tiles)
    check_heights(tiles)
    mosaic = replace(
        tiles[0],
        source=", ".join(files),
        grid=grid,
        conventions=merged([tile.conventions for tile in tiles]),
        files=files,
    )
    return mosaic, read_mosaic(tiles, grid, offsets)


def check_heights(tiles: Sequence[Tile]) -> None:
    """Warn once of each thing that was assumed of the heights, and of vertical datums that differ.

    Raises `InputError` where one tile has heights above the geoid and another above the ellipsoid.
    """
    sources: dict[str, list[str]] = {}
    datums: dict[str, str] = {}
    surfaces: dict[str, str] = {}
    for tile in tiles:
        for note in tile.vertical.notes:
            sources.setdefault(note, []).append(tile.source)
        datums.setdefault(tile.vertical.datum or "a datum that is not named", tile.source)
        surfaces.setdefault(tile.vertical.surface, tile.source)
    for note, named in sources.items():
        others = f" and {len(named) - 1} more" if len(named) > 1 else ""
        _log.warning("%s%s: %s", named[0], others, note)
    if {GEOID, ELLIPSOID} <= surfaces.keys():
        raise InputError(
            f"{surfaces[GEOID]} has heights above the geoid and {surfaces[ELLIPSOID]} above the "
            "ellipsoid, tens of metres apart; tiles must share one vertical datum: convert them "
            "beforehand (gdalwarp)"
        )
    if len(datums) > 1:
        listed = " and ".join(f"{datum} ({source})" for datum, source in datums.items())
        _log.warning("tiles have heights of %s; steps between the tiles are kept", listed)


def read_dataset(dataset: Any, default_crs: CRS | None) -> tuple[Tile, Float32Array]:
    """Read an open rasterio dataset; as `read_tiles` otherwise."""
    source = str(dataset.name)
    tile = tile_of(source, dataset, default_crs)
    grid, _ = mosaic_grid([tile])
    check_heights([tile])
    heights = np.full((grid.rows, grid.cols), np.inf, dtype=np.float32)
    read_into(dataset, tile, heights)
    # A warped or virtual dataset is not what lies in a file of its name.
    on_disk = isinstance(dataset, rasterio.DatasetReader) and is_file(source)
    return replace(tile, files=(str(Path(source).absolute()),) if on_disk else ()), heights


def full_turn(crs: CRS) -> float | None:
    """Return a full turn of longitude in the units of a geographic CRS, None of any other."""
    if not crs.is_geographic:
        return None
    return round(2.0 * math.pi / crs.axis_info[0].unit_conversion_factor, 9)


def absolute_name(path: str | Path) -> str:
    """Return an absolute path, or what GDAL opens with the file in it made absolute.

    Raises
    ------
    MissingFileError
        There is no such file, and it is no address or name of GDAL's.
    InputError
        A folder, or a name that is not UTF-8.
    """
    text = str(path)
    if is_file(text):
        return for_gdal(str(Path(text).absolute()))
    if "://" in text or text.startswith("/vsi"):
        return for_gdal(text)
    if Path(text).is_dir():
        raise InputError(f"{text} is a folder; name the DEM files in it")
    if re.match(r"[A-Za-z][A-Za-z0-9_+]+:", text):
        parts = re.split(r"([:\"])", text)
        named = (str(Path(p).absolute()) if p and is_file(p) else p for p in parts)
        return for_gdal("".join(named))
    raise MissingFileError(f"there is no file {text}; check the path of the DEM")


@contextmanager
def opened(source: str) -> Iterator[Any]:
    """Open a raster; what goes wrong while it is open is told as one error."""
    settings = _COMPOUND | _ON_NETWORKS | (_NO_NEIGHBOURS if "://" in source else {})
    try:
        with rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE_BYTES, **settings), ExitStack() as held:
            yield _dataset(source, held)
    except RasterioError as error:
        reason = re.sub(r"/vsimem/[^/]*/", "", " ".join(str(error.__cause__ or error).split()))
        if "://" in source:
            source, reason = _SECRET.sub("", source), _SECRET.sub("", reason)
        if _NO_ANSWER.search(reason):
            raise FetchError(
                f"{source} cannot be read from its server ({reason}); check the address and "
                "whether the server is up"
            ) from error
        raise InputError(
            f"{source} cannot be read as a raster ({reason}); expected a whole GeoTIFF, ESRI ASCII "
            "grid, .hgt or .hgt.gz (named after its corner, like N46E009.hgt) or another format "
            "that GDAL opens"
        ) from error


def _dataset(source: str, held: ExitStack) -> Any:
    with warnings.catch_warnings():
        # Told as an error of our own, by `grid_of`.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        if source.lower().endswith(".gz") and is_file(source):
            # The .hgt driver reads the corner from the file's name and opens no .gz.
            memory = rasterio.MemoryFile(_unpacked(source), filename=Path(source).stem)
            return held.enter_context(held.enter_context(memory).open())
        return held.enter_context(rasterio.open(source))


def _unpacked(source: str) -> bytes:
    try:
        with gzip.open(source) as stream:
            content = stream.read(MAX_UNPACKED_BYTES + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(
            f"{source} cannot be unpacked ({error}); the file is damaged or not gzip: "
            "fetch it again"
        ) from error
    if len(content) > MAX_UNPACKED_BYTES:
        raise InputError(
            f"{source} unpacks to more than {MAX_UNPACKED_BYTES >> 20} MiB; unpack it beforehand "
            "(gunzip) and name the unpacked file"
        )
    return content


def crs_of(source: str, wkt: str | None, default_crs: CRS | None) -> CRS:
    """Return the CRS that a raster names, else the default.

    The vertical part of a default with the same map is taken where the raster names none. Raises
    `InputError` where neither is there, or the raster's is not understood.
    """
    if wkt is None:
        if default_crs is None:
            raise InputError(
                f"{source} has no coordinate reference system; say which it is with --crs, "
                "for example --crs EPSG:32632 (in Python DemOptions(crs=...))"
            )
        return default_crs
    try:
        crs = CRS.from_wkt(wkt)
    except CRSError as error:
        raise InputError(
            f"the coordinate reference system of {source} is not understood ({error}); "
            "set a valid one in the file (gdal_edit.py -a_srs)"
        ) from error
    if default_crs is None:
        return crs
    same_map = horizontal(crs).equals(horizontal(default_crs), ignore_axis_order=True)
    if same_map and len(crs.axis_info) < len(default_crs.axis_info):
        return default_crs
    if not crs.equals(default_crs, ignore_axis_order=True):
        _log.warning(
            "%s says it is in %s; --crs %s is for files that do not say, and not used",
            source,
            crs.name,
            default_crs.name,
        )
    return crs


def grid_of(
    source: str, transform: Affine, shape: tuple[int, int]
) -> tuple[Grid, tuple[slice, slice]]:
    """Return the north-up grid of a raster, and how its rows and columns are turned to it.

    Raises `InputError` for a raster without a georeference, or with a rotated grid.
    """
    if transform.is_identity:
        raise InputError(
            f"{source} has no georeference, so its place on the map is unknown; give a "
            "georeferenced DEM"
        )
    if abs(transform.b) > 1e-9 * abs(transform.a) or abs(transform.d) > 1e-9 * abs(transform.e):
        raise InputError(
            f"{source} has a rotated or sheared grid (geotransform {transform.to_gdal()}); "
            "expected rows along the easting and columns along the northing: straighten it first "
            "(gdalwarp)"
        )
    rows, cols = shape
    west = transform.c + 0.5 * transform.a
    north = transform.f + 0.5 * transform.e
    flip_rows, flip_cols = transform.e > 0.0, transform.a < 0.0
    if flip_rows:
        north += (rows - 1) * transform.e
    if flip_cols:
        west += (cols - 1) * transform.a
    grid = Grid(west, north, abs(transform.a), abs(transform.e), rows, cols)
    return grid, (
        slice(None, None, -1 if flip_rows else 1),
        slice(None, None, -1 if flip_cols else 1),
    )


def read_into(dataset: Any, tile: Tile, place: Float32Array) -> float:
    """Read a tile where nothing has been read yet; return the worst disagreement elsewhere."""
    place = place[tile.north_up]
    disagreement_m = 0.0
    for rows in strips(place):
        window = Window(0, rows.start, dataset.width, rows.stop - rows.start)
        band = dataset.read(1, window=window, masked=True)
        scale, offset, metres = dataset.scales[0], dataset.offsets[0], tile.vertical.metres
        fresh = heights_of(band.data, np.ma.getmaskarray(band), scale, offset, metres)
        old = place[rows]
        known = np.isfinite(old)
        both = known & np.isfinite(fresh)
        if both.any():
            disagreement_m = max(disagreement_m, float(np.abs(old - fresh)[both].max()))
        np.copyto(old, fresh, where=~known)
    return disagreement_m


def heights_of(
    band: NDArray[Any], voids: NDArray[np.bool_], scale: float, offset: float, metres: float
) -> Float32Array:
    """Return a copy of a band as heights in metres, NaN where void, -inf where undeclared.

    A height is ``(value * scale + offset) * metres``.
    """
    heights: Float32Array = band.astype(np.float32)
    heights[voids | ~np.isfinite(heights)] = np.nan
    undeclared = np.isin(heights, UNDECLARED_VOIDS)
    if (scale, offset, metres) != (1.0, 0.0, 1.0):
        heights = ((heights * scale + offset) * metres).astype(np.float32)
    heights[undeclared] = -np.inf
    return heights


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
    ends = [(r + t.grid.rows, c + t.grid.cols) for (r, c), t in zip(offsets, tiles, strict=True)]
    bottom, right = (max(values) for values in zip(*ends, strict=True))
    grid = first.grid.part(slice(top, bottom), slice(left, right))
    if grid.rows * grid.cols > MAX_SAMPLES:
        raise InputError(
            f"the DEM spans {grid.rows} x {grid.cols} samples, more than {MAX_SAMPLES}; give "
            "fewer or adjacent tiles, or a coarser DEM"
        )
    return grid, [(row - top, col - left) for row, col in offsets]


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

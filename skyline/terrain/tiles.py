"""Raster files, each a tile of a north-up grid: opening, checking, reading."""

import gzip
import logging
import math
import re
import warnings
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.transform import Affine
from rasterio.windows import Window

from skyline.arrays import Float32Array
from skyline.errors import FetchError, InputError, MissingFileError
from skyline.files import is_file
from skyline.terrain.cleaning import strips

MAX_UNPACKED_BYTES = 1 << 28
"""The largest file behind a .gz; the largest .hgt, of half an arc-second, has 99 MiB."""

UNDECLARED_VOIDS = (-32768.0, -9999.0)
"""Values that mark a void in DEMs that do not declare them as nodata."""

# Enough to decode a row of tiles; GDAL's own default is a twentieth of the machine's memory.
_GDAL_CACHE_BYTES = 64 << 20
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
_FEET_M = {"ft": 0.3048, "foot": 0.3048, "feet": 0.3048, "us-ft": 1200 / 3937, "ftus": 1200 / 3937}


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
    """One raster file that has been looked at but not read."""

    source: str
    """What rasterio opens: an absolute path, or a GDAL name such as ``netcdf:/data/t.nc:dem``."""
    crs: CRS
    grid: Grid
    """North-up, whichever way the file runs."""
    flip_rows: bool
    flip_cols: bool
    """``flip_rows``, ``flip_cols``: whether the file runs from south to north, from east to
    west."""


@dataclass(frozen=True, slots=True)
class Said:
    """What a raster says of its numbers: scale, offset and unit."""

    scale: float = 1.0
    offset: float = 0.0
    unit: str = ""


def open_tile(path: str | Path, default_crs: CRS | None) -> Tile:
    """Look at a file; `InputError` or `MissingFileError` where it is not a usable DEM."""
    source = absolute_name(path)
    with opened(source) as dataset:
        return tile_of(source, dataset, default_crs)


def tile_of(source: str, dataset: Any, default_crs: CRS | None) -> Tile:
    """Look at an open rasterio dataset; `InputError` where it is not a usable DEM."""
    _check_one_band(source, dataset)
    crs = crs_of(source, None if dataset.crs is None else dataset.crs.to_wkt(), default_crs)
    return Tile(source, crs, *grid_of(source, dataset.transform, dataset.shape))


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
        A folder.
    """
    text = str(path)
    if is_file(text):
        return str(Path(text).absolute())
    if "://" in text or text.startswith("/vsi"):
        return text
    if Path(text).is_dir():
        raise InputError(f"{text} is a folder; name the DEM files in it")
    if re.match(r"[A-Za-z][A-Za-z0-9_+]+:", text):
        parts = re.split(r"([:\"])", text)
        return "".join(str(Path(p).absolute()) if p and is_file(p) else p for p in parts)
    raise MissingFileError(f"there is no file {text}; check the path of the DEM")


@contextmanager
def opened(source: str) -> Iterator[Any]:
    """Open a raster; what goes wrong while it is open is told as one error."""
    settings = _ON_NETWORKS | (_NO_NEIGHBOURS if "://" in source else {})
    try:
        with rasterio.Env(GDAL_CACHEMAX=_GDAL_CACHE_BYTES, **settings), _dataset(source) as dataset:
            yield dataset
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


@contextmanager
def _dataset(source: str) -> Iterator[Any]:
    with ExitStack() as held:
        with warnings.catch_warnings():
            # Told as an error of our own, by `grid_of`.
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            if source.lower().endswith(".gz") and is_file(source):
                # The .hgt driver reads the corner from the file's name and opens no .gz.
                name = Path(source).stem
                memory = held.enter_context(rasterio.MemoryFile(_unpacked(source), filename=name))
                dataset = held.enter_context(memory.open())
            else:
                dataset = held.enter_context(rasterio.open(source))
        yield dataset


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


def _check_one_band(source: str, dataset: Any) -> None:
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


def crs_of(source: str, wkt: str | None, default_crs: CRS | None) -> CRS:
    """Return the CRS a raster says it is in, else the default; `InputError` without either."""
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
    if default_crs is not None and not crs.equals(default_crs, ignore_axis_order=True):
        _log.warning(
            "%s says it is in %s; --crs %s is for files that do not say, and not used",
            source,
            crs.name,
            default_crs.name,
        )
    return crs


def grid_of(source: str, transform: Affine, shape: tuple[int, int]) -> tuple[Grid, bool, bool]:
    """Return the north-up grid of a raster, and whether its rows and its columns are flipped.

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
    return grid, flip_rows, flip_cols


def read_into(dataset: Any, tile: Tile, place: Float32Array) -> float:
    """Read a tile where nothing has been read yet; return the worst disagreement elsewhere."""
    place = place[:: -1 if tile.flip_rows else 1, :: -1 if tile.flip_cols else 1]
    disagreement_m = 0.0
    for rows in strips(place):
        fresh = _read_rows(dataset, rows)
        old = place[rows]
        known = np.isfinite(old)
        both = known & np.isfinite(fresh)
        if both.any():
            disagreement_m = max(disagreement_m, float(np.abs(old - fresh)[both].max()))
        np.copyto(old, fresh, where=~known)
    return disagreement_m


def _read_rows(dataset: Any, rows: slice) -> Float32Array:
    """Read rows of the band as metres; voids as `heights_of` marks them."""
    window = Window(0, rows.start, dataset.width, rows.stop - rows.start)
    band = dataset.read(1, window=window, masked=True)
    said = Said(dataset.scales[0], dataset.offsets[0], dataset.units[0] or "")
    return heights_of(band.data, np.ma.getmaskarray(band), said)


def heights_of(band: NDArray[Any], voids: NDArray[np.bool_], said: Said) -> Float32Array:
    """Return a copy of a band as heights in metres, NaN where void, -inf where undeclared."""
    heights: Float32Array = band.astype(np.float32)
    heights[voids | ~np.isfinite(heights)] = np.nan
    undeclared = np.isin(heights, UNDECLARED_VOIDS)
    if (said.scale, said.offset) != (1.0, 0.0):
        heights = (heights * said.scale + said.offset).astype(np.float32)
    unit = said.unit.strip().lower()
    if unit in _FEET_M:
        heights *= np.float32(_FEET_M[unit])
    heights[undeclared] = -np.inf
    return heights

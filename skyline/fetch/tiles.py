"""Cutting remote tiles to bounds, and writing them where `read_dem` takes them."""

import json
import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.windows import Window
from rasterio.windows import transform as transform_of

from skyline.errors import FetchError, InputError
from skyline.fetch.remote import AbsentError, HttpOptions, shown, with_remote
from skyline.fetch.sources import TileSource
from skyline.geodesy import Bounds
from skyline.terrain.tiles import GRID_TOLERANCE

MAX_BYTES = 4 << 30
"""The most that is fetched at a time, unpacked."""

_MAX_BLOCK_BYTES = 256 << 20
_TAG = "SKYLINE_FETCH"
# Bounds this near a pixel's edge are on it, but for rounding.
_SLACK = 1e-6

Progress = Callable[[int, int], None]
"""Called with the tiles done and the tiles there are."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FetchResult:
    """What a fetch left in its folder."""

    files: tuple[Path, ...]
    """All tiles, from the south-west, row by row."""
    fetched: int
    """Of these, the ones fetched now; the others were there already."""
    missing: tuple[str, ...]
    """Tiles that the source does not have: as a rule, sea."""


@dataclass(frozen=True, slots=True)
class _Cut:
    """What is to be read of one tile, and where it goes."""

    url: str
    path: Path
    tag: str
    window: Window
    step_deg: tuple[float, float]
    sample_bytes: int

    @property
    def size_bytes(self) -> int:
        return int(self.window.width) * int(self.window.height) * self.sample_bytes


def fetch_dem(
    bounds_deg: Bounds,
    source: str,
    folder: str | Path,
    options: HttpOptions | None = None,
    progress: Progress | None = None,
) -> FetchResult:
    """Fetch the elevation tiles of an area, each cut to it, as GeoTIFFs.

    A tile is written whole or not at all, and one that is there from the same source and bounds is
    not fetched again, so a fetch that failed goes on where it stopped.

    Parameters
    ----------
    bounds_deg : tuple
        W, S, E, N in degrees. A skyline needs the terrain around its viewpoints: give the area to
        build, and as far around it as one sees.
    source : str
        A name of `SOURCES` or a template, see `TileSource`.
    folder : str or Path
        Made where it does not exist. Files are named by their tile: ``N46E009.tif``.

    Raises
    ------
    InputError
        Bounds, source or options out of range, too much at a time, no tile at all, tiles of
        different spacing, or a file in the way.
    FetchError
        A server that fails, after the retries. Nothing of its tile is written.
    """
    options = options or HttpOptions()
    origin = TileSource.named(source)
    tiles = origin.tiles(bounds_deg)
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is not a folder; name a folder to write the tiles to")
    cuts: list[_Cut] = []
    files: list[Path] = []
    missing: list[str] = []
    for tile in tiles:
        path = folder / f"{tile.name if origin.tiled else 'dem'}.tif"
        try:
            cut = _plan(origin.url(tile), path, bounds_deg, options)
        except AbsentError as error:
            missing.append(tile.name)
            _log.info("%s", error)
            continue
        files.append(path)
        if cut is not None:
            cuts.append(cut)
    if not files:
        raise InputError(
            f"the source has none of {', '.join(missing)} ({shown(origin.url(tiles[0]))}, for one, "
            "is not there); check the bounds, or the source's template"
        )
    _check_together(cuts)
    folder.mkdir(parents=True, exist_ok=True)
    for done, cut in enumerate(cuts):
        if progress:
            progress(done, len(cuts))
        _fetch(cut, options)
    if progress:
        progress(len(cuts), len(cuts))
    return FetchResult(tuple(files), len(cuts), tuple(missing))


def _plan(url: str, path: Path, bounds_deg: Bounds, options: HttpOptions) -> _Cut | None:
    """Look at a remote tile and say what to read of it; None where that is there already."""
    tag = json.dumps({"source": shown(url), "bounds_deg": bounds_deg})
    if path.exists():
        held = _tag_of(path)
        if held == tag:
            return None
        if held is None:
            raise InputError(
                f"{path} is there and was not fetched by skyline; name another folder, or move it"
            )

    def look(file: Any) -> _Cut:
        _check_usable(url, file)
        window = _window(url, file, bounds_deg)
        step_deg = (file.transform.a, -file.transform.e)
        return _Cut(url, path, tag, window, step_deg, np.dtype(file.dtypes[0]).itemsize)

    return with_remote(url, options, look)


def _tag_of(path: Path) -> str | None:
    try:
        with rasterio.open(path, driver="GTiff") as file:
            tag: str | None = file.tags().get(_TAG)
            return tag
    except RasterioError:
        return None


def _check_usable(url: str, file: Any) -> None:
    """Refuse what is no tile of a DEM in degrees, and what would fill the memory."""
    where, transform = shown(url), file.transform
    if file.count != 1:
        raise InputError(f"{where} has {file.count} bands; a DEM has one: check the source")
    if file.crs is None or not file.crs.is_geographic:
        raise InputError(
            f"{where} is in {file.crs or 'no coordinate reference system'}; expected degrees of "
            "longitude and latitude: fetch it by other means and give it to `skyline build`"
        )
    if transform.b or transform.d or transform.a <= 0.0 or transform.e >= 0.0:
        raise InputError(
            f"{where} is not north-up (geotransform {transform.to_gdal()}); expected rows from "
            "north to south and columns from west to east"
        )
    block_bytes = math.prod(file.block_shapes[0]) * np.dtype(file.dtypes[0]).itemsize
    if block_bytes > _MAX_BLOCK_BYTES:
        raise InputError(
            f"{where} is stored in blocks of {block_bytes >> 20} MiB, so no part of it can be read "
            "alone; expected a cloud-optimized GeoTIFF"
        )


def _window(url: str, file: Any, bounds_deg: Bounds) -> Window:
    """Return the pixels of a file that meet the bounds."""
    west, south, east, north = bounds_deg
    east = west + (east - west) % 360.0
    step_east, step_north = file.transform.a, -file.transform.e
    left, top = file.transform.c, file.transform.f
    middle = left + 0.5 * file.width * step_east
    turn = 360.0 * round((middle - 0.5 * (west + east)) / 360.0)
    first_col = max(math.floor((west + turn - left) / step_east + _SLACK), 0)
    last_col = min(math.ceil((east + turn - left) / step_east - _SLACK), file.width)
    first_row = max(math.floor((top - north) / step_north + _SLACK), 0)
    last_row = min(math.ceil((top - south) / step_north - _SLACK), file.height)
    if first_col >= last_col or first_row >= last_row:
        raise InputError(
            f"{shown(url)} covers {left:.4f},{top - file.height * step_north:.4f},"
            f"{left + file.width * step_east:.4f},{top:.4f}, no part of the bounds; check the "
            "source's template: {lat} and {lon} are a tile's south-west corner"
        )
    return Window(first_col, first_row, last_col - first_col, last_row - first_row)


def _check_together(cuts: Sequence[_Cut]) -> None:
    """Refuse what is too much, and tiles that do not make one grid, before anything is read."""
    size_bytes = sum(cut.size_bytes for cut in cuts)
    if size_bytes > MAX_BYTES:
        raise InputError(
            f"the bounds need {len(cuts)} tiles and {size_bytes / 1e9:.1f} GB, more than the "
            f"{MAX_BYTES / 1e9:.1f} GB that are fetched at a time: choose smaller bounds"
        )
    for cut in cuts[1:]:
        first = cuts[0]
        for step, other in zip(cut.step_deg, first.step_deg, strict=True):
            if abs(step / other - 1.0) * max(cut.window.width, cut.window.height) > GRID_TOLERANCE:
                raise InputError(
                    f"{shown(cut.url)} has samples {3600.0 * step:g} arc-seconds apart and "
                    f"{shown(first.url)} {3600.0 * other:g}, so they are no one grid; fetch them "
                    "one at a time (Copernicus changes its spacing at 50, 60, 70, 75, 80 and 85 "
                    "degrees of latitude), and merge them with gdalwarp if both are needed"
                )


def _fetch(cut: _Cut, options: HttpOptions) -> None:
    """Read a cut and write its file whole or not at all."""
    strips = _Strips(cut.window)
    content = with_remote(cut.url, options, lambda file: _geotiff(strips.read(file), cut, file))
    partial = cut.path.with_name(f"{cut.path.name}.partial")
    try:
        with partial.open("wb") as target:
            target.write(content)
            target.flush()
            os.fsync(target.fileno())
        partial.replace(cut.path)
    except OSError as error:
        raise FetchError(
            f"{cut.path} cannot be written ({error.strerror}); make room or name another folder, "
            "then give the same command: what was fetched is kept"
        ) from error
    finally:
        partial.unlink(missing_ok=True)


class _Strips:
    """The samples of a window, read a row of blocks at a time and kept when a connection fails."""

    def __init__(self, window: Window) -> None:
        self._window = window
        self._samples: NDArray[Any] | None = None
        self._rows = 0

    def read(self, file: Any) -> NDArray[Any]:
        """Read what is not there yet; return all of it."""
        top, height = int(self._window.row_off), int(self._window.height)
        width = int(self._window.width)
        if self._samples is None:
            self._samples = np.empty((height, width), dtype=file.dtypes[0])
        block_rows = int(file.block_shapes[0][0])
        while self._rows < height:
            start = top + self._rows
            stop = min((start // block_rows + 1) * block_rows, top + height)
            strip = Window(self._window.col_off, start, width, stop - start)
            self._samples[self._rows : stop - top] = file.read(1, window=strip)
            self._rows = stop - top
        return self._samples


def _geotiff(samples: NDArray[Any], cut: _Cut, origin: Any) -> bytes:
    """Return samples as the bytes of a GeoTIFF with the place and meaning of their origin."""
    rows, cols = samples.shape
    predictor = 3 if samples.dtype.kind == "f" else 2
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=cols,
            height=rows,
            count=1,
            dtype=samples.dtype,
            crs=origin.crs,
            transform=transform_of(cut.window, origin.transform),
            nodata=origin.nodata,
            compress="deflate",
            predictor=predictor,
            tiled=True,
        ) as file:
            file.write(samples, 1)
            file.scales, file.offsets, file.units = origin.scales, origin.offsets, origin.units
            file.update_tags(**{_TAG: cut.tag}, **_registration(origin))
        return bytes(memory.getbuffer())


def _registration(origin: Any) -> dict[str, str]:
    """Return the tag that says whether samples stand for points or areas, where there is one."""
    return {key: value for key, value in origin.tags().items() if key == "AREA_OR_POINT"}

"""Fetching elevation tiles from a server, cut to an area.

A source has one address for each degree of latitude and longitude.
"""

import json
import logging
import math
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import rasterio
from numpy.typing import DTypeLike, NDArray
from rasterio import windows
from rasterio.enums import MaskFlags
from rasterio.errors import RasterioError
from rasterio.windows import Window
from rasterio.windows import transform as transform_of

from skyline.angles import wrapped_deg
from skyline.arrays import BoolArray
from skyline.errors import FetchError, InputError, some_of
from skyline.fetch.remote import (
    PATIENT,
    AbsentError,
    Patience,
    RefusedError,
    SpoiledError,
    with_remote,
)
from skyline.files.disk import write_whole
from skyline.files.folders import check_folder
from skyline.files.gdal_names import for_gdal
from skyline.geodesy.bounds import Bounds, box_around, check_bounds, width_deg
from skyline.progress import Progress
from skyline.terrain.raster_files import bands_of, without_secrets

MAX_TILES = 64
"""Most tiles of a fetch: 8 x 8 degrees."""

SOURCES = {
    "copernicus": (
        "https://copernicus-dem-30m.s3.amazonaws.com/"
        "Copernicus_DSM_COG_10_{ns}{lat:02d}_00_{ew}{lon:03d}_00_DEM/"
        "Copernicus_DSM_COG_10_{ns}{lat:02d}_00_{ew}{lon:03d}_00_DEM.tif"
    )
}
"""The addresses of named sources: Copernicus GLO-30, a surface model of 1 arc-second, on AWS."""

SOURCE_VARIABLE = "SKYLINE_DEM_SOURCE"
"""The environment variable that names the default source."""
DEFAULT_SOURCE = "copernicus"

_TAG = "SKYLINE_FETCH"
"""The GeoTIFF tag in which a file keeps its source and its bounds."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FetchResult:
    """The tiles in the folder after a fetch."""

    files: tuple[Path, ...]
    """All tiles, from the south-west, row by row."""
    fetched: int
    """Number of tiles that were fetched now; the others were there already."""
    missing: tuple[str, ...]
    """Names of tiles that the source does not have, usually sea."""


@dataclass(frozen=True, slots=True)
class _Cut:
    """The part of a tile to read, and its file."""

    url: str
    path: Path
    tag: str
    """The source and the bounds, as JSON."""
    window: Window
    dtype: DTypeLike


class _Failures:
    """The tiles of a fetch that the server failed to send."""

    def __init__(self, wanted: int) -> None:
        """Begin without failures, for a number of wanted tiles."""
        self._wanted = wanted
        self._errors: dict[str, FetchError] = {}
        self._may_be_down = False

    def __bool__(self) -> bool:
        return bool(self._errors)

    @contextmanager
    def noting(self, name: str) -> Iterator[None]:
        """Keep the error of the tile that is fetched in the block.

        Raises `FetchError` where the server does not answer, or fails for two tiles in a row.
        """
        try:
            yield
            self._may_be_down = False
        except RefusedError as error:
            self._errors[name] = error
            self._may_be_down = False
        except SpoiledError as error:
            if self._may_be_down:
                raise
            self._errors[name] = error
            self._may_be_down = True

    @property
    def error(self) -> FetchError:
        """One error for all failed tiles, in the first one's words."""
        names = list(self._errors)
        first = next(iter(self._errors.values()))
        if self._wanted == 1:
            return first
        return FetchError(
            f"{len(names)} of {self._wanted} tiles could not be fetched, {some_of(names)}: {first}"
        )


def source_of(given: str | None) -> str:
    """Return a given source, else the environment's, else Copernicus's."""
    if given is not None:
        return given
    return os.environ.get(SOURCE_VARIABLE) or DEFAULT_SOURCE


def fetch_dem(
    bounds_deg: Bounds,
    source: str | None,
    folder: Path,
    progress: Progress | None = None,
    earlier: Sequence[Path] = (),
    patience: Patience = PATIENT,
) -> FetchResult:
    """Fetch an area's elevation tiles, each cut to it, as GeoTIFFs.

    A tile is written whole or not at all. A tile in the folder with the same source and bounds is
    not fetched again, so the same call continues a failed fetch. A tile with other bounds grows to
    the box around both.

    ``source`` is a name in `SOURCES`, or an http or https address. In an address ``{lat}`` and
    ``{lon}`` stand for the whole degrees, without sign, of a tile's south-west corner, ``{ns}`` and
    ``{ew}`` for its hemispheres (N or S, E or W); numbers take a width, as in ``{lat:02d}``. None
    stands for the source of `source_of`. The folder is made if it does not exist. Files are named
    after their tile: ``N46E009.tif``. A request that fails, or has no answer in time, is repeated
    (``patience``). Samples of the same source are copied from ``earlier``, the folders of earlier
    fetches.

    Raises `InputError` if the bounds or the source are not usable, the area is too large or has no
    tile, or a file is in the way or cannot be written. Raises `FetchError` if tiles could not be
    fetched after the retries; the others are fetched first, unless the server does not answer or
    fails for two tiles in a row.
    """
    source = source_of(source)
    template = SOURCES.get(source, source)
    _check_template(template)
    corners = tile_corners(bounds_deg)
    for_gdal(str(folder.absolute()))
    check_folder(folder)
    cuts: list[_Cut] = []
    files: list[Path] = []
    missing: list[str] = []
    failures = _Failures(len(corners))
    for corner in corners:
        # These are SRTM's names of tiles.
        name = address("{ns}{lat:02d}{ew}{lon:03d}", *corner)
        path = folder / f"{name}.tif"
        try:
            with failures.noting(name):
                cut = _cut_of(address(template, *corner), path, corner, bounds_deg, patience)
                files.append(path)
                if cut is not None:
                    cuts.append(cut)
        except AbsentError as error:
            missing.append(name)
            _log.info("%s", error)
    if failures and not files:
        raise failures.error
    if not files:
        raise InputError(
            f"the source has none of {', '.join(missing)}, which is usual in the sea "
            f"({without_secrets(address(template, *corners[0]))}, for one, is not there); check "
            "the place, or the source's template"
        )
    folder.mkdir(parents=True, exist_ok=True)
    show = progress or (lambda *_: None)
    for done, cut in enumerate(cuts):
        show(done, len(cuts))
        with failures.noting(cut.path.stem):
            _fetch(cut, earlier, patience)
    show(len(cuts), len(cuts))
    if failures:
        raise failures.error
    return FetchResult(tuple(files), len(cuts), tuple(missing))


def address(template: str, lat: int, lon: int) -> str:
    """Return the address of the tile with a south-west corner."""
    ns = "N" if lat >= 0 else "S"
    ew = "E" if lon >= 0 else "W"
    return template.format(lat=abs(lat), lon=abs(lon), ns=ns, ew=ew)


def _check_template(template: str) -> None:
    try:
        fields = [part[1:] for part in Formatter().parse(template) if part[1] is not None]
        usable = {"lat", "lon"} <= {name for name, *_ in fields} <= {"lat", "lon", "ns", "ew"}
        usable &= all(
            re.fullmatch(r"(\d{1,2}d)?", width or "") and not how for _, width, how in fields
        )
        parts = urlsplit(address(template, 0, 0) if usable else "")
        usable &= parts.scheme in ("http", "https") and bool(parts.hostname)
        usable &= not set(parts.geturl()) & {"{", "}"}
    except ValueError:
        usable = False
    if not usable:
        raise InputError(
            f"source is {template!r}; expected {', '.join(SOURCES)}, or an http or https "
            "address with the fields {lat} and {lon}, and no others than {ns} and {ew} beside "
            "them, e.g. https://host/{ns}{lat:02d}{ew}{lon:03d}.tif"
        )


def tile_corners(bounds_deg: Bounds) -> list[tuple[int, int]]:
    """Return latitude and longitude of the tiles' south-west corners.

    They are whole degrees, from the south-west, row by row. Raises `InputError` for more than
    `MAX_TILES`, and as `check_bounds`.
    """
    west, south, east, north = check_bounds(bounds_deg)
    lats = range(math.floor(south), math.ceil(north))
    lons = range(math.floor(west), math.ceil(west + width_deg(bounds_deg)))
    count = len(lats) * len(lons)
    if count > MAX_TILES:
        arc_second_bytes = 4 * 3600**2  # of a degree by a degree of float32
        size_gb = (north - south) * width_deg(bounds_deg) * arc_second_bytes / 1e9
        raise InputError(
            f"bounds {west:g},{south:g},{east:g},{north:g} need {count} tiles, about "
            f"{size_gb:.1f} GB at one arc-second; at most {MAX_TILES} tiles are fetched at a "
            "time: choose smaller bounds"
        )
    return [(lat, int(wrapped_deg(lon))) for lat in lats for lon in lons]


def _cut_of(
    url: str, path: Path, corner: tuple[int, int], bounds_deg: Bounds, patience: Patience
) -> _Cut | None:
    """Return the part of a tile to read; None if already there."""
    source = without_secrets(url)
    if path.exists():
        held: dict[str, Any] = {}
        with suppress(RasterioError, ValueError), rasterio.open(path, driver="GTiff") as file:
            held = json.loads(file.tags().get(_TAG, "{}"))
        if held.get("source") != source:
            raise InputError(
                f"{path} is there and was not fetched by skyline from {source}; name another "
                "folder, or move it"
            )
        held_deg = tuple(held["bounds_deg"])
        bounds_deg = box_around(held_deg, bounds_deg)
        if bounds_deg == held_deg:
            return None
    tag = json.dumps({"source": source, "bounds_deg": bounds_deg})

    def look(file: Any) -> _Cut:
        _check_usable(url, file)
        return _Cut(url, path, tag, _window(url, file, corner, bounds_deg), file.dtypes[0])

    return with_remote(url, look, patience)


def _check_usable(url: str, file: Any) -> None:
    """Raise `InputError` unless a file is a north-up DEM in degrees."""
    where = without_secrets(url)
    transform = file.transform
    bands, alpha = bands_of(file)
    if len(bands) != 1:
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
    if alpha is not None or MaskFlags.per_dataset in file.mask_flag_enums[0]:
        raise InputError(
            f"{where} marks its voids by a mask, which a part of it would lack; fetch it by other "
            "means and give it to `skyline build`"
        )


def _window(url: str, file: Any, corner: tuple[int, int], bounds_deg: Bounds) -> Window:
    """Return a tile's pixels within bounds; `InputError` for another tile's file."""
    west, south, _, north = bounds_deg
    east = west + width_deg(bounds_deg)
    step_east = file.transform.a
    step_north = -file.transform.e
    left = file.transform.c
    top = file.transform.f
    middle = left + 0.5 * file.width * step_east
    turn = 360.0 * round((middle - 0.5 * (west + east)) / 360.0)
    # Bounds this near to a pixel's edge lie on it, up to rounding.
    slack = 1e-6
    first_col = max(math.floor((west + turn - left) / step_east + slack), 0)
    last_col = min(math.ceil((east + turn - left) / step_east - slack), file.width)
    first_row = max(math.floor((top - north) / step_north + slack), 0)
    last_row = min(math.ceil((top - south) / step_north - slack), file.height)
    lat, lon = corner
    half_width_deg = 0.5 * file.width * step_east
    half_height_deg = 0.5 * file.height * step_north
    east_deg = float(wrapped_deg(middle - lon - 0.5))
    north_deg = top - half_height_deg - lat - 0.5
    # Tiles reach over their borders by some pixels: a file with less than a tenth of its width in
    # the cell is a neighbour.
    outside = any(
        0.5 + half - abs(off) < 0.1 * min(2.0 * half, 1.0)
        for off, half in ((east_deg, half_width_deg), (north_deg, half_height_deg))
    )
    if outside or first_col >= last_col or first_row >= last_row:
        raise InputError(
            f"{without_secrets(url)} covers {left:.4f},{top - file.height * step_north:.4f},"
            f"{left + file.width * step_east:.4f},{top:.4f}, no part of the bounds in the cell of "
            f"one degree at {lon},{lat}; check the source's template: {{lat}} and {{lon}} are a "
            "tile's south-west corner"
        )
    return Window(first_col, first_row, last_col - first_col, last_row - first_row)


def _fetch(cut: _Cut, earlier: Sequence[Path], patience: Patience) -> None:
    left, top, width, height = cut.window.flatten()
    samples = np.empty((height, width), cut.dtype)
    known = np.zeros((height, width), bool)

    def read(file: Any) -> bytes:
        """Return the file's content; a repeated call continues where one failed."""
        for folder in (cut.path.parent, *earlier):
            _copy_held(folder / cut.path.name, cut, file.transform, samples, known)
        block_rows = int(file.block_shapes[0][0])
        start = top
        while start < top + height:
            stop = min((start // block_rows + 1) * block_rows, top + height)
            rows = slice(start - top, stop - top)
            unknown = np.flatnonzero(~known[rows].all(axis=0))
            if len(unknown):
                cols = slice(int(unknown[0]), int(unknown[-1]) + 1)
                strip = Window(left + cols.start, start, cols.stop - cols.start, stop - start)
                samples[rows, cols] = file.read(1, window=strip)
                known[rows, cols] = True
            start = stop
        return _geotiff(samples, cut, file)

    write_whole(cut.path, with_remote(cut.url, read, patience))


def _copy_held(
    path: Path, cut: _Cut, transform: Any, samples: NDArray[Any], known: BoolArray
) -> None:
    """Copy samples of a cut from a file that was fetched earlier."""
    with suppress(RasterioError, ValueError), rasterio.open(path, driver="GTiff") as file:
        tag = json.loads(file.tags().get(_TAG, "{}"))
        fetched = tag.get("source"), file.dtypes[0], file.transform.a, file.transform.e
        kind = np.dtype(cut.dtype).name
        if fetched != (without_secrets(cut.url), kind, transform.a, transform.e):
            return
        col = round((file.transform.c - transform.c) / transform.a)
        row = round((file.transform.f - transform.f) / transform.e)
        held = Window(col, row, file.width, file.height)
        both = windows.intersection(held, cut.window)
        there, here = (
            Window(both.col_off - one.col_off, both.row_off - one.row_off, both.width, both.height)
            for one in (held, cut.window)
        )
        samples[here.toslices()] = file.read(1, window=there)
        known[here.toslices()] = True


def _geotiff(samples: NDArray[Any], cut: _Cut, origin: Any) -> bytes:
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff",
            width=samples.shape[1],
            height=samples.shape[0],
            count=1,
            dtype=samples.dtype,
            crs=origin.crs,
            transform=transform_of(cut.window, origin.transform),
            nodata=origin.nodata,
            compress="deflate",
            predictor=3 if samples.dtype.kind == "f" else 2,
            tiled=True,
        ) as file:
            file.write(samples, 1)
            file.scales = origin.scales
            file.offsets = origin.offsets
            file.units = origin.units
            # This tag says whether samples stand for points or areas.
            kept = origin.tags().get("AREA_OR_POINT", "Area")
            file.update_tags(**{_TAG: cut.tag}, AREA_OR_POINT=kept)
        return bytes(memory.getbuffer())

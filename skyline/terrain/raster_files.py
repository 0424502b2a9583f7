"""Rasters that GDAL opens, with their bands and their errors.

A raster is a plain file, a file in an archive, or a file on a server.
"""

import gzip
import os
import re
import warnings
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import IO, Any, cast
from zipfile import BadZipFile, ZipFile

import numpy as np
import rasterio
from rasterio.enums import ColorInterp
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from skyline.errors import FetchError, InputError, one_line
from skyline.files.disk import is_file
from skyline.files.gdal_names import archive_of

NOT_RECOGNIZED = "not recognized as being in"
"""GDAL's words for a file of an unknown format."""

_BLOCK_BYTES = 1 << 20
"""Bytes of a file that are unpacked at a time."""

_SETTINGS = {
    # Enough to decode a row of tiles; GDAL's default is 5 % of the machine's memory.
    "GDAL_CACHEMAX": 64 << 20,
    # Otherwise GDAL leaves out the vertical part of a GeoTIFF's CRS.
    "GTIFF_REPORT_COMPD_CS": "YES",
    "GDAL_HTTP_CONNECTTIMEOUT": "30",
    # Reading fails if less than 1 kB a second arrives for 30 seconds.
    "GDAL_HTTP_LOW_SPEED_LIMIT": "1000",
    "GDAL_HTTP_LOW_SPEED_TIME": "30",
    "GDAL_HTTP_MAX_RETRY": "3",
}
"""GDAL's settings for reading heights."""
_HGT_BYTES = {2 * side * side for side in (1201, 3601)}
"""Lengths of the .hgt tiles of 3 and of 1 arc-second."""
_ASCII_HEADER = re.compile(
    rb"\s*(?:ncols|nrows|[xy]ll(?:corner|center)|cellsize|dx|dy|nodata_value)\s+\S+", re.IGNORECASE
)
"""An entry of the header of an ESRI ASCII grid."""
_SECRET = re.compile(r"(?<=://)[^/@\s]*@|\?[^\"'\s)]*")
"""A user with a password in an address, or its query."""
_NO_ANSWER = re.compile(
    r"HTTP (response|error) code|CURL error|[Ff]ailed to connect|open /vsicurl/|"
    r"^'/vsicurl/\S*' does not exist"
)
"""GDAL's words where a server fails."""


@contextmanager
def opened_raster(source: str, header_only: bool = False, **settings: str) -> Iterator[Any]:
    """Open a raster with further GDAL settings; yield the rasterio dataset.

    With ``header_only`` its samples must not be read, since a packed tile may not be unpacked. A
    failure while the raster is open becomes a one-line error: `InputError`, or `FetchError` if a
    server fails.
    """
    if "://" in source:
        # Otherwise GDAL asks a server for a dozen other files in the DEM's folder.
        settings = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR", **settings}
    try:
        with rasterio.Env(**_SETTINGS, **settings), ExitStack() as held:
            yield _dataset(source, header_only, held)
    except RasterioError as error:
        reason = re.sub(r"/vsimem/[^/]*/", "", one_line(error.__cause__ or error))
        if "://" in source:
            source = without_secrets(source)
            reason = without_secrets(reason)
        if _NO_ANSWER.search(reason):
            raise FetchError(
                f"{source} cannot be read from its server ({reason}); check the address and "
                "whether the server is up"
            ) from error
        raise InputError(
            f"{source} cannot be read as a raster ({reason}); expected a whole GeoTIFF, ESRI ASCII "
            "grid, .hgt (named after its corner, like N46E009.hgt) or another format that GDAL "
            "opens, plain or in a .gz or .zip"
        ) from error


def _dataset(source: str, header_only: bool, held: ExitStack) -> Any:
    """Return a raster's rasterio dataset, open as long as ``held``."""
    with warnings.catch_warnings():
        # A raster without a georeference is refused later, with an error of its own.
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        if not _is_gzip(source):
            return held.enter_context(rasterio.open(source))
        content = _zeros_for(source) if header_only else b""
        if not content:
            # GDAL opens it as well, but does not compare the checksum.
            with unpacked(source) as packed:
                content = packed.read()
        if not content:
            raise InputError(f"{source} is empty; fetch it again")
        # The .hgt driver reads the corner from the file's name.
        memory = rasterio.MemoryFile(content, filename=Path(source).stem)
        return held.enter_context(held.enter_context(memory).open())


def _zeros_for(source: str) -> bytes:
    """Return as many zeros as a packed .hgt tile has bytes.

    Other files have none. Such a tile has no header: its name and its length say everything but the
    samples.
    """
    if not source.lower().endswith(".hgt.gz"):
        return b""
    with Path(source).open("rb") as file:
        file.seek(max(os.fstat(file.fileno()).st_size - 4, 0))
        # A gzip file ends with the length of its last member.
        length = int.from_bytes(file.read(4), "little")
    return bytes(length) if length in _HGT_BYTES else b""


def _is_gzip(source: str) -> bool:
    return source.lower().endswith(".gz") and is_file(source)


@contextmanager
def unpacked(source: str) -> Iterator[IO[bytes]]:
    """Open the content of a file, a ``.gz`` or a member.

    Checksums are compared. Raises `InputError` if it cannot be read to the end.
    """
    member = archive_of(source)
    try:
        with ExitStack() as held:
            if member is not None:
                yield held.enter_context(held.enter_context(ZipFile(member[0])).open(member[1]))
            elif _is_gzip(source):
                yield cast("IO[bytes]", held.enter_context(gzip.open(source)))
            else:
                yield held.enter_context(Path(source).open("rb"))
    # `zipfile` raises a `RuntimeError` for a password and for an unknown way of packing.
    except (OSError, EOFError, KeyError, RuntimeError, zlib.error, BadZipFile) as error:
        raise InputError(
            f"{source} cannot be unpacked ({error}); the file is damaged or not what its ending "
            "says: fetch it again"
        ) from error


def check_whole(source: str) -> None:
    """Read an archive's member to compare its checksum; GDAL does not."""
    with unpacked(source) as content:
        while content.read(_BLOCK_BYTES):
            pass


def filled_share(source: str, dataset: Any) -> float:
    """Return the greatest share of a grid that listed points can fill.

    GDAL lays the grid through all points, and gives 0 where there is no point.
    """
    with unpacked(source) as content:
        lines = sum(block.count(b"\n") for block in iter(lambda: content.read(_BLOCK_BYTES), b""))
    return float(lines / (dataset.width * dataset.height))


def check_count(source: str, dataset: Any) -> None:
    """Raise `InputError` if a text grid has more values than noted.

    GDAL reads them in order, whatever the lines, so the rows of such a grid would be sheared. Too
    few values are an error of GDAL's own.
    """
    with unpacked(source) as content:
        block = content.read(_BLOCK_BYTES)
        begin = 0
        while header := _ASCII_HEADER.match(block, begin):
            begin = header.end()
        block = block[begin:]
        count = 0
        before = False
        while block:
            is_text = np.frombuffer(block, dtype=np.uint8) > ord(" ")
            count += int(np.count_nonzero(is_text[1:] & ~is_text[:-1]))
            count += bool(is_text[0]) and not before
            before = bool(is_text[-1])
            block = content.read(_BLOCK_BYTES)
    if count > dataset.width * dataset.height:
        raise InputError(
            f"{source} has {count} values, and its header says {dataset.width} x {dataset.height}; "
            "correct ncols and nrows, or its rows are cut at wrong places"
        )


def bands_of(dataset: Any) -> tuple[list[int], int | None]:
    """Return the numbers of value bands, and of the alpha band."""
    roles = list(enumerate(dataset.colorinterp, start=1))
    values = [number for number, role in roles if role is not ColorInterp.alpha]
    alpha = (number for number, role in roles if role is ColorInterp.alpha)
    return values, next(alpha, None)


def files_of(name: str) -> list[str]:
    """Return the files that GDAL reads for a local raster.

    They are the raster itself, files beside it with a georeference or a CRS, and the files that a
    virtual raster names; none if GDAL cannot open it.
    """
    if "://" in name or name.startswith("/vsi"):
        return []
    with warnings.catch_warnings(), suppress(RasterioError):
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(name) as dataset:
            return list(dataset.files)
    return []


def without_secrets(text: str) -> str:
    """Return text whose addresses have no user, password and query."""
    return _SECRET.sub("", text)

"""The tiles among the files of a folder or a zip archive.

GDAL says which files are rasters. Their sidecar files are ignored; files without heights, such as
texts and pictures, are left out with a warning. A file that may be a tile but cannot be read is an
error, since a mountain may be in it.
"""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath, PurePosixPath
from typing import Any
from zipfile import BadZipFile, ZipFile

import numpy as np
from rasterio.coords import BoundingBox
from rasterio.enums import ColorInterp

from skyline.errors import InputError, MissingFileError
from skyline.files.disk import is_file
from skyline.files.folders import is_of_system, left_out_in_words, names_in_words
from skyline.files.gdal_names import archive_of, for_gdal, member_name
from skyline.terrain.raster_files import (
    NOT_RECOGNIZED,
    bands_of,
    filled_share,
    opened_raster,
    unpacked,
)

_ZIP = ".zip"
_TILE_ENDINGS = (
    ".tif", ".tiff", ".gtiff", ".vrt", ".hgt", ".asc", ".img", ".bil", ".flt", ".jp2", ".dem",
    ".dt0", ".dt1", ".dt2", ".xyz",
    _ZIP, ".tar", ".tgz", ".7z", ".rar", ".bz2", ".xz", ".zst",
)  # fmt: skip
"""Endings of tiles and packed files: a file with one may be a tile, even if GDAL cannot open it."""
_BARE = {"EHdr", "ENVI", "GenBin"}
"""GDAL's formats of bare samples: GDAL opens any file that lies beside a header of its name."""
_REFERRING = {"VRT", "GTI"}
"""GDAL's formats whose files name other rasters; those rasters are not sidecar files."""
_GREYS = {ColorInterp.gray, ColorInterp.undefined, ColorInterp.alpha}
"""Roles of bands that may hold heights, and of the mask beside them."""


_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class _Raster:
    """A raster that GDAL opens in a folder."""

    name: str
    files: frozenset[str]
    """Names of the other files that GDAL reads with it."""
    is_picture: bool
    """Whether it has colours, or has 8 bits and no place on the map."""
    is_byte: bool
    """Whether its values have 8 bits, as in masks and shaded reliefs."""
    box: BoundingBox
    """Its outline, in its CRS."""
    header: str = ""
    """The header file of bare samples; empty in other formats."""
    size: int = 0
    """The number of bytes in the file of bare samples."""


def tiles_among(where: str, files: Sequence[Path]) -> list[str]:
    """Return the names of the rasters of heights among files of ``where``.

    ``where`` is a folder or an archive. Raises as `skyline.terrain.dem_files.dem_names`.
    """
    names = [name for file in files for name in _members(file)]
    rasters = _without_sidecars([one for name in names if (one := _raster_in(name, where))])
    tiles = _without_pictures(rasters)
    chosen = {one.name for one in tiles}
    known = chosen.union(*(one.files for one in rasters))
    stems = {_stem(name) for name in chosen}
    pictures = {one.name for one in rasters} - chosen
    others = [
        _shown(name, where)
        for name in names
        if name in pictures or not (name in known or _is_beside(name, stems))
    ]
    if not tiles:
        found = f" among {names_in_words(others)}" if others else ""
        raise InputError(
            f"{where} has no elevation files{found}; name the folder that holds them, or the files"
        )
    if others:
        about = left_out_in_words(others, f"raster{'s' if len(others) > 1 else ''} of heights")
        _log.warning("%s: %s; name one to have it read", where, about)
    return [one.name for one in tiles]


def _members(file: Path) -> list[str]:
    """Return an archive's members as GDAL names, or the file itself."""
    if file.suffix.lower() != _ZIP or not is_file(file):
        return [str(file)]
    try:
        with ZipFile(file) as archive:
            members = sorted(one.filename for one in archive.infolist() if not one.is_dir())
    except (OSError, BadZipFile) as error:
        raise InputError(f"{file} is not a zip archive ({error}); fetch it again") from error
    return [
        member_name(file, one)
        for one in members
        if not any(map(is_of_system, PurePosixPath(one).parts))
    ]


def _raster_in(name: str, where: str) -> _Raster | None:
    """Return the raster in a file, or None; raises as `skyline.terrain.dem_files.dem_names`."""
    # The rasters of STAC items would be fetched from servers.
    if name.lower().endswith((".json", ".geojson")):
        return None
    if not (archive_of(name) or is_file(name)):
        if _is_named_as_tile(name):
            raise MissingFileError(f"{name} is a link to a file that does not exist; remove it")
        return None
    try:
        # In large folders GDAL finds sidecar files faster one by one than in a list of all files.
        quick = {"GDAL_DISABLE_READDIR_ON_OPEN": "TRUE"}
        with opened_raster(for_gdal(name), header_only=True, **quick) as dataset:
            return _raster_of(name, dataset)
    except InputError as error:
        is_foreign = NOT_RECOGNIZED in str(error.__cause__)
        if not _is_named_as_tile(name) and (is_foreign or _is_text(name)):
            return None
        raise InputError(
            f"{error}; it may be a tile: mend or unpack it, name its raster, or move it out of "
            f"{where}"
        ) from error


def _raster_of(name: str, dataset: Any) -> _Raster | None:
    """Describe an open raster; None without samples, and for lists of points.

    Raises `InputError` if a file has several rasters, or if bare samples are truncated.
    """
    bands, _ = bands_of(dataset)
    if not bands:
        if any(map(_is_on_map, dataset.subdatasets)):
            raise InputError(f"{name} holds several rasters ({', '.join(dataset.subdatasets)})")
        return None
    # A text without a tile's ending may list peaks or viewpoints, which lie far apart.
    may_be_list = dataset.driver == "XYZ" and not _is_named_as_tile(name)
    if may_be_list and filled_share(name, dataset) < 0.5:
        return None
    is_byte = set(dataset.dtypes) == {"uint8"}
    # Where values have more than 8 bits, a palette only colours the heights.
    greys = _GREYS if is_byte else _GREYS | {ColorInterp.palette}
    has_colours = not set(dataset.colorinterp) <= greys
    is_picture = has_colours or (is_byte and (len(bands) > 1 or dataset.transform.is_identity))
    files = frozenset() if dataset.driver in _REFERRING else frozenset(dataset.files) - {name}
    found = _Raster(name, files, is_picture, is_byte, dataset.bounds)
    header = next((file for file in files if file.lower().endswith(".hdr")), "")
    if dataset.driver not in _BARE or not header:
        return found
    # Beside such a header GDAL takes any file for samples, even a projection or a text.
    least = dataset.width * dataset.height * sum(np.dtype(one).itemsize for one in dataset.dtypes)
    size = _size_of(name)
    if size >= least:
        return replace(found, header=header, size=size)
    if _is_named_as_tile(name):
        raise InputError(f"{name} has {size} bytes; expected {least} by its header {header}")
    return None


def _without_sidecars(rasters: Sequence[_Raster]) -> list[_Raster]:
    """Leave out rasters that belong to others, such as overviews and masks.

    If two rasters belong to each other, the first stays; if files of bare samples share a header,
    the shortest stays.
    """
    files = {one.name: one.files for one in rasters}
    owned = {
        file
        for one in rasters
        for file in one.files
        if not (one.name > file and one.name in files.get(file, ()))
    }
    shortest: dict[str, int] = {}
    for one in rasters:
        shortest[one.header] = min(one.size, shortest.get(one.header, one.size))
    return [one for one in rasters if one.name not in owned and one.size == shortest[one.header]]


def _without_pictures(rasters: Sequence[_Raster]) -> list[_Raster]:
    """Leave out pictures, masks and shaded reliefs.

    A mask or a shaded relief has 8 bits and lies over a raster of more bits. Where all rasters have
    8 bits, as canopy models do, all may hold heights.
    """
    rasters = [one for one in rasters if not one.is_picture]
    boxes = np.array([one.box for one in rasters if not one.is_byte]).reshape(-1, 4)

    def lies_over(one: _Raster) -> bool:
        x = (one.box.left + one.box.right) / 2.0
        y = (one.box.bottom + one.box.top) / 2.0
        low = np.minimum(boxes[:, :2], boxes[:, 2:])
        high = np.maximum(boxes[:, :2], boxes[:, 2:])
        return bool(((low <= (x, y)) & ((x, y) <= high)).all(axis=1).any())

    return [one for one in rasters if not (one.is_byte and lies_over(one))]


def _is_on_map(name: str) -> bool:
    """Return whether a raster has a georeference."""
    with opened_raster(name) as dataset:
        return not dataset.transform.is_identity


def _size_of(name: str) -> int:
    member = archive_of(name)
    if member is None:
        return Path(name).stat().st_size
    with ZipFile(member[0]) as archive:
        return archive.getinfo(member[1]).file_size


def _is_text(name: str) -> bool:
    """Return whether a file's first kilobyte has no zero byte."""
    with unpacked(name) as content:
        return b"\0" not in content.read(1024)


def _is_named_as_tile(name: str) -> bool:
    return name.lower().removesuffix(".gz").endswith(_TILE_ENDINGS)


def _stem(name: str) -> str:
    """Return the path of a tile without the ending of its format."""
    return str(PurePath(re.sub(r"(?i)\.gz$", "", name)).with_suffix(""))


def _is_beside(name: str, stems: set[str]) -> bool:
    """Return whether a file is named after a tile, such as ``dem.prj``."""
    path = PurePath(name)
    parts = path.name.split(".")
    return any(str(path.with_name(".".join(parts[:n]))) in stems for n in range(1, len(parts)))


def _shown(name: str, where: str) -> str:
    """Return a file's name within a folder or an archive."""
    path = Path(*(archive_of(name) or (name,)))
    base = Path(where).absolute()
    return str(path.relative_to(base if base.is_dir() else base.parent))

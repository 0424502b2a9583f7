"""The files of a DEM, found from the paths that users give.

A path is a file, an address, a zip archive, or a folder of these.
"""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from skyline.errors import InputError, MissingFileError
from skyline.files.disk import is_file
from skyline.files.folders import files_in
from skyline.files.gdal_names import for_gdal

Paths = str | os.PathLike[str] | Iterable[str | os.PathLike[str]]
"""One or several elevation files, folders or zip archives of them, addresses, or GDAL names."""


def dem_names(paths: Paths) -> tuple[str, ...]:
    """Return the GDAL names of a DEM's rasters, in order.

    Names of files are absolute. A folder or a zip archive stands for the rasters in it, in order of
    path. A file that is named itself is not opened here.

    Raises
    ------
    MissingFileError
        There is no such file, or a link in a folder leads nowhere.
    InputError
        A path is not text, or not UTF-8; a folder or an archive cannot be read, has no elevation
        files, or has a file that may be a tile but cannot be read.
    """
    is_one = isinstance(paths, str | bytes | os.PathLike | Mapping) or not np.iterable(paths)
    several: Any = [paths] if is_one else paths
    return tuple(name for given in several for name in _names_of(given))


def _names_of(given: Any) -> list[str]:
    """Return the names of one path's rasters; raises as `dem_names`."""
    path = os.fspath(given) if isinstance(given, os.PathLike) else given
    if not isinstance(path, str):
        raise no_dem(given)
    if not path:
        raise InputError("a DEM was given without a name; name its files, or the folder of them")
    if "://" not in path and os.path.isdir(path):  # noqa: PTH112  (as in `is_file`)
        return _tiles_among(path, files_in(Path(path).absolute()))
    if path.lower().endswith(".zip") and is_file(path):
        return _tiles_among(path, [Path(path).absolute()])
    return [absolute_name(path)]


def absolute_name(path: str | Path) -> str:
    """Return a path made absolute, alone or in a GDAL name.

    Raises `MissingFileError` if there is no such file and the name is not an address or a GDAL
    name, and `InputError` for a name that is not UTF-8.
    """
    text = str(path)
    if is_file(text):
        return for_gdal(str(Path(text).absolute()))
    if "://" in text or text.startswith("/vsi"):
        return for_gdal(text)
    if re.match(r"[A-Za-z][A-Za-z0-9_+]+:", text):
        parts = re.split(r"([:\"])", text)
        named = (str(Path(p).absolute()) if p and is_file(p) else p for p in parts)
        return for_gdal("".join(named))
    is_pattern = bool(set("*?[") & set(text))
    remedy = "name its folder, or the files" if is_pattern else "check its path"
    raise MissingFileError(f"there is no file {text}; {remedy}")


def _tiles_among(where: str, files: Sequence[Path]) -> list[str]:
    from skyline.terrain.dem_folders import tiles_among  # noqa: PLC0415  (rasterio is slow to load)

    return tiles_among(where, files)


def no_dem(given: object) -> InputError:
    """Return the error for a value that cannot be a DEM."""
    return InputError(
        f"the DEM is of type {type(given).__name__}; expected paths, a DataArray, an open rasterio "
        "dataset or a HeightField, which is made of an array of heights and its place on the map"
    )

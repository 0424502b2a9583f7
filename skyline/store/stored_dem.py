"""The DEM that a store was built from, and the curvature that it was rendered with."""

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path

from skyline.errors import StoreError, StoreMismatchError
from skyline.geodesy import Curvature
from skyline.store import StoreHeader
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField


def read_dem_of(header: StoreHeader, paths: Sequence[str | Path] = ()) -> HeightField:
    """Read the DEM from which a store was built, with the same options.

    ``paths`` are the DEM's files, if they have moved.

    Raises
    ------
    StoreMismatchError
        The files are those of another DEM.
    MissingFileError
        The files do not exist.
    """
    options = DemOptions.from_json(header.config.get("dem_options"))
    terrain = read_dem(list(paths) or list(header.dem_files), options)
    check_dem(header, terrain)
    return terrain


def check_dem(header: StoreHeader, terrain: HeightField) -> None:
    """Raise `StoreMismatchError` unless a store was built from this terrain."""
    if terrain.digest != header.dem_digest:
        raise StoreMismatchError(
            f"the DEM's digest is {terrain.digest[:12]}, the store was built from "
            f"{header.dem_digest[:12]} ({', '.join(header.dem_files) or 'no file'}); give that DEM"
        )


def curvature_of(header: StoreHeader) -> Curvature:
    """Return the curvature a store was rendered with; the default where the header lacks it.

    Raises `StoreError` where its value in the header is not a curvature.
    """
    stored = header.config.get("curvature")
    if not isinstance(stored, dict):
        return Curvature()
    names = {f.name for f in fields(Curvature)}
    try:
        return Curvature(**{name: value for name, value in stored.items() if name in names})
    except (TypeError, ValueError) as error:
        raise StoreError(
            f"the store's curvature is {stored!r}, which is not a curvature ({error}); "
            "build the store again"
        ) from error

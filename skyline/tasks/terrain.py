"""A command's elevation model: reading, curvature, and outputs beside it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from skyline.errors import InputError
from skyline.files.folders import lies_in_any
from skyline.geodesy.earth import Curvature
from skyline.progress import Step
from skyline.tasks.listener import Listener
from skyline.terrain.dem import read_dem
from skyline.terrain.dem_files import dem_names
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions


def read_terrain(listener: Listener, dem: Sequence[str], crs: str | None) -> HeightField:
    """Read an elevation model from files, or folders of them.

    ``crs`` is the CRS of files that name none; raises `InputError` if it contradicts the one that
    they name. If reading takes long, a note names the step.
    """
    with listener.slow(Step.READING):
        names = dem_names(dem)
        if crs is not None:
            from skyline.terrain.named_crs import check_named_crs  # noqa: PLC0415  (rasterio is slow)

            check_named_crs(names, crs)
        return read_dem(names, DemOptions(crs=crs))


def curvature_of(terrain: HeightField, refraction_k: float | None) -> Curvature:
    """Return the curvature of a terrain's world, with any refraction given."""
    usual = terrain.frame.curvature
    return usual if refraction_k is None else replace(usual, refraction_k=refraction_k)


def refuse_in_dem(output: Path, dem: Sequence[str]) -> None:
    """Raise `InputError` for an output in a folder of elevation files."""
    if lies_in_any(output, dem):
        raise InputError(f"{output} would become a part of the DEM; choose another folder for it")

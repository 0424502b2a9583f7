"""The elevation model of a command: how it is read, and what must not become a part of it."""

from collections.abc import Sequence
from pathlib import Path

from skyline.errors import InputError
from skyline.files import lies_in_any
from skyline.tasks.listener import Listener
from skyline.terrain.dem import read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.provenance import DemOptions


def read_terrain(listener: Listener, dem: Sequence[str], crs: str | None) -> HeightField:
    """Read an elevation model from files, or folders of them.

    ``crs`` is of files that name none. If reading takes long, a note names the step.
    """
    with listener.slow("reading the elevation model"):
        return read_dem(dem, DemOptions(crs=crs))


def refuse_in_dem(output: Path, dem: Sequence[str]) -> None:
    """Raise `InputError` for an output in a folder of elevation files, as it is one of them."""
    if lies_in_any(output, dem):
        raise InputError(f"{output} would become a part of the DEM; choose another folder for it")

"""The position on the terrain that each pixel of a photo shows."""

from dataclasses import dataclass
from pathlib import Path

from skyline.errors import suffix_of
from skyline.files.disk import check_outputs
from skyline.files.gdal_names import on_disk
from skyline.ground.pixel_places import PIXEL_FILES, PixelPlaces
from skyline.tasks.listener import Listener
from skyline.tasks.photo_task import PosedTask
from skyline.tasks.standing import shown_pose
from skyline.tasks.terrain import read_terrain, refuse_in_dem
from skyline.terrain.dem_files import dem_names
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelsTask(PosedTask):
    """A photo, its camera's pose, and the file to write."""

    output: Path
    """File of the kinds of `PIXEL_FILES`."""
    step: int = 1
    """Distance of the rows and columns that are taken."""


def place_pixels(task: PixelsTask, listener: Listener) -> PixelPlaces:
    """Write the positions on the terrain that a photo's pixels show.

    Raises `InputError` for an output that is part of the DEM or of another kind, and if the photo
    or its pose cannot be read.
    """
    suffix = suffix_of(task.output, PIXEL_FILES)
    names = dem_names(task.dem)
    check_outputs([task.output], [task.photo, task.pose, *map(Path, map(on_disk, names))])
    if suffix == ".tif":
        refuse_in_dem(task.output, task.dem)
    photo, noted = task.read()
    terrain = read_terrain(listener, names, task.crs)
    with listener.progress("following rays") as progress, Viewer(terrain) as viewer:
        pose = shown_pose(noted, viewer, listener)
        places = viewer.places(pose, photo, task.step, progress)
    places.save(task.output, pose)
    return places

"""Photos laid on the ground as one orthophoto."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline.camera.projection import Projection
from skyline.errors import InputError, suffix_of
from skyline.files.disk import check_outputs
from skyline.files.gdal_names import on_disk
from skyline.pose.pose_files import read_posed
from skyline.report.geotiff import GEOTIFFS
from skyline.report.ortho import (
    grid_of,
    lay,
    mosaic,
    place_sd_m,
    write_ortho,
    write_pixel_lengths,
)
from skyline.tasks.listener import Listener
from skyline.tasks.standing import assumed_lines, shown_pose
from skyline.tasks.terrain import read_terrain, refuse_in_dem
from skyline.terrain.dem_files import dem_names
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class OrthoTask:
    """Photos, the poses of their cameras, and the files to write."""

    photos: Sequence[Path]
    poses: Sequence[Path]
    """A file for each photo, or one file with a line for each."""
    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    output: Path
    """GeoTIFF of the colours."""
    pixel_lengths: Path | None = None
    """GeoTIFF of the lengths of pixels on the ground."""
    resolution_m: float | None = None
    """Size of a cell; by default as the photos show it."""
    projection: Projection | None = None
    """By default from the photos."""


def lay_photos(task: OrthoTask, listener: Listener) -> list[str]:
    """Write photos as they lie on the ground; return lines about it.

    Raises `InputError` for outputs of another kind or in the folder of the DEM, for poses of other
    photos, and as `grid_of`.
    """
    outputs = [task.output, *filter(None, [task.pixel_lengths])]
    for path in outputs:
        suffix_of(path, GEOTIFFS)
        refuse_in_dem(path, task.dem)
    if task.resolution_m is not None and not 0.0 < task.resolution_m < np.inf:
        raise InputError(f"the resolution is {task.resolution_m:g} m; expected above 0")
    if len(task.poses) not in {1, len(task.photos)}:
        raise InputError(
            f"{len(task.poses)} poses are given for {len(task.photos)} photos; give one for each, "
            "in their order, or one file with a line for each photo"
        )
    names = dem_names(task.dem)
    check_outputs(outputs, [*task.photos, *task.poses, *map(Path, map(on_disk, names))])
    files = task.poses if len(task.poses) > 1 else [task.poses[0]] * len(task.photos)
    posed = [
        read_posed(photo, pose, task.projection)
        for photo, pose in zip(task.photos, files, strict=True)
    ]
    terrain = read_terrain(listener, names, task.crs)
    with Viewer(terrain) as viewer, listener.progress("laying photos") as progress:
        photos = [photo for photo, _ in posed]
        poses = [shown_pose(one, viewer, listener) for _, one in posed]
        views = [viewer.ground_view(pose, photo) for pose, photo in zip(poses, photos, strict=True)]
        grid = grid_of(views, task.resolution_m)
        whole = lay(views[0], photos[0].rgb, grid)
        for number, (view, photo) in enumerate(zip(views, photos, strict=True)):
            progress(number, len(views))
            if number:
                whole = mosaic([whole, lay(view, photo.rgb, grid)])
        progress(len(views), len(views))
    if not whole.is_seen.any():
        raise InputError("no cell of the ground is seen; give a finer resolution")
    write_ortho(task.output, whole, grid, terrain)
    if task.pixel_lengths is not None:
        write_pixel_lengths(task.pixel_lengths, whole, grid, terrain)
    seen = whole.pixel_m[whole.is_seen]
    line = (
        f"{task.output}: {grid.cols} x {grid.rows} cells of {grid.cell_m:.3g} m, "
        f"{100.0 * len(seen) / whole.is_seen.size:.0f} % of them seen; a pixel is "
        f"{float(np.median(seen)):.2g} m long on the ground, and its place good to "
        f"{place_sd_m(views, grid):.2g} m (medians)"
    )
    assumed = (pose.assumed(photo) for pose, photo in zip(poses, photos, strict=True))
    return [line, *assumed_lines(*assumed)]

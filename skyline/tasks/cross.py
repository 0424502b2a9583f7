"""Where the same thing stands in two or more photos."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.camera.pixels import Pixel
from skyline.errors import InputError
from skyline.ground.crossing import Crossing, Ray, check_enough, cross
from skyline.pose.pose_files import read_posed
from skyline.tasks.listener import Listener
from skyline.tasks.standing import joined_assumptions, shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.terrain.heightfield import HeightField
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossTask:
    """Photos with their poses, and one thing's pixel in each."""

    photos: Sequence[Path]
    poses: Sequence[Path]
    """Files of the poses, in the order of the photos."""
    pixels: Sequence[Pixel]
    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Crossed:
    """A crossing on the map.

    Attributes
    ----------
    crossing : Crossing
    lon, lat : float
        Degrees (WGS 84).
    above_ground_m : float
        NaN off the elevation model.
    assumed : str
        The standard errors of poses without a covariance, in words; empty if there are none.
    """

    crossing: Crossing
    lon: float
    lat: float
    above_ground_m: float
    assumed: str


def cross_photos(task: CrossTask, listener: Listener) -> Crossed:
    """Return where the rays through pixels of photos cross.

    Raises `InputError` if there are not as many poses and pixels as photos, a photo or its pose
    cannot be read, or the rays do not cross.
    """
    counts = {len(task.photos), len(task.poses), len(task.pixels)}
    if len(counts) > 1:
        raise InputError(
            f"{len(task.photos)} photos, {len(task.poses)} poses and {len(task.pixels)} pixels are "
            "given; expected one --pose and one --pixel for each photo, in the photos' order"
        )
    check_enough(len(task.photos))
    terrain = read_terrain(listener, task.dem, task.crs)
    with Viewer(terrain) as viewer:
        rays = [
            _ray(file, pose, pixel, viewer, listener)
            for file, pose, pixel in zip(task.photos, task.poses, task.pixels, strict=True)
        ]
    found = cross(rays, viewer.curvature)
    assumed = joined_assumptions(ray.pose.assumed(ray.photo) for ray in rays)
    return _on_map(found, terrain, assumed)


def _ray(file: Path, pose: Path, pixel: Pixel, viewer: Viewer, listener: Listener) -> Ray:
    """Return the ray of a photo's pixel."""
    photo, noted = read_posed(file, pose)
    return Ray(pose=shown_pose(noted, viewer, listener), photo=photo, pixel=pixel)


def _on_map(found: Crossing, terrain: HeightField, assumed: str) -> Crossed:
    lon, lat = terrain.frame.to_lonlat(found.easting_m, found.northing_m)
    ground_m = float(terrain.height_at(easting_m=found.easting_m, northing_m=found.northing_m))
    return Crossed(
        crossing=found,
        lon=float(lon),
        lat=float(lat),
        above_ground_m=found.elevation_m - ground_m,
        assumed=assumed,
    )

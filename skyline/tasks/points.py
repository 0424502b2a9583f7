"""Orienting a photo by control points."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from skyline.camera import Projection
from skyline.control_points import KnownCamera, PointErrors, PointsFit, fit_points
from skyline.errors import InputError, check_suffix
from skyline.files import check_outputs
from skyline.photo.photo import read_photo
from skyline.photo.skyline import PhotoSkyline
from skyline.point_files import (
    POINT_FILES,
    is_of_qgis,
    read_control_points,
    write_control_points,
)
from skyline.pose_file import read_posed
from skyline.tasks.listener import Listener
from skyline.tasks.orient import CameraAt
from skyline.tasks.standing import shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.view import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class PointsTask:
    """A photo and its control points."""

    photo: Path
    points: Path
    """File of the kinds of `POINT_FILES`."""
    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    at: CameraAt = CameraAt()  # noqa: RUF009  (it is frozen)
    pose: Path | None = None
    """File of a pose to refine, in place of a position."""
    fov_deg: float | None = None
    """By default from the photo."""
    projection: Projection | None = None
    """By default from the photo."""
    errors: PointErrors = PointErrors()  # noqa: RUF009  (it is frozen)
    residuals: Path | None = None
    """File of the points with their residuals, of the kinds of `POINT_FILES`."""


def orient_by_points(task: PointsTask, listener: Listener) -> PointsFit:
    """Return the pose that control points give; write their residuals.

    Raises `InputError` for points or a pose of another photo, for too few points, without a place,
    and for a residual file of another kind, and `OffMapError` for a place or a point off the map.
    """
    if task.residuals is not None:
        check_suffix(task.residuals, POINT_FILES)
    check_outputs([task.residuals], [task.photo, task.points, *filter(None, [task.pose])])
    if task.pose is not None and (task.at != CameraAt() or task.fov_deg is not None):
        raise InputError(
            "--pose has the position, the heading and the field of view; leave --at, --elevation, "
            "--position-sd, --heading and --fov-deg out"
        )
    points = read_control_points(task.points)
    noted = None
    if task.pose is None:
        picture = read_photo(task.photo, task.fov_deg, projection=task.projection)
    else:
        picture, noted = read_posed(task.photo, task.pose, task.projection)
    photo = picture.blank
    if task.residuals is not None and picture.is_turned and is_of_qgis(task.residuals):
        raise InputError(
            f"{task.residuals} is for QGIS, which shows {task.photo} as its file has it, and EXIF "
            "turns that photo; name a .csv file"
        )
    points.check_photo(task.photo, photo.width_px, photo.height_px, picture.is_turned)
    if noted is None:
        task.at.position_of(photo, str(task.photo))  # Refused before the DEM is read
    elif noted.covariance is None:
        raise InputError(
            f"{task.pose} has no covariance, so nothing says how far it may be refined; give the "
            "output of `match --json` or `orient --json`, or its position with --at"
        )
    terrain = read_terrain(listener, task.dem, task.crs)
    with Viewer(terrain) as viewer:
        if noted is not None:
            known = KnownCamera.of_pose(shown_pose(noted, viewer, listener))
        else:
            known = _standing(task, viewer, photo)
        found = fit_points(viewer, photo, points, known, task.errors, str(task.photo))
    if task.residuals is not None:
        write_control_points(task.residuals, points, found.residual_px, found.is_used)
    return found


def _standing(task: PointsTask, viewer: Viewer, photo: PhotoSkyline) -> KnownCamera:
    """Return the camera at the given position, or the photo's own."""
    position = task.at.position_of(photo, str(task.photo))
    if not position.position_sd_m > 0.0:
        raise InputError(
            f"the standard deviation of the position is {position.position_sd_m:g} m; expected "
            "above 0"
        )
    return KnownCamera.at(viewer, photo, **position._asdict(), heading_deg=task.at.heading_deg)

"""Orienting a photo by control points."""

from dataclasses import dataclass
from pathlib import Path

from skyline.errors import InputError, check_suffix
from skyline.files.disk import check_outputs
from skyline.orientation.control_points import KnownCamera, PointErrors, PointsFit, fit_points
from skyline.orientation.point_files import (
    POINT_FILES,
    is_of_qgis,
    read_control_points,
    write_control_points,
)
from skyline.photo.photo import Photo
from skyline.tasks.listener import Listener
from skyline.tasks.photo_task import CameraTask
from skyline.tasks.standing import shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class PointsTask(CameraTask):
    """A photo with control points, and what is known of its camera."""

    points: Path
    """File of the kinds of `POINT_FILES`."""
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
    points = read_control_points(task.points)
    photo, noted = task.read()
    if points.of_qgis:
        photo.check_upright(task.points)
    if task.residuals is not None and is_of_qgis(task.residuals):
        photo.check_upright(task.residuals)
    points.check_inside(task.photo, photo.width_px, photo.height_px)
    if noted is not None and noted.covariance is None:
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


def _standing(task: PointsTask, viewer: Viewer, photo: Photo) -> KnownCamera:
    """Return the camera at the given position, or the photo's own."""
    position = task.at.position_of(photo.noted, str(task.photo))
    if not position.position_sd_m > 0.0:
        raise InputError(
            f"the standard deviation of the position is {position.position_sd_m:g} m; expected "
            "above 0"
        )
    return KnownCamera.at(viewer, photo, **position._asdict(), heading_deg=task.at.heading_deg)

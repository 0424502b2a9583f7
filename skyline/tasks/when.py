"""Telling a photo's time or heading by the sun or the moon."""

from dataclasses import dataclass
from datetime import date, datetime

from skyline.camera.pixels import Pixel
from skyline.pose.pose import Pose
from skyline.sky.sun import Body, Sky, check_is_earth
from skyline.sky.sun_clock import (
    ClockTime,
    SunHeading,
    body_pointing,
    heading_at,
    shadow_pointing,
    times_at,
)
from skyline.tasks.listener import Listener
from skyline.tasks.photo_task import PosedTask
from skyline.tasks.standing import shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class WhenTask(PosedTask):
    """A photo of sun, moon or shadow, and its day or time."""

    marked: tuple[Pixel, ...]
    """The middle of a disc; or a shadow's tip and foot, and perhaps the top of what casts it."""
    body: Body = Body.SUN
    known: date | datetime
    """The day whose time is wanted, or the time at which the heading is wanted."""


@dataclass(frozen=True, slots=True)
class Told:
    """What sun or moon tells of a photo: times or a heading.

    Attributes
    ----------
    pose : Pose
        As it was given.
    times : list of ClockTime
        The likeliest first; empty if the time was given.
    heading : SunHeading or None
        None if the day was given.
    assumed : str
        The standard errors of a pose without a covariance, in words; empty if it has one.
    """

    pose: Pose
    times: list[ClockTime]
    heading: SunHeading | None = None
    assumed: str = ""


def tell_when(task: WhenTask, listener: Listener) -> Told:
    """Return when in a day a photo was taken, or its heading.

    Raises `InputError` if the photo or its pose cannot be read, a pixel cannot be used, or the body
    does not stand there, and `OffMapError` for a pose off the map.
    """
    photo, noted = task.read()
    terrain = read_terrain(listener, task.dem, task.crs)
    check_is_earth(terrain.frame.crs)
    with Viewer(terrain) as viewer:
        pose = shown_pose(noted, viewer, listener)
        if len(task.marked) == 1:
            pointing = body_pointing(pose, photo, task.marked[0])
        else:
            pointing = shadow_pointing(viewer.ground_view(pose, photo), pose, task.marked)
    assumed = pose.assumed(photo)
    sky = Sky(pose.lon, pose.lat, pose.eye_elevation_m)
    if isinstance(task.known, datetime):
        heading = heading_at(pose, pointing, sky, task.body, task.known)
        return Told(pose, [], heading, assumed)
    return Told(pose, times_at(pointing, sky, task.body, task.known, pose.lon), None, assumed)

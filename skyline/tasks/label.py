"""Labelling a photo with the names of its summits."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from skyline.errors import InputError, some_of, suffix_of
from skyline.files.disk import check_outputs, write_whole
from skyline.orientation.orienter import orienters
from skyline.photo.photo import Photo
from skyline.photo.read import find_skyline
from skyline.photo.skyline import PhotoSkyline
from skyline.pose.noted_pose import NotedPose
from skyline.pose.pose import Pose
from skyline.sky.sun import Body, Sky
from skyline.tasks.listener import Listener
from skyline.tasks.photo_task import CameraTask
from skyline.tasks.standing import shown_pose
from skyline.tasks.terrain import read_terrain
from skyline.view.peaks import read_peaks
from skyline.view.viewer import SeenBody, SeenPeak, UnseenPeaks, Viewer

if TYPE_CHECKING:
    from skyline.report.labels import UnnamedPeaks

LABEL_FILES = {".png": "png", ".jpg": "jpeg", ".jpeg": "jpeg", ".svg": "svg", ".json": "json"}
"""Kinds of files by suffix."""
_MOST_NAMES = 20
"""Most names in a line on peaks that are missing for one reason."""
_COLUMNS = ("name", "column_px", "row_px", "distance_m", "elevation_m")
_BODY_COLUMNS = ("name", "column_px", "row_px", "azimuth_deg", "elevation_deg", "is_hidden")


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelTask(CameraTask):
    """A photo to label, and what is known of its camera."""

    peaks: Path | None
    """Gazetteer; None draws only the sun and the moon."""
    output: Path
    """The copy with names, of a kind in `LABEL_FILES`."""
    ridges: bool = False
    """Whether the skyline of the elevation model is drawn, too."""
    time: datetime | None = None
    """When the photo was taken (UTC), to draw the sun and the moon."""


@dataclass(frozen=True, slots=True)
class _HeldCamera:
    """The camera of a photo, given or found."""

    pose: Pose
    confidence: float | None = None
    """Probability that its heading is right; None if that is not doubted."""


def label_photo(task: LabelTask, listener: Listener) -> list[str]:
    """Write the names of a photo's summits on a copy of it.

    Returns lines on what the copy shows, and why other peaks are missing. Raises `InputError` if
    the file's kind is unknown, the photo, the pose or the peaks cannot be read, or the camera's
    direction is not sure, and `OffMapError` for a position off the map.
    """
    suffix_of(task.output, LABEL_FILES)
    if task.peaks is None and task.time is None:
        raise InputError(
            "there is nothing to name; give the summits as --peaks FILE, or the photo's --time for "
            "the sun and the moon"
        )
    check_outputs([task.output], [task.photo, *filter(None, [task.pose, task.peaks])])
    photo, noted = task.read()
    known = noted if noted is not None else find_skyline(photo)
    terrain = read_terrain(listener, task.dem, task.crs)
    gazetteer = None if task.peaks is None else read_peaks(task.peaks, terrain.frame)
    with Viewer(terrain, gazetteer) as viewer:
        camera = _camera_of(task, known, viewer, listener)
        with listener.slow("looking for summits"):
            seen = viewer.summits(camera.pose, photo)
            bodies = _bodies(task, camera.pose, photo, viewer, listener)
            unnamed = _write(task, photo, camera, seen, bodies, viewer)
            unseen = viewer.unseen(camera.pose, photo, seen)
    if gazetteer is None:
        names = " and ".join(f"the {one.name}" for one in bodies)
        return [f"in the photo: {names or 'neither the sun nor the moon'}"]
    return [f"{len(seen)} of {len(gazetteer)} peaks are seen", *_missing(unnamed, unseen)]


def _missing(unnamed: "UnnamedPeaks", unseen: UnseenPeaks) -> Iterator[str]:
    """Yield a line for each reason why names are missing."""
    for reason, names in (
        ("no room for a name", unnamed.no_room),
        ("hidden by terrain", unseen.hidden),
        ("outside the photo", unseen.outside),
        ("off the elevation model", unseen.off_map),
    ):
        if names:
            yield f"{reason}: {some_of(names, _MOST_NAMES)}"
    if unnamed.no_font:
        yield replace(unnamed, no_room=()).named.removeprefix("; ")


def _camera_of(
    task: LabelTask, known: NotedPose | PhotoSkyline, viewer: Viewer, listener: Listener
) -> _HeldCamera:
    """Return the camera in its given pose, or in one that fits.

    Raises `InputError` if the pose that fits is more likely wrong than right.
    """
    if isinstance(known, NotedPose):
        return _HeldCamera(shown_pose(known, viewer, listener))
    with listener.slow("orienting the camera"), orienters(viewer.terrain) as orienter_at:
        orienter = orienter_at(task.at.position_of(known.noted, str(task.photo)))
        found = orienter.orient(known, name=str(task.photo), heading_deg=task.at.heading_deg)
    if found.likely is None:
        raise InputError(
            f"{task.photo}: the camera's direction is not sure ({found.refusal}); say roughly "
            "where it looked with --heading and --heading-slack, or its pose with --pose"
        )
    for line in found.to_text().splitlines():
        listener.note(line)
    return _HeldCamera(found.likely, found.confidence if found.refusal else None)


def _bodies(
    task: LabelTask, pose: Pose, photo: Photo, viewer: Viewer, listener: Listener
) -> list[SeenBody]:
    """Return the sun and the moon in a photo, noting any outside."""
    if task.time is None:
        return []
    found = viewer.bodies(pose, photo, task.time)
    for body in set(Body) - {one.name for one in found}:
        disc = Sky(pose.lon, pose.lat, pose.eye_elevation_m).look(Body(body), task.time)
        listener.note(
            f"the {body} is outside the photo, at azimuth {disc.azimuth_deg:.1f} and elevation "
            f"{disc.elevation_deg:.1f} degrees"
        )
    return found


def _write(
    task: LabelTask,
    photo: Photo,
    camera: _HeldCamera,
    seen: list[SeenPeak],
    bodies: list[SeenBody],
    viewer: Viewer,
) -> "UnnamedPeaks":
    """Write the file; return the peaks in view left unnamed."""
    from skyline.report.labels import UnnamedPeaks  # noqa: PLC0415  (slow to load)
    from skyline.report.overlay import draw_labels  # noqa: PLC0415

    kind = LABEL_FILES[suffix_of(task.output, LABEL_FILES)]
    confidence = camera.confidence
    if kind == "json":
        unsure = {} if confidence is None else {"confidence": confidence}
        records = [{name: getattr(one, name) for name in _COLUMNS} | unsure for one in seen]
        records += [{name: getattr(one, name) for name in _BODY_COLUMNS} for one in bodies]
        write_whole(task.output, json.dumps(records, indent=1) + "\n")
        return UnnamedPeaks()
    sight = viewer.look(camera.pose, photo) if task.ridges else None
    if confidence is not None:
        seen = [one.doubted(confidence) for one in seen]
    drawn, unnamed = draw_labels(photo, photo.rgb, seen, sight, kind, bodies)
    write_whole(task.output, drawn)
    return unnamed

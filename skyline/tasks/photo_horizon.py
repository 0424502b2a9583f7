"""The horizon that a photo shows, trees and houses included."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from skyline.camera.projection import Projection
from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizons_of, with_photo
from skyline.horizons.local_horizons import LocalHorizons
from skyline.photo.read import read_skyline
from skyline.pose.pose_files import read_pose
from skyline.tasks.listener import Listener
from skyline.tasks.standing import shown_pose
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import at_elevation
from skyline.view.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotoHorizonTask:
    """A photo with its pose, and the horizon to make."""

    photo: Path
    """A photo, a mask or a trace."""
    pose: Path
    """File of the pose."""
    step_deg: float
    """Step between azimuths."""
    curvature: Curvature
    projection: Projection | None = None
    """By default from the photo."""


def photo_horizon(
    task: PhotoHorizonTask, terrain: HeightField, listener: Listener
) -> LocalHorizons:
    """Return the horizon of a photo, completed with the terrain's.

    A note says how much of the turn the photo shows. Raises `InputError` if the photo or its pose
    cannot be read, or no column of the skyline is trusted.
    """
    record = read_pose(task.pose, task.photo)
    photo = read_skyline(task.photo, projection=task.projection or record.projection)
    noted = record.pose(photo)
    with Viewer(terrain) as viewer:
        pose = shown_pose(noted, viewer, listener)
    column_px = np.flatnonzero(photo.trusted)
    if not len(column_px):
        raise InputError(f"{task.photo}: no column of its skyline is trusted; correct the skyline")
    azimuth_deg, tangent = pose.camera(photo).directions(column_px, photo.row_px[column_px])
    eye = at_elevation(terrain, pose.easting_m, pose.northing_m, pose.eye_elevation_m)
    found = horizons_of(terrain, eye, task.step_deg, task.curvature)
    azimuth_deg = azimuth_deg + pose.convergence_deg
    joined, share = with_photo(found, azimuth_deg, np.degrees(np.arctan(tangent)))
    listener.note(
        f"{100.0 * share:.0f} % of the horizon is the photo's skyline; the rest is the DEM's"
    )
    return joined

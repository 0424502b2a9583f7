"""Eyes at positions and in poses that a person names, with notes.

The notes say where the eyes stand, what they cannot see, and what was assumed.
"""

import logging
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from skyline.horizons.local_horizons import LocalHorizons
from skyline.skylines import FLAG_HOLE, FLAG_TRUNCATED
from skyline.tasks.listener import Listener
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import IN_FLIGHT_M, Viewpoints, stand_at

if TYPE_CHECKING:
    from skyline.pose.noted_pose import NotedPose
    from skyline.pose.pose import Pose
    from skyline.view.viewer import Viewer

_log = logging.getLogger(__name__)


def stand_with_notes(
    terrain: HeightField,
    positions: Sequence[tuple[float, float]],
    eye_height_m: float,
    summit_within_m: float | None,
    listener: Listener,
) -> Viewpoints:
    """Place eyes at longitudes and latitudes.

    A note names each eye that stands on a summit, and another asks about eyes that are very high.
    Parameters and errors are as in `stand_at`.
    """
    lon, lat = np.transpose(positions)
    eyes = stand_at(
        terrain, lon=lon, lat=lat, eye_height_m=eye_height_m, summit_within_m=summit_within_m
    )
    if eye_height_m > IN_FLIGHT_M:
        highest_m = eyes.eye_elevation_m.max()
        listener.note(
            f"--eye-height {eye_height_m:g} is above the ground: it puts eyes at elevations of up "
            f"to {highest_m:.0f} m; if {eye_height_m:g} m is an elevation, give the height above "
            "the ground"
        )
    easting_m, northing_m = terrain.frame.from_lonlat(lon, lat)
    away_m = np.hypot(eyes.easting_m - easting_m, eyes.northing_m - northing_m)
    stands_m = eyes.eye_elevation_m - eye_height_m
    surface_m = terrain.height_at(lon=lon, lat=lat)
    eye_lon, eye_lat = terrain.frame.to_lonlat(eyes.easting_m, eyes.northing_m)
    for k, position in enumerate(f"{one[0]:.5f},{one[1]:.5f}" for one in positions):
        if summit_within_m:
            listener.note(
                f"{position}: the highest point within {summit_within_m:g} m is {eye_lon[k]:.5f},"
                f"{eye_lat[k]:.5f}, {stands_m[k]:.0f} m high and {away_m[k]:.0f} m away"
            )
        elif summit_within_m is None and stands_m[k] - surface_m[k] > 0.01:
            listener.note(
                f"{position} is beside a summit of the model: the eye is lifted to its height, "
                f"{stands_m[k]:.0f} m, from its slope at {surface_m[k]:.0f} m (--summit-within 0 "
                "leaves it there)"
            )
    return eyes


def shown_pose(noted: "NotedPose", viewer: "Viewer", listener: Listener) -> "Pose":
    """Return a noted pose on a viewer's terrain.

    A note says why the pose is doubted, and another why its eye was lifted.
    """
    pose, lifted = viewer.pose_of(noted)
    for note in filter(None, (noted.doubt, lifted)):
        listener.note(note)
    return pose


def joined_assumptions(assumed: Iterable[str]) -> str:
    """Return errors that `Pose.assumed` names, each once."""
    return "; ".join(dict.fromkeys(filter(None, assumed)))


def assumed_lines(*assumed: str) -> list[str]:
    """Return a line on errors that `Pose.assumed` names, if any."""
    words = joined_assumptions(assumed)
    return [f"errors assumed, since no covariance is given: {words}"] if words else []


def warn_of_border(found: LocalHorizons) -> None:
    """Log a warning where terrain beyond the data may be higher."""
    unsure = (found.flags & (FLAG_TRUNCATED | FLAG_HOLE)) != 0
    if unsure.any():
        percent = 100.0 * unsure.mean()
        _log.warning(
            "%s %% of the azimuths look over the DEM's border or over a hole, where higher "
            "terrain may be hidden; give a DEM of a wider area",
            f"{percent:.0f}" if percent >= 1.0 else "less than 1",
        )

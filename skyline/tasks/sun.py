"""Sun and moon above mountains on a day, and where they are over a summit."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

from skyline.errors import InputError
from skyline.geodesy.earth import Curvature
from skyline.horizons.horizon import horizons_of
from skyline.horizons.local_horizons import LocalHorizons
from skyline.sky.alignments import Standpoint, standpoints
from skyline.sky.sun import Body, check_is_earth
from skyline.tasks.listener import Listener
from skyline.tasks.standing import stand_with_notes, warn_of_border
from skyline.tasks.terrain import curvature_of, read_terrain
from skyline.terrain.heightfield import HeightField

_STEP_DEG = 0.125
"""Step of the horizon, which the sun crosses in half a minute."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DayTask:
    """Positions on a model, and the day on which the sun is followed there."""

    dem: Sequence[str]
    """Elevation files, or folders of them."""
    crs: str | None = None
    """CRS of elevation files that name none."""
    positions: Sequence[tuple[float, float]]
    """Longitudes and latitudes, degrees (WGS 84)."""
    day: date
    within_km: float
    """Radius around each position from which a summit is looked at."""
    eye_height_m: float
    summit_within_m: float | None = None
    """As for `stand_on`."""
    refraction_k: float | None = None
    """By default the Earth's usual value."""

    def __post_init__(self) -> None:
        if not self.within_km > 0.0:
            raise InputError(f"--within is {self.within_km:g}; expected kilometres above 0")

    def terrain(self, listener: Listener) -> tuple[HeightField, Curvature]:
        """Read the terrain; raises `InputError` for another world."""
        terrain = read_terrain(listener, self.dem, self.crs)
        check_is_earth(terrain.frame.crs)
        return terrain, curvature_of(terrain, self.refraction_k)


def horizons_on_day(task: DayTask, listener: Listener) -> LocalHorizons:
    """Return the horizons above which sun and moon stand; raises as `stand_at`."""
    terrain, curvature = task.terrain(listener)
    height_m, within_m = task.eye_height_m, task.summit_within_m
    eyes = stand_with_notes(terrain, task.positions, height_m, within_m, listener)
    with listener.progress("rendering") as progress:
        found = horizons_of(terrain, eyes, _STEP_DEG, curvature, progress)
    warn_of_border(found)
    return found


def standpoints_on_day(
    task: DayTask, summit: tuple[float, float], listener: Listener
) -> list[tuple[Body, Standpoint]]:
    """Return the places from which sun or moon stand over a summit.

    A note says if there is no such place. Raises as `standpoints`.
    """
    terrain, curvature = task.terrain(listener)
    found = [
        (body, one)
        for body in Body
        for lon, lat in task.positions
        for one in standpoints(
            terrain,
            summit,
            task.day,
            body,
            (lon, lat, task.within_km),
            eye_height_m=task.eye_height_m,
            curvature=curvature,
        )
    ]
    if not found:
        listener.note(
            f"neither the sun nor the moon stands over the summit on {task.day}, as seen from "
            f"within {task.within_km:g} km; give another day, or a greater --within"
        )
    return found

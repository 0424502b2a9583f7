"""Errors of the positions, altitudes and directions that photos note.

A compass is little more than a hint, and an altitude may count from another surface than the
terrain model's.
"""

import math
from dataclasses import dataclass

from skyline.photo.noted_place import NotedPlace


@dataclass(frozen=True, slots=True)
class NotedErrors:
    """Assumed scales of these errors."""

    gps_scale_m: float = 30.0
    """Scale of the error of a position without a noted accuracy."""
    least_position_scale_m: float = 15.0
    """Least scale of a position's error, since the terrain model is off too."""
    least_altitude_scale_m: float = 15.0
    """Least scale of an altitude's error, as the datum may differ from the terrain model's."""
    altitude_accuracies: float = 3.0
    """Scale of an altitude's error, as a multiple of the noted accuracy: heights are two to three
    times as uncertain as places."""
    altitude_scale_m: float = math.hypot(30.0 / math.sqrt(2.0), 15.0)
    """Scale of an altitude without an accuracy. The geoid's height above the ellipsoid has a root
    mean square of 30 m over the Earth (EGM96). Half of the devices are taken to note heights above
    the ellipsoid as heights above the sea: Android's `Location.getAltitude` gives these, and so do
    some drones (OpenAthena's issues 24 and 65)."""
    barometer_scale_m: float = 90.0
    """Scale of a drone's altitude, which its barometer gives for the standard atmosphere. The
    pressure at sea level varies by 10 hPa, of 8.4 m each, and the temperature by 10 K, 3.5 % of the
    height. One hill's altitude varied by 150 m in two weeks (DroneDeploy's forum 7617), another's
    by 200 m in some months (mavicpilots.com, thread 147682)."""
    takeoff_scale_m: float = 5.0
    """Scale of the drift of a drone's height above its take-off."""
    takeoff_share: float = 0.035
    """Scale of that height's error due to temperature, as a share of the height."""
    altitude_tail: float = 1.5
    """Exponent of the density of an altitude's error e of scale s, (1 + (e / s)^2)^-1.5 / (2 s)."""
    compass_sd_deg: float = 20.0
    """Standard deviation of a compass from true north. The declination is not modelled, and reaches
    20 degrees where people live."""
    magnetic_sd_deg: float = 30.0
    """Standard deviation of a compass from magnetic north, or from a north that it does not name,
    which may be the magnetic one."""


NOTED_ERRORS = NotedErrors()


def noted_position_scale_m(noted: NotedPlace) -> float:
    """Return the scale of the error of a photo's position."""
    return max(NOTED_ERRORS.least_position_scale_m, noted.accuracy_m or NOTED_ERRORS.gps_scale_m)


def noted_heading_sd_deg(noted: NotedPlace) -> float:
    """Return the standard deviation of a photo's undisturbed compass."""
    return (
        NOTED_ERRORS.compass_sd_deg if noted.is_magnetic is False else NOTED_ERRORS.magnetic_sd_deg
    )


def noted_altitude_scale_m(noted: NotedPlace) -> float:
    """Return the scale of the error of a photo's altitude."""
    if noted.takeoff_height_m is not None:
        return NOTED_ERRORS.barometer_scale_m
    if noted.accuracy_m is None:
        return NOTED_ERRORS.altitude_scale_m
    # A device that notes its accuracy has satellites in view, and corrects for the geoid.
    return max(
        NOTED_ERRORS.least_altitude_scale_m, NOTED_ERRORS.altitude_accuracies * noted.accuracy_m
    )

"""Where to stand to see the sun or moon over a summit.

The places of one day lie on a line: the path that the tip of the summit's shadow takes over the
ground, at the height of an eye.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import date, datetime

import numpy as np

from skyline.angles import angle_between_deg
from skyline.arrays import BoolArray, Float64Array
from skyline.errors import InputError
from skyline.geodesy.bounds import Circle
from skyline.geodesy.earth import Curvature
from skyline.sky.sun import Body, Sky, minutes_of
from skyline.terrain.heightfield import HeightField, heights_along
from skyline.terrain.summits import SUMMIT_RADIUS_M, summit_near

DEFAULT_WITHIN_KM = 5.0
_ROUNDS = 3
"""The sky turns by 0.01 degrees in 1.1 km: after two corrections the place moves by centimetres."""
_STEPS_A_SAMPLE = 2
"""Points of a ray, for each spacing of the samples, at which it is compared with the ground."""
_HALVINGS = 10
"""A step of 15 m becomes 1.5 cm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Standpoint:
    """A place from which a body stands right over a summit.

    Attributes
    ----------
    time : datetime
        UTC.
    lon, lat : float
        Degrees (WGS 84).
    distance_m : float
        Horizontal distance of the summit.
    azimuth_deg, elevation_deg : float
        Direction of the summit and of the middle of the body's disc; from true north, refracted.
    """

    time: datetime
    lon: float
    lat: float
    distance_m: float
    azimuth_deg: float
    elevation_deg: float


def standpoints(
    terrain: HeightField,
    summit_deg: tuple[float, float],
    day: date,
    body: Body,
    within: Circle,
    *,
    eye_height_m: float,
    curvature: Curvature,
) -> list[Standpoint]:
    """Return where in a circle a body stands over a summit, by minute.

    The summit is the highest sample near a longitude and latitude. Ground nearer than 150 m to it
    hides nothing, as for `skyline.view.sightings`. The day is the 24 hours around noon of the mean
    sun.

    Raises `InputError` where the summit is off the map, or PyEphem is not installed.
    """
    east_m, north_m = terrain.frame.from_lonlat(*summit_deg)
    found = summit_near(terrain, float(east_m), float(north_m))
    if found is None:
        raise InputError(
            f"the summit {summit_deg[0]:g},{summit_deg[1]:g} is off the elevation model; give a "
            "DEM that reaches to it"
        )
    summit_m = np.array(found)
    *middle, radius_m = terrain.frame.circle_m(within)
    middle_m = np.array(middle)
    to_middle_m = middle_m - summit_m[:2]
    far_m = float(np.hypot(*to_middle_m)) + radius_m
    times = np.array(minutes_of(day, summit_deg[0]))
    places_m = np.broadcast_to(summit_m, (len(times), 3))
    for _ in range(_ROUNDS):
        seen_deg = _seen_from(terrain, places_m, body, times)
        back_rad = np.radians(seen_deg[:, 2] + 180.0)
        may_reach = _reaches(back_rad, to_middle_m, radius_m) & (seen_deg[:, 1] > 0.0)
        times, seen_deg, back_rad = times[may_reach], seen_deg[may_reach], back_rad[may_reach]
        away_m = _shadow_m(
            terrain, summit_m, back_rad, np.tan(np.radians(seen_deg[:, 1])), far_m,
            eye_height_m, curvature,
        )  # fmt: skip
        is_met = np.isfinite(away_m)
        times, seen_deg, back_rad, away_m = (
            one[is_met] for one in (times, seen_deg, back_rad, away_m)
        )
        toward = np.column_stack([np.sin(back_rad), np.cos(back_rad)])
        tip_m = summit_m[:2] + away_m[:, np.newaxis] * toward
        ground_m = terrain.height_at(easting_m=tip_m[:, 0], northing_m=tip_m[:, 1])
        places_m = np.column_stack([tip_m, ground_m + eye_height_m])
    lon, lat = terrain.frame.to_lonlat(places_m[:, 0], places_m[:, 1])
    names = ("lon", "lat", "distance_m", "azimuth_deg", "elevation_deg")
    rows = np.column_stack([lon, lat, away_m, seen_deg[:, :2]])
    is_near = np.hypot(*(places_m[:, :2] - middle_m).T) <= radius_m
    return [
        Standpoint(time=at, **dict(zip(names, row, strict=True)))
        for at, row in zip(times[is_near], rows[is_near].tolist(), strict=True)
    ]


def _seen_from(
    terrain: HeightField, places_m: Float64Array, body: Body, times: Iterable[datetime]
) -> Float64Array:
    """Return a body's azimuths, elevations and grid azimuths, (N, 3).

    Each of the N places has its own time.
    """
    east_m, north_m, up_m = places_m.T
    lon, lat = terrain.frame.to_lonlat(east_m, north_m)
    convergence_deg = terrain.frame.convergence_deg(easting_m=east_m, northing_m=north_m)
    eyes = zip(lon, lat, up_m, times, strict=True)
    seen = [Sky(*place).look(body, at) for *place, at in eyes]
    deg = np.array([(one.azimuth_deg, one.elevation_deg) for one in seen]).reshape(-1, 2)
    return np.column_stack([deg, deg[:, 0] - convergence_deg])


def _reaches(back_rad: Float64Array, to_middle_m: Float64Array, radius_m: float) -> BoolArray:
    """Return whether rays (N,) from a summit pass through a circle."""
    away_m = float(np.hypot(*to_middle_m))
    if away_m <= radius_m:
        return np.ones(len(back_rad), dtype=bool)
    toward_deg = np.degrees(np.arctan2(*to_middle_m))
    half_deg = np.degrees(np.arcsin(radius_m / away_m))
    # A degree more, since the first round looks from the summit.
    return np.asarray(angle_between_deg(np.degrees(back_rad), toward_deg) <= half_deg + 1.0)


def _shadow_m(
    terrain: HeightField,
    summit_m: Float64Array,
    back_rad: Float64Array,
    elevation_tan: Float64Array,
    far_m: float,
    eye_height_m: float,
    curvature: Curvature,
) -> Float64Array:
    """Return the distances (N,) of a summit's shadow tips; NaN without one.

    An eye at distance r behind the summit sees it under the body's tangent t if its ground is at
    summit - eye height - t r - drop(r).
    """
    slope = elevation_tan[:, np.newaxis]

    def over_m(away_m: Float64Array) -> Float64Array:
        """Return the heights of eyes (N, D) above the summit's line."""
        ground_m = heights_along(terrain, summit_m[0], summit_m[1], back_rad, away_m)
        line_m = summit_m[2] - slope * away_m - curvature.drop_m(away_m)
        return np.asarray(ground_m + eye_height_m - line_m)

    step_m = terrain.spacing_m / _STEPS_A_SAMPLE
    away_m = np.arange(SUMMIT_RADIUS_M, max(far_m, SUMMIT_RADIUS_M) + 2.0 * step_m, step_m)
    eyes_m = over_m(away_m)
    rises = (eyes_m[:, :-1] < 0.0) & (eyes_m[:, 1:] >= 0.0)
    is_blocked = np.logical_or.accumulate(eyes_m > eye_height_m, axis=1)[:, :-1]
    seen = rises & ~is_blocked
    low_m = away_m[np.argmax(seen, axis=1)][:, np.newaxis]
    high_m = low_m + step_m
    for _ in range(_HALVINGS):
        middle_m = 0.5 * (low_m + high_m)
        is_under = over_m(middle_m) < 0.0
        low_m = np.where(is_under, middle_m, low_m)
        high_m = np.where(is_under, high_m, middle_m)
    return np.where(seen.any(axis=1), high_m[:, 0], np.nan)

"""Narrowings: what a user knows of a photo's pose before the search."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skyline.errors import InputError, numbers_of, swapped_in_words
from skyline.geodesy.bounds import Circle, are_degrees, check_bounds

NOTED_KM = 10.0
"""Radius of a search around a position that a photo notes, or around a named place."""
_NUMBERS = {
    "near": ("longitude", "latitude", "km"), "bounds_deg": ("west", "south", "east", "north"),
    "heading_deg": ("heading", "greatest error"), "elevation_m": ("lowest", "highest"),
}  # fmt: skip
"""Names of the numbers in each field of a narrowing, for its errors."""


@dataclass(frozen=True, slots=True)
class Narrowing:
    """Knowledge of a photo's pose that narrows its search; None where unknown.

    Attributes
    ----------
    near : (float, float, float), optional
        Longitude and latitude, degrees (WGS 84), and a radius, km.
    bounds_deg : (float, float, float, float), optional
        West, south, east, north, degrees.
    heading_deg : (float, float), optional
        Heading of the optical axis from true north, and its greatest error, degrees.
    elevation_m : (float, float), optional
        The lowest and the highest elevation of the camera, metres above the DEM's datum.
    eye_height_m : float, optional
        Height of the camera above the ground; by default it is found with the pose.
    photo_spots : sequence of (float, float)
        Longitudes and latitudes of places that people photograph from: summits, viewpoints, points
        along trails. They pull the search, and never bound it.
    use_gps : bool
        Whether the place and the direction in the photo's own EXIF pull the search. They never
        bound it: a distant place wins where its skyline fits well enough.

    Raises
    ------
    InputError
        A value is out of its range, or does not have the numbers of its field.
    """

    near: Circle | None = None
    bounds_deg: tuple[float, float, float, float] | None = None
    heading_deg: tuple[float, float] | None = None
    elevation_m: tuple[float, float] | None = None
    eye_height_m: float | None = None
    photo_spots: tuple[tuple[float, float], ...] = ()
    use_gps: bool = False

    def __post_init__(self) -> None:
        for name, expected in _NUMBERS.items():
            if (given := getattr(self, name)) is not None:
                error = f"{name} is {given!r:.60}; expected the numbers {', '.join(expected)}"
                object.__setattr__(self, name, numbers_of(given, len(expected), error))
        if self.bounds_deg is not None:
            check_bounds(self.bounds_deg)
        if self.near is not None:
            _check_near(*self.near)
        if self.heading_deg is not None:
            _check_heading(*self.heading_deg)
        if self.elevation_m is not None:
            _check_elevations(*self.elevation_m)
        if self.eye_height_m is not None:
            error = f"the eye is {self.eye_height_m!s:.40} m above the ground; expected 0 to 100000"
            (height_m,) = numbers_of([self.eye_height_m], 1, error)
            if not 0.0 <= height_m <= 1e5:
                raise InputError(error)
            object.__setattr__(self, "eye_height_m", height_m)
        object.__setattr__(self, "photo_spots", _spots(self.photo_spots))


def _check_near(lon: float, lat: float, radius_km: float) -> None:
    if abs(lon) <= 180.0 and abs(lat) <= 90.0 and 0.0 < radius_km < np.inf:
        return
    is_swapped = abs(lon) <= 90.0 < abs(lat) <= 180.0
    raise InputError(
        f"near is {lon:g},{lat:g},{radius_km:g}; expected longitude and latitude in degrees and a "
        "radius above 0 km" + (f"; {swapped_in_words(lon, lat)}" if is_swapped else "")
    )


def _spots(given: Iterable[Sequence[float]]) -> tuple[tuple[float, float], ...]:
    """Return the longitude and latitude of each spot; raises `InputError` for anything else."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise InputError(
            f"photo_spots is {given!r:.60}; expected the longitude and latitude of each spot"
        )
    spots = []
    for one in given:
        error = f"a photo spot is {one!r:.60}; expected longitude and latitude in degrees"
        lon, lat = numbers_of(one, 2, error)
        if not are_degrees(lon, lat):
            raise InputError(error)
        spots.append((lon, lat))
    return tuple(spots)


def _check_heading(heading_deg: float, slack_deg: float) -> None:
    if not (abs(heading_deg) <= 360.0 and 0.0 < slack_deg <= 180.0):
        raise InputError(
            f"heading is {heading_deg:g} within {slack_deg:g} degrees; expected a slack above 0, "
            "at most 180, and a heading from -360 to 360"
        )


def _check_elevations(low_m: float, high_m: float) -> None:
    if not (np.isfinite([low_m, high_m]).all() and low_m < high_m):
        raise InputError(f"elevations are {low_m:g} to {high_m:g} m; expected two that increase")

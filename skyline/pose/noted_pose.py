"""Poses as records have them: JSON that commands print and people write."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skyline.camera.projection import Projection
from skyline.camera.warps import MOST_DISTORTION, WANDER_DEGREES
from skyline.errors import InputError
from skyline.geodesy.bounds import are_degrees
from skyline.pose.pose_errors import WARP

_NEEDED = ("lon", "lat", "heading_deg", "fov_deg")
"""Keys that `NotedPose.from_dict` needs."""
_HEIGHTS = ("eye_elevation_m", "eye_height_m")
"""The names of an eye's height, of which a record has at most one."""
_OPTIONAL = ("pitch_deg", "roll_deg", "distortion", *_HEIGHTS)
_ANGLE_ENDS = ("", "_deg", "_rad")
_LENGTH_ENDS = ("", "_m", "_ft", "_feet")
_MISNAMED = {
    f"{name}{end}": meant
    for names, ends, meant in (
        (("pitch", "tilt"), _ANGLE_ENDS, "pitch_deg"),
        (("roll",), _ANGLE_ENDS, "roll_deg"),
        (("eye_elevation", "elevation", "altitude", "alt", "ele"), _LENGTH_ENDS, "eye_elevation_m"),
        (("eye_height", "height", "agl"), _LENGTH_ENDS, "eye_height_m"),
    )
    for name in names
    for end in ends
    if f"{name}{end}" != meant
}
"""Names that people write, and the names that are read. A value only under the former is an error:
if it were ignored, the camera would be level, or held by a person who stands on the ground."""
_UNKNOWNS = (WARP, WARP + 1, WARP + len(WANDER_DEGREES))
"""Numbers of rows that `Pose.covariance` may have: without a distortion, with it, and
with a panorama's wander."""
_MOST = {"heading_deg": 360.0, "pitch_deg": 90.0, "roll_deg": 180.0, "distortion": MOST_DISTORTION}
"""Greatest absolute values that a camera has."""
EXPECTED_RECORD = (
    "expected JSON as `skyline match --json` or `skyline orient --json` prints it, or a record "
    f"with {', '.join(_NEEDED)}"
)
"""The form of a record that errors ask for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NotedPose:
    """A pose as written down, not yet placed on a terrain.

    Attributes
    ----------
    lon, lat, heading_deg, fov_deg, pitch_deg, roll_deg, distortion : float
        As in `Pose`.
    wander : tuple of float
        As in `Pose`.
    eye_elevation_m : float or None
        Elevation of the camera above the DEM's datum.
    eye_height_m : float or None
        Height of the camera above the ground, in place of its elevation. By default a person
        holds the camera.
    covariance : tuple of tuple of float, or None
        As in `Pose`.
    doubt : str
        Why the pose is not to be trusted; empty where its file does not doubt it.
    """

    lon: float
    lat: float
    heading_deg: float
    fov_deg: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    distortion: float = 0.0
    wander: tuple[float, ...] = ()
    eye_elevation_m: float | None = None
    eye_height_m: float | None = None
    covariance: tuple[tuple[float, ...], ...] | None = None
    doubt: str = ""

    @classmethod
    def from_dict(cls, record: Any, projection: Projection, source: str = "pose") -> "NotedPose":
        """Read a record as `Pose.to_dict` returns it, or with less.

        Parameters
        ----------
        record : mapping
            It needs ``lon``, ``lat``, ``heading_deg`` and ``fov_deg``. Null stands for an unknown
            value; names that a `NotedPose` does not have are ignored, but not a ``pitch`` without
            its unit and the like.
        projection : Projection
            The projection of the photo. A record need not have it.
        source : str
            Where the record comes from, for errors.

        Raises
        ------
        InputError
            The record is not a pose, has another projection, or has values that no camera of the
            projection has.
        """
        if not isinstance(record, Mapping):
            raise InputError(f"{source} has no pose; {EXPECTED_RECORD}")
        if lacking := [name for name in _NEEDED if record.get(name) is None]:
            raise InputError(f"{source} has no {', '.join(lacking)}; {EXPECTED_RECORD}")
        given: dict[str, Any] = {
            name: _number(record[name], name, source)
            for name in (*_NEEDED, *_OPTIONAL)
            if record.get(name) is not None
        }
        _check_names(record, given, source)
        wander = _wander_in(record, source)
        for name, most in _MOST.items():
            if abs(given.get(name, 0.0)) > most:
                raise InputError(
                    f"{source}: {name} is {given[name]:g}; expected {-most:g} to {most:g}"
                )
        lon = given["lon"]
        lat = given["lat"]
        if not are_degrees(lon, lat):
            raise InputError(f"{source}: the place is {lon:g},{lat:g}; expected degrees (WGS 84)")
        if set(_HEIGHTS) <= given.keys():
            raise InputError(f"{source} has both eye_elevation_m and eye_height_m; give one")
        own = noted_projection(record, source)
        if own not in {None, projection}:
            raise InputError(
                f"{source} is of a photo whose projection is {own}, and the photo counts as "
                f"{projection}; leave --projection out, or give a pose of that projection"
            )
        projection.check_fov_deg(given["fov_deg"])
        if any(wander) and not projection.is_panorama:
            raise InputError(
                f"{source} is of a panorama, and the photo counts as {projection}; give the "
                "photo's --projection"
            )
        return cls(**given, wander=wander, covariance=_covariance_in(record, source))


def _check_names(record: Mapping[str, Any], given: Mapping[str, float], source: str) -> None:
    """Raise `InputError` for a value under another name alone."""
    known = set(given)
    if known & set(_HEIGHTS):
        known |= set(_HEIGHTS)
    for name, meant in _MISNAMED.items():
        if meant not in known and record.get(name) is not None:
            raise InputError(f"{source} has {name}, which is not read; give it as {meant}")


def _covariance_in(record: Mapping[str, Any], source: str) -> tuple[tuple[float, ...], ...] | None:
    """Return a record's covariance; None where it is missing or empty.

    Raises `InputError` unless it is square and has a row for each unknown of a pose.
    """
    rows = record.get("covariance")
    if not rows:
        return None
    is_square = isinstance(rows, list | tuple) and all(
        isinstance(row, list | tuple) and len(row) == len(rows) for row in rows
    )
    if not is_square or len(rows) not in _UNKNOWNS:
        raise InputError(
            f"{source}: covariance is {str(rows)[:40]}; expected a square matrix of "
            f"{', '.join(map(str, _UNKNOWNS))} rows, as lists, or none"
        )
    return tuple(tuple(_number(value, "covariance", source) for value in row) for row in rows)


def noted_projection(record: Mapping[str, Any], source: str) -> Projection | None:
    """Return a record's projection; None if it has none.

    Raises `InputError` for an unknown projection.
    """
    name = record.get("projection")
    try:
        return None if name is None else Projection(name)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None


def _wander_in(record: Mapping[str, Any], source: str) -> tuple[float, ...]:
    """Return a record's wander of a panorama's rows.

    Raises `InputError` unless the wander is missing or a list of the right length.
    """
    wander = record.get("wander") or []
    if not isinstance(wander, list | tuple) or len(wander) not in {0, len(WANDER_DEGREES)}:
        raise InputError(
            f"{source}: wander is {str(wander)[:40]}; expected a list of {len(WANDER_DEGREES)} "
            "numbers, or none"
        )
    return tuple(_number(value, "wander", source) for value in wander)


def _number(value: Any, name: str, source: str) -> float:
    """Return a record's value as a number, or raise `InputError`."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not abs(value) <= sys.float_info.max:
        raise InputError(f"{source}: {name} is {str(value)[:40]}; expected a number")
    return float(value)

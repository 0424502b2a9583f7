"""Poses in files, as commands print them and people write them."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from skyline.camera import MOST_DISTORTION, WANDER_DEGREES, Projection
from skyline.errors import InputError, printable
from skyline.files import read_bytes
from skyline.geodesy.degrees import are_degrees
from skyline.pose import Pose
from skyline.terrain.viewpoints import LEAST_EYE_HEIGHT_M, check_eye_elevation
from skyline.view import Viewer

_ROUNDED_M = 0.01
"""An eye that is too low by less than this is rounded."""
_NEEDED = ("lon", "lat", "heading_deg", "fov_deg")
_OTHERS = ("pitch_deg", "roll_deg", "distortion", "eye_elevation_m")
_EXPECTED = (
    "expected JSON as `skyline match --json` or `skyline orient --json` prints it, or a record "
    f"with {', '.join(_NEEDED)}"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class NotedPose:
    """A pose as a file has it; `Pose` has the meaning of its numbers."""

    lon: float
    lat: float
    heading_deg: float
    fov_deg: float
    pitch_deg: float = 0.0
    roll_deg: float = 0.0
    distortion: float = 0.0
    wander: tuple[float, ...] = ()
    eye_elevation_m: float | None = None
    """By default the eye stands on the ground."""
    verdict: str = ""
    """Why the pose is not to be trusted; empty where the file does not doubt it."""

    def held(self, viewer: Viewer) -> tuple[Pose, str]:
        """Return the pose on a viewer's terrain, and a sentence if its eye is lifted, or "".

        An eye lower than a camera is held is lifted. Raises `OffMapError` for a pose off the map,
        and `InputError` for an eye far below the ground.
        """
        standing = viewer.pose(
            lon=self.lon,
            lat=self.lat,
            heading_deg=self.heading_deg,
            pitch_deg=self.pitch_deg,
            roll_deg=self.roll_deg,
            fov_deg=self.fov_deg,
        )
        pose = replace(standing, distortion=self.distortion, wander=self.wander)
        if self.eye_elevation_m is None:
            return pose, ""
        check_eye_elevation(self.eye_elevation_m, standing.eye_elevation_m)
        pose = replace(pose, eye_elevation_m=self.eye_elevation_m)
        held = viewer.held(pose)
        height_m = LEAST_EYE_HEIGHT_M - (held.eye_elevation_m - pose.eye_elevation_m)
        if height_m >= LEAST_EYE_HEIGHT_M - _ROUNDED_M:
            return held, ""
        side = "below" if height_m < -_ROUNDED_M else "above"
        return held, (
            f"the pose's eye is {abs(height_m):.1f} m {side} the ground of the DEM, lower than a "
            f"camera is held; it is lifted to {LEAST_EYE_HEIGHT_M:g} m above it"
        )


def read_pose(path: Path, photo: Path, projection: Projection) -> NotedPose:
    """Read the pose of a photo from a file.

    A file of several photos has the pose in the line that names the photo. Of a match it is the
    answer, else the best candidate. Raises `MissingFileError` where there is no file, and
    `InputError` where it has no such pose, or values that no camera of the projection has.
    """
    record = _record_of(_records_in(path), path, photo)
    verdict = ""
    if isinstance(record, dict) and isinstance(record.get("candidates"), list):
        candidates = record["candidates"] or [None]
        if record.get("answer") is None and candidates[0] is not None:
            verdict = f"{path} has no answer, so the best candidate is taken"
        record = record.get("answer") or candidates[0]
    elif isinstance(record, dict) and record.get("refusal"):
        verdict = f"the pose in {path} is not trusted: {printable(str(record['refusal']))}"
    if not isinstance(record, dict) or any(record.get(name) is None for name in _NEEDED):
        raise InputError(f"pose {path} has no pose; {_EXPECTED}")
    pose = NotedPose(**_numbers_of(record, path), verdict=verdict)
    projection.check_fov_deg(pose.fov_deg)
    if any(pose.wander) and not projection.is_panorama:
        raise InputError(
            f"pose {path} is of a panorama, which {photo} does not note; give --projection"
        )
    return pose


def _records_in(path: Path) -> list[Any]:
    """Return what a file of JSON or of lines of JSON has."""
    try:
        text = read_bytes(path, _EXPECTED).decode("utf-8-sig")
        try:
            return [json.loads(text, parse_int=float)]
        except ValueError:
            lines = filter(str.strip, text.splitlines())
            return [json.loads(line, parse_int=float) for line in lines]
    except (ValueError, RecursionError) as error:
        raise InputError(f"pose {path} cannot be read ({error}); {_EXPECTED}") from None


def _record_of(records: list[Any], path: Path, photo: Path) -> Any:
    """Return the record of a photo; None if there is none in a file without records."""
    if len(records) <= 1:
        return records[0] if records else None
    named = {"photo": printable(photo)}
    of_photo = [one for one in records if isinstance(one, dict) and named.items() <= one.items()]
    if len(of_photo) != 1:
        raise InputError(
            f"pose {path} has {len(of_photo)} lines whose `photo` is {photo}; expected one: "
            "give a file of this photo alone"
        )
    return of_photo[0]


def _numbers_of(record: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the numbers of a pose in a file; raises `InputError` for values that no camera has."""
    given = {n: record[n] for n in (*_NEEDED, *_OTHERS) if record.get(n) is not None}
    wander = record.get("wander") or []
    if not isinstance(wander, list) or len(wander) not in {0, len(WANDER_DEGREES)}:
        raise InputError(
            f"pose {path}: wander is {str(wander)[:40]}; expected a list of {len(WANDER_DEGREES)} "
            "numbers, or none"
        )
    for name, value in (*given.items(), *(("wander", value) for value in wander)):
        if not isinstance(value, float) or not math.isfinite(value):
            raise InputError(f"pose {path}: {name} is {str(value)[:40]}; expected a number")
    if abs(given.get("distortion", 0.0)) > MOST_DISTORTION:
        raise InputError(
            f"pose {path}: distortion is {given['distortion']:g}; expected {-MOST_DISTORTION:g} to "
            f"{MOST_DISTORTION:g}"
        )
    lon = given["lon"]
    lat = given["lat"]
    if not are_degrees(lon, lat):
        raise InputError(f"pose {path}: the place is {lon:g},{lat:g}; expected degrees (WGS 84)")
    return given | {"wander": tuple(wander)}

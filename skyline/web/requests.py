"""Requests of the page, checked and converted; `Narrowing` checks its own numbers."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from skyline import (
    InputError,
    MatchResult,
    Narrowing,
    PhotoSkyline,
    Pose,
    Stroke,
    StrokeKind,
    Viewer,
)
from skyline.web.answers import POSE
from skyline.web.engine import Engine
from skyline.web.photos import PagePhoto

_RANGES = {
    "lon": (-180.0, 180.0), "lat": (-90.0, 90.0), "eyeHeight": (-500.0, 5000.0),
    "heading": (-360.0, 720.0), "pitch": (-80.0, 80.0), "roll": (-80.0, 80.0),
    "fov": (1.0, 360.0), "distortion": (-1.0, 1.0), "wander": (-1.0, 1.0),
    "column": (-1e6, 1e6), "row": (-1e6, 1e6), "radius": (0.0, 1e5),
}  # fmt: skip


def number(asked: Mapping[str, Any], name: str) -> float:
    """Return a number of a request.

    Raises `InputError` if it is no number, or out of range.
    """
    value: Any = asked.get(name)
    low, high = _RANGES[name]
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and low <= value <= high:
        return float(value)
    raise InputError(f"{name} is {str(value)[:40]}; expected a number from {low:g} to {high:g}")


def strokes_of(asked: Any) -> list[Stroke]:
    """Return the strokes of a request."""
    if not isinstance(asked, list):
        raise InputError("the strokes are no list; reload the page")
    strokes = []
    for one in asked:
        if not isinstance(one, Mapping) or one.get("kind") not in list(StrokeKind):
            raise InputError(f"a stroke is none of {', '.join(StrokeKind)}")
        points = one.get("points")
        if not isinstance(points, list) or any(
            not isinstance(point, list) or len(point) != 2 for point in points
        ):
            raise InputError("the points of a stroke are no list of pairs of a column and a row")
        pairs = [dict(zip(("column", "row"), point, strict=True)) for point in points]
        places = tuple((number(pair, "column"), number(pair, "row")) for pair in pairs)
        strokes.append(Stroke(StrokeKind(one["kind"]), places, number(one, "radius")))
    return strokes


def known_of(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what the user knows, as in a request for a search."""
    known = asked.get("known", {})
    if not isinstance(known, Mapping):
        raise InputError("what is known is no JSON object; reload the page")
    return known


def narrowing_of(asked: Mapping[str, Any]) -> Narrowing:
    """Return the narrowing of a request; null stands for unknown."""
    return Narrowing(
        near=asked.get("near"),
        heading_deg=asked.get("heading"),
        elevation_m=asked.get("elevation"),
        eye_height_m=asked.get("eyeHeight"),
    )


def skyline_of(asked: Mapping[str, Any], skyline: PhotoSkyline) -> PhotoSkyline:
    """Return a skyline with the field of view of a request.

    Null stands for unknown. Without a value the skyline keeps the field of view of its photo.
    """
    if "fov" not in asked:
        return skyline
    if asked["fov"] is None:
        return replace(skyline, fov_deg=None, lens=None)
    return skyline.with_fov(number(asked, "fov"))


def pose_of(asked: Any, viewer: Viewer) -> Pose:
    """Return the pose of a request, set by hand on the page."""
    if not isinstance(asked, Mapping):
        raise InputError("there is no pose; place the camera on the map")
    numbers = {field: number(asked, name) for name, field in POSE.items()}
    pose = viewer.pose(**numbers, eye_height_m=number(asked, "eyeHeight"))
    wander = asked.get("wander") or []
    if not isinstance(wander, list):
        raise InputError("the panorama's wander is no list; reload the page")
    return replace(
        pose,
        distortion=number({"distortion": 0.0, **asked}, "distortion"),
        wander=tuple(number({"wander": value}, "wander") for value in wander),
    )


def chosen_of(asked: Mapping[str, Any], photo: PagePhoto, engine: Engine) -> MatchResult:
    """Return the result that begins with the pose that a request chooses.

    It is ``pose``, set by hand; or the last fit, if ``fitted`` is true; or else the candidate with
    the index ``rank``, 0 by default.
    """
    if asked.get("pose") is not None:
        pose = pose_of(asked["pose"], engine.viewer)
        return MatchResult(photo.skyline, (pose,), 0.0, "chosen by a person", name=photo.name)
    if asked.get("fitted"):
        if photo.fitted is None:
            raise InputError("the skyline has changed since this fit; fit again")
        return replace(photo.fitted, name=photo.name)
    if photo.result is not None and photo.current_result is None:
        raise InputError("the skyline has changed since this search; find the place again")
    if photo.result is None or not photo.result.candidates:
        raise InputError("there is no place to save yet; find one, or place the camera by hand")
    count = len(photo.result.candidates)
    rank = asked.get("rank") or 0
    if not isinstance(rank, int) or not 0 <= rank < count:
        raise InputError(f"rank is {str(rank)[:40]}; expected 0 to {count - 1}")
    return replace(photo.result.chosen(rank + 1), name=photo.name)

"""What the page asks, held to what it may be: every number is one, within its range."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from skyline import Candidate, InputError, Narrowing, QuerySkyline, Stroke, StrokeKind, Viewer
from skyline.web.photos import is_guess

_MAX_STROKES = 2000
_MAX_POINTS = 20_000


def number(asked: Mapping[str, Any], name: str, low: float, high: float) -> float:
    """Return one of what is asked as a number; raises `InputError` where it is none in range."""
    value: Any = asked.get(name)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if is_number and math.isfinite(value) and low <= value <= high:
        return float(value)
    raise InputError(f"{name} is {str(value)[:40]}; expected a number from {low:g} to {high:g}")


def strokes_of(asked: Any) -> list[Stroke]:
    """Return strokes as the page sends them."""
    if not isinstance(asked, list) or len(asked) > _MAX_STROKES:
        raise InputError(f"the strokes are no list of at most {_MAX_STROKES}; undo some")
    return [_stroke(one) for one in asked]


def _stroke(asked: Any) -> Stroke:
    if not isinstance(asked, Mapping) or asked.get("kind") not in set(StrokeKind):
        raise InputError(f"a stroke is none of {', '.join(StrokeKind)}")
    points = asked.get("points")
    if not isinstance(points, list) or not 0 < len(points) <= _MAX_POINTS:
        raise InputError(f"a stroke has no list of 1 to {_MAX_POINTS} points")
    pairs = []
    for point in points:
        if not isinstance(point, list) or len(point) != 2:
            raise InputError("a point of a stroke is no pair of a column and a row")
        at = dict(zip(("column", "row"), point, strict=True))
        pairs.append((number(at, "column", -1e6, 1e6), number(at, "row", -1e6, 1e6)))
    return Stroke(StrokeKind(asked["kind"]), tuple(pairs), number(asked, "radius", 0.0, 1e5))


def narrowing_of(asked: Mapping[str, Any]) -> Narrowing:
    """Return what is known of where a photo was taken; what is null is not known."""
    near = heading = elevation = None
    if asked.get("near") is not None:
        circle = _part(asked, "near")
        near = (
            number(circle, "lon", -180.0, 180.0),
            number(circle, "lat", -90.0, 90.0),
            number(circle, "km", 0.01, 20_000.0),
        )
    if asked.get("heading") is not None:
        way = _part(asked, "heading")
        heading = (number(way, "deg", -360.0, 720.0), number(way, "slack", 0.1, 180.0))
    if asked.get("elevation") is not None:
        between = _part(asked, "elevation")
        elevation = (
            number(between, "low", -500.0, 9000.0),
            number(between, "high", -500.0, 9000.0),
        )
    height_m = None
    if asked.get("eyeHeight") is not None:
        height_m = number(asked, "eyeHeight", 0.0, 5000.0)
    return Narrowing(near=near, heading_deg=heading, elevation_m=elevation, eye_height_m=height_m)


def query_of(asked: Mapping[str, Any], query: QuerySkyline) -> QuerySkyline:
    """Return a skyline with the field of view that is asked for; null is not known."""
    if asked.get("fov") is None:
        return query if is_guess(query) else replace(query, fov_deg=None, lens=None)
    return query.with_fov(number(asked, "fov", 1.0, 360.0))


def pose_of(asked: Any, viewer: Viewer) -> Candidate:
    """Return the pose that a person has set by hand."""
    if not isinstance(asked, Mapping):
        raise InputError("there is no pose; place the camera on the map")
    pose = viewer.pose(
        number(asked, "lon", -180.0, 180.0),
        number(asked, "lat", -90.0, 90.0),
        number(asked, "heading", -360.0, 720.0),
        pitch_deg=number(asked, "pitch", -80.0, 80.0),
        roll_deg=number(asked, "roll", -80.0, 80.0),
        fov_deg=number(asked, "fov", 1.0, 360.0),
        eye_height_m=number(asked, "eyeHeight", 0.0, 5000.0),
    )
    distortion = number(asked, "distortion", -1.0, 1.0) if "distortion" in asked else 0.0
    return replace(pose, distortion=distortion)


def _part(asked: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    part = asked[name]
    if not isinstance(part, Mapping):
        raise InputError(f"{name} is {str(part)[:40]}; expected an object")
    return part

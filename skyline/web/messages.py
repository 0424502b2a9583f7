"""JSON messages between the page and the server.

This module checks and converts requests, and makes answers. `NotedPose` and `Narrowing` check their
own numbers.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from skyline import (
    Ellipse,
    Frame,
    InputError,
    MatchResult,
    Narrowing,
    NotedPose,
    PhotoSkyline,
    Pose,
    Stroke,
    StrokeKind,
    Viewer,
)
from skyline.web.area import PageArea

_RANGES = {
    "lon": (-180.0, 180.0), "lat": (-90.0, 90.0), "fov_deg": (1.0, 360.0),
    "column": (-1e6, 1e6), "row": (-1e6, 1e6), "radius": (0.0, 1e5),
}  # fmt: skip
_NARROWING = ("near", "heading_deg", "elevation_m", "eye_height_m")


def number(asked: Mapping[str, Any], name: str) -> float:
    """Return a number of a request.

    Raises `InputError` if it is not a number, or out of range.
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
        raise InputError("the strokes are not a list; reload the page")
    strokes = []
    for one in asked:
        if not isinstance(one, Mapping) or one.get("kind") not in list(StrokeKind):
            raise InputError(f"a stroke is none of {', '.join(StrokeKind)}")
        points = one.get("points")
        if not isinstance(points, list) or any(
            not isinstance(point, list) or len(point) != 2 for point in points
        ):
            raise InputError("the points of a stroke are not a list of pairs of a column and a row")
        pairs = [dict(zip(("column", "row"), point, strict=True)) for point in points]
        points_px = tuple((number(pair, "column"), number(pair, "row")) for pair in pairs)
        strokes.append(Stroke(StrokeKind(one["kind"]), points_px, number(one, "radius")))
    return strokes


def known_of(asked: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the user's knowledge of the pose from a request."""
    known = asked.get("known", {})
    if not isinstance(known, Mapping):
        raise InputError("what is known is not a JSON object; reload the page")
    return known


def narrowing_of(asked: Mapping[str, Any]) -> Narrowing:
    """Return the narrowing of a request; null stands for unknown."""
    known: dict[str, Any] = {name: asked.get(name) for name in _NARROWING}
    return Narrowing(**known)


def skyline_of(asked: Mapping[str, Any], skyline: PhotoSkyline) -> PhotoSkyline:
    """Return a skyline with the field of view of a request.

    Null stands for unknown. Without a value the skyline keeps the field of view of its photo.
    """
    if "fov_deg" not in asked:
        return skyline
    if asked["fov_deg"] is None:
        return replace(skyline, fov_deg=None, lens=None)
    return skyline.with_fov(number(asked, "fov_deg"))


def pose_of(asked: Any, photo: PhotoSkyline, viewer: Viewer) -> Pose:
    """Return the pose of a request, set by hand on the page."""
    return viewer.pose_of(NotedPose.from_dict(asked, photo.projection, "the request"))[0]


def outcome_json(result: MatchResult, area: PageArea) -> dict[str, Any]:
    """Return the candidates and the verdict of a search or fit."""
    lens = "" if result.skyline.lens is None else result.skyline.lens.in_words
    return {
        "candidates": [_candidate_json(one, area) for one in result.candidates],
        "answered": result.answer is not None,
        "within_m": result.within_m,
        "confidence": result.confidence,
        "refusal": result.refusal,
        "notes": [note for note in (result.exif_in_words(), lens, result.beyond) if note],
        "seconds": result.seconds,
    }


def _candidate_json(candidate: Pose, area: PageArea) -> dict[str, Any]:
    """Return a candidate's pose, and what the page shows with it."""
    return {
        "pose": candidate.to_dict(),
        "rank": candidate.rank,
        "eye_height_m": area.eye_height_m(candidate),
        "ellipse": _ellipse_json(candidate, area.matcher.frame),
        "residual": candidate.residual_in_words,
    }


def _ellipse_json(candidate: Pose, frame: Frame) -> list[list[float]] | None:
    """Return longitudes and latitudes along a candidate's ellipse, or None."""
    ellipse = Ellipse.of(candidate)
    if ellipse is None:
        return None
    outline = frame.to_lonlat(*ellipse.outline_m.T)
    points: list[list[float]] = np.stack(outline, axis=1).tolist()
    return points

"""The files of a photo and its place that the page saves."""

import secrets
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from skyline import (
    InputError,
    MatchResult,
    Pose,
    draw_labels,
    export_matches,
    report_matches,
    write_located,
    write_trace,
)
from skyline.web.area import PageArea
from skyline.web.messages import pose_of
from skyline.web.photos import PagePhoto, opened

KINDS = {
    "geojson": "geojson", "kml": "kml", "kmz": "kmz", "gpx": "gpx",
    "report": "html", "photo": "jpg", "names": "png",
}  # fmt: skip
"""Suffix of each kind of file that is saved with a place."""


def trace_of(photo: PagePhoto, path: Path) -> bytes:
    """Return a photo's skyline as a trace.

    It is written to ``path`` and read back.
    """
    try:
        write_trace(photo.skyline, path)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)


def chosen_of(asked: Mapping[str, Any], photo: PagePhoto) -> MatchResult:
    """Return the result that begins with a request's pose.

    The pose is ``pose``, set by hand; or the last fit, if ``fitted`` is true; or else the candidate
    with the index ``rank``, 0 by default.
    """
    if asked.get("pose") is not None:
        pose = pose_of(asked["pose"], photo.skyline, photo.area.viewer)
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


def saved(kind: str, photo: PagePhoto, result: MatchResult, folder: Path) -> bytes:
    """Return a file of one of `KINDS`.

    It is written in a folder and read back. The first candidate of the result is the pose to save.
    """
    path = folder / f"{secrets.token_hex(8)}.{KINDS[kind]}"
    beside = path.with_suffix("")
    area = photo.area
    matcher = area.matcher
    pose = result.candidates[0]
    try:
        if kind == "photo":
            write_located(photo.path, path, pose)
        elif kind == "names":
            path.write_bytes(_named(area, photo, pose))
        else:
            photos = [opened(photo)[0].rgb]
            if kind == "report":
                done = f"{pose.origin.capitalize()} on the page."
                report_matches(beside, matcher, [result], area.peaks, photos, done).rename(path)
            else:
                export_matches(path, [result], matcher.frame, photos)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)
        shutil.rmtree(beside, ignore_errors=True)


def _named(area: PageArea, photo: PagePhoto, pose: Pose) -> bytes:
    """Return the photo with the names of its summits, as PNG."""
    if area.peaks is None:
        raise InputError("no names are known; start skyline serve with --peaks FILE")
    read = opened(photo)[0]
    return draw_labels(read, read.rgb, area.viewer.summits(pose, read))[0]

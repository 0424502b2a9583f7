"""Files of a photo and its place, which the page saves."""

import secrets
import shutil
from pathlib import Path

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
from skyline.web.engine import Engine
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


def saved(kind: str, engine: Engine, photo: PagePhoto, result: MatchResult, folder: Path) -> bytes:
    """Return a file of one of `KINDS`.

    It is written in a folder and read back. The first candidate of the result is the pose to save.
    """
    path = folder / f"{secrets.token_hex(8)}.{KINDS[kind]}"
    beside = path.with_suffix("")
    matcher = engine.matcher
    pose = result.candidates[0]
    try:
        if kind == "photo":
            write_located(photo.path, path, pose)
        elif kind == "names":
            path.write_bytes(_named(engine, photo, pose))
        else:
            photos = [opened(photo)[0].rgb]
            if kind == "report":
                done = f"{pose.origin.capitalize()} on the page."
                report_matches(beside, matcher, [result], engine.peaks, photos, done).rename(path)
            else:
                export_matches(path, [result], matcher.frame, photos)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)
        shutil.rmtree(beside, ignore_errors=True)


def _named(engine: Engine, photo: PagePhoto, pose: Pose) -> bytes:
    """Return the photo with the names of its summits, as PNG."""
    if engine.peaks is None:
        raise InputError("no names are known; start skyline serve with --peaks FILE")
    picture = opened(photo)[0]
    seen = engine.viewer.summits(pose, picture.blank)
    return draw_labels(picture.blank, picture.rgb, seen)[0]

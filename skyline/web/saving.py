"""What was found leaves the page: as a file of each format."""

import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from skyline import (
    Candidate,
    InputError,
    MatchResult,
    export_matches,
    report_matches,
    write_located,
    write_trace,
)
from skyline.web.engine import Engine
from skyline.web.photos import Opened, PagePhoto

KINDS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "geojson": ("geojson", "application/geo+json"),
        "kml": ("kml", "application/vnd.google-earth.kml+xml"),
        "kmz": ("kmz", "application/vnd.google-earth.kmz"),
        "gpx": ("gpx", "application/gpx+xml"),
        "trace": ("csv", "text/csv"),
        "report": ("html", "application/octet-stream"),
        "photo": ("jpg", "image/jpeg"),
    }
)
"""What can be saved: the suffix and the media type of each."""


def saved(
    kind: str,
    engine: Engine,
    opened: Opened,
    photo: PagePhoto,
    candidates: Sequence[Candidate],
    folder: Path,
) -> bytes:
    """Return a file of one of `KINDS`, written in a folder and read back.

    Raises `InputError` where there is nothing to save yet.

    Parameters
    ----------
    candidates : sequence of Candidate
        The pose that is saved, then other candidates of its search.
    """
    if kind != "trace" and not candidates:
        raise InputError("there is no place to save yet; find one, or place the camera by hand")
    path = folder / f"{secrets.token_hex(8)}.{KINDS[kind][0]}"
    matcher, beside = engine.matcher, path.with_suffix("")
    try:
        if kind == "trace":
            write_trace(photo.known(), path)
        elif kind == "photo":
            write_located(photo.path, path, candidates[0])
        else:
            result, photos = _result(photo, candidates), [opened.open(photo)[0].rgb]
            if kind == "report":
                peaks = None if engine.viewer is None else engine.viewer.peaks
                done = f"{candidates[0].origin.capitalize()} on the page."
                report_matches(beside, matcher, [result], peaks, photos, done).rename(path)
            else:
                export_matches(path, [result], matcher.frame, photos)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)
        shutil.rmtree(beside, ignore_errors=True)


def _result(photo: PagePhoto, candidates: Sequence[Candidate]) -> MatchResult:
    """Return the result of which the first candidate is shown, then the others."""
    judged = (one for one in (photo.found, photo.fitted) if one and candidates[0] in one.candidates)
    found = next(judged, MatchResult(photo.known(), (), 0.0))
    # Only the answer itself is an answer; other candidates of its search are not.
    is_answer = candidates[0] == found.answer
    return MatchResult(
        photo.known(),
        tuple(candidates),
        found.seconds,
        None if is_answer else found.refusal or "chosen by a person",
        found.within_m if is_answer else None,
        photo.name,
    )

"""What was found leaves the page: as a file of each format."""

import secrets
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from skyline import (
    Candidate,
    InputError,
    Matched,
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
        Best first.
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
        elif kind == "report":
            peaks = None if engine.viewer is None else engine.viewer.peaks
            matches = [_matched(opened, photo, candidates)]
            report_matches(beside, matcher, matches, matcher.terrain, peaks).rename(path)
        else:
            export_matches(path, [_matched(opened, photo, candidates)], matcher.frame)
        return path.read_bytes()
    finally:
        path.unlink(missing_ok=True)
        shutil.rmtree(beside, ignore_errors=True)


def _matched(opened: Opened, photo: PagePhoto, candidates: Sequence[Candidate]) -> Matched:
    result = photo.result
    read, _ = opened.open(photo)
    by_hand = result is None or candidates[0] not in result.candidates
    return Matched(
        photo.name,
        photo.known(),
        candidates,
        0.0 if result is None else result.seconds,
        by_hand or (result is not None and result.answer is not None),
        read.rgb,
        ["The pose was set by hand on the page."] if by_hand else ["Found on the page."],
        None if by_hand or result is None else result.within_m,
    )

"""What was found leaves the page: as a file of each format."""

import secrets
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

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


class Saving:
    """One photo's files; its candidates are given best first."""

    def __init__(
        self,
        engine: Engine,
        opened: Opened,
        photo: PagePhoto,
        candidates: tuple[Candidate, ...],
    ) -> None:
        self._engine, self._opened, self._photo = engine, opened, photo
        self._candidates = candidates

    def write(self, kind: str, folder: Path) -> bytes:
        """Return a file of one of `KINDS`, written in a folder and read back.

        Raises `InputError` where there is nothing to save yet.
        """
        if kind != "trace" and not self._candidates:
            raise InputError("there is no place to save yet; find one, or place the camera by hand")
        path = folder / f"{secrets.token_hex(8)}.{KINDS[kind].suffix}"
        try:
            KINDS[kind].write(self, path)
            return path.read_bytes()
        finally:
            path.unlink(missing_ok=True)

    def exported(self, path: Path) -> None:
        """Write GeoJSON, KML, KMZ or GPX."""
        export_matches(path, [self._matched()], self._engine.matcher.frame)

    def trace(self, path: Path) -> None:
        """Write the skyline."""
        write_trace(self._photo.known(), path)

    def located(self, path: Path) -> None:
        """Write a copy of the photo that says where it was taken."""
        write_located(self._photo.path, path, self._candidates[0])

    def report(self, path: Path) -> None:
        """Write the report, one page."""
        matcher, viewer = self._engine.matcher, self._engine.viewer
        folder = path.with_suffix("")
        try:
            peaks = None if viewer is None else viewer.peaks
            page = report_matches(folder, matcher, [self._matched()], matcher.terrain, peaks)
            page.rename(path)
        finally:
            for file in folder.glob("*"):
                file.unlink()
            if folder.is_dir():
                folder.rmdir()

    def _matched(self) -> Matched:
        result = self._photo.result
        read, _ = self._opened.open(self._photo)
        by_hand = result is None or self._candidates[0] not in result.candidates
        return Matched(
            self._photo.name,
            self._photo.known(),
            self._candidates,
            0.0 if result is None else result.seconds,
            by_hand or (result is not None and result.answer is not None),
            read.rgb,
            ["The pose was set by hand on the page."] if by_hand else ["Found on the page."],
            None if by_hand or result is None else result.within_m,
        )


class Kind(NamedTuple):
    """A kind of file: its suffix, its media type, and what writes it."""

    suffix: str
    media_type: str
    write: Callable[[Saving, Path], None]


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "geojson": Kind("geojson", "application/geo+json", Saving.exported),
        "kml": Kind("kml", "application/vnd.google-earth.kml+xml", Saving.exported),
        "kmz": Kind("kmz", "application/vnd.google-earth.kmz", Saving.exported),
        "gpx": Kind("gpx", "application/gpx+xml", Saving.exported),
        "trace": Kind("csv", "text/csv", Saving.trace),
        "report": Kind("html", "application/octet-stream", Saving.report),
        "photo": Kind("jpg", "image/jpeg", Saving.located),
    }
)
"""What can be saved."""

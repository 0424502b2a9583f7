"""What was found leaves the page: as a file of each format."""

import secrets
from collections.abc import Callable, Mapping
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


class Saving:
    """One photo's files.

    Parameters
    ----------
    engine : Engine
    opened : Opened
    photo : PagePhoto
    candidates : tuple of Candidate
        Best first.
    """

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

        Raises
        ------
        InputError
            There is nothing to save yet.
        """
        if kind != "trace" and not self._candidates:
            raise InputError("there is no place to save yet; find one, or place the camera by hand")
        path = folder / f"{secrets.token_hex(8)}.{KINDS[kind][0]}"
        try:
            _WRITERS[kind](self, path)
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
"""What can be saved: the suffix and the type of each file."""

_WRITERS: Mapping[str, Callable[[Saving, Path], None]] = MappingProxyType(
    {
        "geojson": Saving.exported,
        "kml": Saving.exported,
        "kmz": Saving.exported,
        "gpx": Saving.exported,
        "trace": Saving.trace,
        "report": Saving.report,
        "photo": Saving.located,
    }
)

"""A page of photographs: the skyline found in each, and the one rendered where it was put."""

from pathlib import Path

from skyline import Viewer
from skyline.photo.read import read_picture
from skyline.report.html import Page, Part, Picture, Section, Table
from skyline.report.overlay import Overlay
from skyline_bench.measuring.record import shown
from skyline_bench.runs.photographs import Measured


class PhotographsPage:
    """Collects sections as photographs are measured."""

    def __init__(self) -> None:
        self._sections: list[Section] = []

    def add(self, measured: Measured, viewer: Viewer | None) -> None:
        """Draw one photograph."""
        figures = {name: shown(value) for name, value in measured.figures.items()}
        parts: list[Part] = [Table(("", ""), [[k, str(v)] for k, v in figures.items() if v != "-"])]
        if measured.query is not None:
            panorama = None
            if viewer is not None and measured.best is not None:
                panorama = viewer.panorama(measured.best)
            picture = read_picture(measured.photograph.photo)
            overlay = Overlay(measured.query, picture, measured.best, panorama)
            parts.insert(0, Picture(overlay.jpeg(), "Found, and rendered at the best candidate."))
        self._sections.append(Section(measured.photograph.name, parts))

    def write(self, path: Path, lead: str) -> None:
        """Write the page; raises `InputError` where it cannot be written."""
        Page("Photographs", lead, self._sections, "").write(path)

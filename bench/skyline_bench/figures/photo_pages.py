"""Pictures of photographs: a page of those that were measured, and the README's own."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from skyline import Matcher, Viewer, build_places, read_dem, stand_at
from skyline.photo.read import read_picture
from skyline.pipeline.reports import matched, report_matches
from skyline.render.depth import DepthRenderer
from skyline.report.html import Page, Part, Picture, Section, Table
from skyline.report.overlay import Overlay
from skyline_bench.measuring.geotiff import write_sample_dem
from skyline_bench.measuring.record import shown
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera
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


BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
LON_DEG, LAT_DEG = -84.2790, 36.6029
CAMERA = Camera(220.0, pitch_deg=7.0, roll_deg=1.0, fov_deg=60.0)
HEIGHT_PX = 560


def save_match(path: Path, width: int) -> dict[str, object]:
    """Save the picture of a photo rendered so wide; return what the match came to."""
    with tempfile.TemporaryDirectory() as name:
        terrain = read_dem([write_sample_dem(Path(name) / "sample.tif")])
        store = Path(name) / "places.h5"
        build_places(terrain, store, bounds_deg=BOUNDS_DEG)
        eye = stand_at(terrain, lon=LON_DEG, lat=LAT_DEG, summit_within_m=0.0)
        photo, report = Path(name) / "photo.jpg", Path(name) / "report"
        with DepthRenderer(terrain, width) as renderer:
            Image.fromarray(photograph(renderer, eye, 0, CAMERA, seed=1)).save(photo, quality=92)
        with Matcher(store, terrain) as matcher:
            result = matcher.match(photo, fov_deg=CAMERA.fov_deg)
            report_matches(report, matcher, [matched(photo, result)], terrain)
        pictures = [Image.open(path) for path in (report / "01-overlay.jpg", report / "01-map.png")]
        side_by_side(pictures).save(path, quality=85, optimize=True)
    best = result.candidates[0]
    apart_m = best.easting_m - eye.easting_m[0], best.northing_m - eye.northing_m[0]
    error_m = float(np.hypot(*apart_m))
    return {"error_m": error_m, "confidence": best.confidence, "query_s": result.seconds}


def side_by_side(pictures: Sequence[Image.Image]) -> Image.Image:
    """Return pictures in one row, all as high."""
    parts = [
        picture.convert("RGB").resize((picture.width * HEIGHT_PX // picture.height, HEIGHT_PX))
        for picture in pictures
    ]
    return Image.fromarray(np.concatenate([np.asarray(part) for part in parts], axis=1))

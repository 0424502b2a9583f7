"""The figures and pictures of the pages, and drawings of other records.

Tables, sentences and diagrams are written from records, so that every figure has been measured.
Constants are written from the code.
"""

import tempfile
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from PIL import Image
from typer import Argument, Option

from skyline import Matcher, build_places, read_dem, stand_at
from skyline.errors import MissingFileError
from skyline.files.disk import write_whole
from skyline.files.folders import check_folder
from skyline.render.depth import DepthRenderer
from skyline.report.match_page import report_matches
from skyline.survey.plans import map_bounds
from skyline_bench import options
from skyline_bench.documents.diagrams import (
    draw_folder,
    found_diagram,
    save_diagram,
    speed_diagram,
)
from skyline_bench.documents.results import Results
from skyline_bench.documents.sentences import SENTENCES
from skyline_bench.documents.tables import COMPARED
from skyline_bench.documents.writing import pages_in, written
from skyline_bench.geotiff import write_sample_dem
from skyline_bench.measuring import Row, square_km
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera

SAMPLE_BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
"""The part of matplotlib's sample terrain in which pictures and pages are matched."""
_PICTURE_CAMERA = Camera(220.0, pitch_deg=7.0, roll_deg=1.0, fov_deg=60.0)
_HEIGHT_PX = 560
_JPEG = ".jpg", ".jpeg"


def figures(
    folder: Annotated[
        Path | None,
        Argument(
            metavar="FOLDER",
            help="A folder of records, which are drawn. Without it, the pages of a checkout are "
            "written from its bench/results.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Where to draw; or the checkout.",
            show_default="the folder of the records, or here",
        ),
    ] = None,
) -> None:
    """The tables and diagrams of records, of a folder or the pages.

    In a folder, figures.md gets a table of each record, and records of speed-error and of searches
    get diagrams. In the pages, tables are written between the lines <!-- figures: NAME --> and
    <!-- end of figures -->, figures into the sentences that have them, and constants and equations
    of the code beside the comments that name them.
    """
    if folder is None:
        _write_pages(out or Path())
        return
    if not folder.is_dir():
        raise MissingFileError(
            f"{folder} is no folder; name a folder of records, which commands write with "
            "--json FOLDER/NAME.json"
        )
    if out is not None:
        check_folder(out)
        out.mkdir(parents=True, exist_ok=True)
    for path in draw_folder(folder, out or folder):
        typer.echo(f"{path}: written")


def _write_pages(checkout: Path) -> None:
    """Write the figures of README.md and docs/ of a checkout."""
    results = checkout / "bench" / "results"
    if not results.is_dir():
        raise MissingFileError(
            f"{results} is no folder; run this in a checkout of Skyline, or name a folder of "
            "records to draw"
        )
    records = Results(results)
    for page in pages_in(checkout):
        text = page.read_text(encoding="utf-8")
        new = written(text, page.relative_to(checkout).as_posix(), records, SENTENCES)
        if new != text:
            write_whole(page, new)
            typer.echo(f"{page}: written")
    docs = checkout / "docs"
    docs.mkdir(parents=True, exist_ok=True)
    save_diagram(speed_diagram(records.rows("speed_error")), docs / "speed-error.svg")
    panels: dict[str, list[tuple[str, str | None, list[Row]]]] = {}
    for terrain, planner, record in COMPARED:
        colour = "#0072B2" if planner == "ours" else "#D55E00"
        panels.setdefault(terrain, []).append((planner, colour, records.rows(record)))
    save_diagram(found_diagram(panels), docs / "uniform-adaptive.svg")


def readme_picture(
    out: Annotated[Path, options.new_file("The JPEG to write.", "--output", "-o", suffixes=_JPEG)],
    record: options.Record = None,
    quick: options.Quick = False,
) -> None:
    """The README's picture: a drawn photo and its place.

    The photo shows the sample terrain.
    """
    with tempfile.TemporaryDirectory() as name:
        terrain = read_dem([write_sample_dem(Path(name) / "sample.tif")])
        store = Path(name) / "places.h5"
        build_places(terrain, store, bounds_deg=SAMPLE_BOUNDS_DEG)
        eye = stand_at(terrain, lon=-84.2790, lat=36.6029, summit_within_m=0.0)
        photo = Path(name) / "photo.jpg"
        report = Path(name) / "report"
        with DepthRenderer(terrain, 512 if quick else 2048) as renderer:
            taken = Image.fromarray(photograph(renderer, eye, 0, _PICTURE_CAMERA, seed=1))
        taken.save(photo, quality=92)
        with Matcher(store, terrain) as matcher:
            result = matcher.match(photo, fov_deg=_PICTURE_CAMERA.fov_deg)
            report_matches(report, matcher, [result])
        # In one row, all as high.
        parts = []
        for part in (report / "01-overlay.jpg", report / "01-map.png"):
            with Image.open(part) as picture:
                size = picture.width * _HEIGHT_PX // picture.height, _HEIGHT_PX
                parts.append(np.asarray(picture.convert("RGB").resize(size)))
        Image.fromarray(np.concatenate(parts, axis=1)).save(out, quality=85, optimize=True)
    best = result.candidates[0]
    apart_m = best.easting_m - eye.easting_m[0], best.northing_m - eye.northing_m[0]
    error_m = float(np.hypot(*apart_m))
    area_m = map_bounds(terrain, SAMPLE_BOUNDS_DEG)
    row = {
        "photo": "drawn",
        "km2": square_km(area_m),
        "n": 1,
        "error_m": error_m,
        "confidence": best.confidence,
        "query_s": result.seconds,
    }
    options.report(record, [row], terrain=terrain, bounds_deg=SAMPLE_BOUNDS_DEG)

"""The figures and pictures of the pages.

Tables, sentences and diagrams are written from records, so that every figure has been measured.
Constants are written from the code.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from PIL import Image
from typer import Argument, Option

from skyline import Matcher, build_places, read_dem, stand_at
from skyline.files import write_whole
from skyline.render.depth import DepthRenderer
from skyline.report.match_page import report_matches
from skyline.survey.plans import map_bounds
from skyline_bench import options
from skyline_bench.documents.results import Results
from skyline_bench.documents.sentences import SENTENCES
from skyline_bench.documents.tables import COMPARED
from skyline_bench.documents.writing import pages_in, written
from skyline_bench.geotiff import write_sample_dem
from skyline_bench.measuring import Row, square_km
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.search.trials import by_planner

_WAYS = {
    "horizon": ("Skyline, four views", "crimson", "o"),
    "all round": ("Skyline, all the way round", "tab:green", "D"),
    "embree": ("Embree's rays", "tab:blue", "^"),
    "depth": ("depth images", "tab:gray", "s"),
    "grass": ("GRASS r.horizon", "tab:brown", "*"),
}
"""By path: label, colour and marker."""
SAMPLE_BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
"""The part of matplotlib's sample terrain in which pictures and pages are matched."""
_PICTURE_CAMERA = Camera(220.0, pitch_deg=7.0, roll_deg=1.0, fov_deg=60.0)
_HEIGHT_PX = 560


def figures(
    results: Annotated[Path, Argument(metavar="RESULTS", help="The folder of the records.")] = Path(
        "bench/results"
    ),
    out: Annotated[
        Path,
        Option("--output", "-o", metavar="FOLDER", help="A checkout, whose pages are written."),
    ] = Path(),
) -> None:
    """The tables, figures and diagrams of README.md and docs/, from the records.

    Tables are written between the lines <!-- figures: NAME --> and
    <!-- end of figures -->, figures into the sentences that have them, and
    constants and equations of the code beside the comments that name them.
    """
    records = Results(results)
    for page in pages_in(out):
        text = page.read_text(encoding="utf-8")
        new = written(text, page.relative_to(out).as_posix(), records, SENTENCES)
        if new != text:
            write_whole(page, new)
            typer.echo(f"{page}: written")
    (out / "docs").mkdir(parents=True, exist_ok=True)
    # Without dates and random names a picture changes only with its records.
    with matplotlib.rc_context({"svg.hashsalt": "skyline", "svg.fonttype": "none"}):
        _draw_speed(records.rows("speed_error")).savefig(
            out / "docs" / "speed-error.svg", metadata={"Date": None}
        )
        _draw_adaptive(records).savefig(
            out / "docs" / "uniform-adaptive.svg", metadata={"Date": None}
        )


def _draw_speed(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axis = figure.subplots()
    for path, (label, colour, marker) in _WAYS.items():
        mine = [row for row in rows if row["path"] == path and row.get("rms_px")]
        x = [row["ms_per_viewpoint"] for row in mine]
        y = [row["rms_px"] for row in mine]
        line = "-" if path in ("embree", "depth") else ""
        axis.plot(x, y, color=colour, marker=marker, label=label, linestyle=line)
    axis.set(xscale="log", yscale="log", xlabel="ms a viewpoint, all cores")
    axis.set_ylabel("rms error (px of 640 columns over 90°)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")
    return figure


_SHARES = "within_200m", "within_200m_low", "within_200m_high"


def _draw_adaptive(records: Results) -> Figure:
    terrains = list(dict.fromkeys(terrain for terrain, _, _ in COMPARED))
    figure = Figure(figsize=(9.0, 4.2), layout="constrained")
    axes = figure.subplots(1, len(terrains), sharey=True, squeeze=False)[0]
    for terrain, planner, record in COMPARED:
        axis = axes[terrains.index(terrain)]
        rows = records.rows(record)
        colour = "#0072B2" if planner == "ours" else "#D55E00"
        kinds = ("uniform", "o--"), ("adaptive", "D-")
        for some, (kind, style) in zip(by_planner(rows), kinds, strict=True):
            share, *ends = np.array([[row[key] for row in some] for key in _SHARES])
            x = [row["renderings"] for row in some]
            off = np.abs(np.array(ends) - share)
            label = f"{planner}, {kind}: {some[0]['queries']} queries, {some[0]['km2']:,.0f} km²"
            axis.errorbar(x, share, off, fmt=style, color=colour, label=label, capsize=2)
        axis.set(xscale="log", xlabel="renderings, or four a place", ylim=(0.0, 1.0))
        axis.set_title(terrain, fontsize=10)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=7, loc="lower right")
    axes[0].set_ylabel("queries found within 200 m")
    return figure


def readme_picture(
    out: Annotated[Path, options.new_file("The JPEG to write.", "--output", "-o")],
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

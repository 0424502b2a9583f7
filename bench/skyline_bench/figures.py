"""The README's two tables and three pictures.

Tables and diagrams are made from records, so that a figure shown has been measured: *speed against
error*, and *uniform against adaptive* stores, of the paper's planner and matcher and of ours.
"""

import json
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
from skyline.build.plans import map_bounds
from skyline.errors import MissingFileError
from skyline.render.depth import DepthRenderer
from skyline.report.match_report import report_matches
from skyline_bench import options
from skyline_bench.geotiff import write_sample_dem
from skyline_bench.measuring import Row, shown, square_km
from skyline_bench.queries.made_photos import photograph
from skyline_bench.queries.pinhole import Camera
from skyline_bench.search.trials import by_planner, interpolated

_WAYS = {
    "horizon": ("Skyline, four views", "crimson", "o"),
    "all round": ("Skyline, all the way round", "tab:green", "D"),
    "embree": ("Embree's rays", "tab:blue", "^"),
    "depth": ("depth images", "tab:gray", "s"),
    "grass": ("GRASS r.horizon", "tab:brown", "*"),
}
"""By path: label, colour and marker."""
_SHOWN = {
    ("horizon", "0 px"): "**Skyline**, four views of 640 columns",
    ("all round", "720 azimuths, 0 degrees"): "**Skyline**, all the way round, 720 azimuths",
    ("embree", "15 bisections"): "Embree's rays, four views",
    ("depth", "W = 640"): "depth images, as the paper draws them",
    ("grass", "r.horizon"): "GRASS `r.horizon`, 720 azimuths",
}
"""The rows of the table of speed: paths and settings, and their names there."""

_COMPARED = (
    ("Davos", "the paper's", "paper_figure7_davos.json"),
    ("Davos", "ours", "placing_davos.json"),
    ("Owens Valley", "the paper's", "paper_figure7_owens.json"),
    ("Owens Valley", "ours", "placing_owens.json"),
)
"""Terrain, planner and matcher, and the record in which both kinds of stores were searched."""

SAMPLE_BOUNDS_DEG = (-84.29, 36.55, -84.20, 36.62)
"""The part of matplotlib's sample terrain in which pictures and pages are matched."""
_PICTURE_CAMERA = Camera(220.0, pitch_deg=7.0, roll_deg=1.0, fov_deg=60.0)
_HEIGHT_PX = 560


def figures(
    results: Annotated[Path, Argument(metavar="RESULTS", help="The folder of the records.")] = Path(
        "bench/results"
    ),
    out: Annotated[
        Path, Option("--out", "-o", metavar="FOLDER", help="Where the SVG files are written.")
    ] = Path("docs"),
) -> None:
    """The README's tables, in Markdown, and its diagrams, from records."""
    speed = _rows(results / "speed_error.json")
    stores = [(terrain, by, _rows(results / file)) for terrain, by, file in _COMPARED]
    typer.echo(_markdown(speed_table(speed)))
    typer.echo(_markdown(adaptive_table(stores)))
    out.mkdir(parents=True, exist_ok=True)
    # Without dates and random names a picture changes only with its records.
    with matplotlib.rc_context({"svg.hashsalt": "skyline", "svg.fonttype": "none"}):
        _draw_speed(speed).savefig(out / "speed-error.svg", metadata={"Date": None})
        _draw_adaptive(stores).savefig(out / "uniform-adaptive.svg", metadata={"Date": None})


def _rows(record: Path) -> list[Row]:
    if not record.is_file():
        raise MissingFileError(f"{record} does not exist; make it first: skyline-bench --help")
    rows: list[Row] = json.loads(record.read_text(encoding="utf-8"))["rows"]
    return rows


def _markdown(rows: Sequence[Row]) -> str:
    lines = [" | ".join(rows[0]), " | ".join("---" for _ in rows[0])]
    lines += [" | ".join(str(value) for value in row.values()) for row in rows]
    return "\n".join(f"| {line} |" for line in lines) + "\n"


def speed_table(rows: Sequence[Row]) -> list[Row]:
    """Return a row for each way to a skyline; errors are in degrees, at the middle of a view."""
    found = {(row["path"], row["setting"]): row for row in rows}
    return [
        {
            "way": way,
            "ms a viewpoint": shown(found[key]["ms_per_viewpoint"]),
            "rms error": _degrees(found[key]["rms_px"]),
            "greatest error": _degrees(found[key]["max_px"]),
        }
        for key, way in _SHOWN.items()
        if key in found
    ]


def _degrees(error_px: float) -> str:
    """Return an error in px of W = 640 as an angle at the middle of a view."""
    return f"{shown(float(np.degrees(np.arctan(error_px / 320.0))))}°"


def _draw_speed(rows: Sequence[Row]) -> Figure:
    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    axis = figure.subplots()
    for path, (label, colour, marker) in _WAYS.items():
        mine = [row for row in rows if row["path"] == path and row.get("rms_px")]
        x, y = [row["ms_per_viewpoint"] for row in mine], [row["rms_px"] for row in mine]
        line = "-" if path in ("horizon", "embree", "depth") else ""
        axis.plot(x, y, color=colour, marker=marker, label=label, linestyle=line)
    axis.set(xscale="log", yscale="log", xlabel="ms a viewpoint, all cores")
    axis.set_ylabel("rms error (px of 640 columns over 90°)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")
    return figure


_Compared = Sequence[tuple[str, str, list[Row]]]
_SHARES = "within_200m", "within_200m_low", "within_200m_high"


def adaptive_table(stores: _Compared) -> list[Row]:
    """Return a row for each adaptive store, and a uniform grid of as many renderings.

    The grid's share is interpolated between the grids measured. The two tie where that share is
    within the adaptive store's interval of 95 %.
    """
    table = list[Row]()
    for terrain, planner, rows in stores:
        grids, plans = by_planner(rows)
        for row in plans:
            x, y = ([one[key] for one in grids] for key in ("renderings", "within_200m"))
            uniform = interpolated(x, y, row["renderings"])
            if uniform is None:
                continue
            low, high = row["within_200m_low"], row["within_200m_high"]
            better = "adaptive" if uniform < low else "uniform" if uniform > high else "tie"
            table.append(
                {
                    "terrain": terrain,
                    "planner and matcher": planner,
                    "renderings": f"{row['renderings']:,.0f}",
                    "adaptive: within 200 m": f"{row['within_200m']:.0%} ({low:.0%} to {high:.0%})",
                    "uniform: within 200 m": f"{uniform:.0%}",
                    "better": better,
                }
            )
    return table


def _draw_adaptive(stores: _Compared) -> Figure:
    terrains = list(dict.fromkeys(terrain for terrain, _, _ in stores))
    figure = Figure(figsize=(8.4, 3.8), layout="constrained")
    axes = figure.subplots(1, len(terrains), sharey=True, squeeze=False)[0]
    for terrain, planner, rows in stores:
        axis = axes[terrains.index(terrain)]
        colour = "#0072B2" if planner == "ours" else "#D55E00"
        kinds = ("uniform", "o--"), ("adaptive", "D-")
        for some, (kind, style) in zip(by_planner(rows), kinds, strict=True):
            share, *ends = np.array([[row[key] for row in some] for key in _SHARES])
            x, off = [row["renderings"] for row in some], np.abs(np.array(ends) - share)
            label = f"{planner}, {kind}"
            axis.errorbar(x, share, off, fmt=style, color=colour, label=label, capsize=2)
        axis.set(xscale="log", xlabel="renderings, or four a place", ylim=(0.0, 1.0))
        axis.set_title(terrain, fontsize=10)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("queries found within 200 m")
    axes[0].legend(fontsize=8)
    return figure


def readme_picture(
    out: Annotated[Path, options.new_file("The JPEG to write.", "--out", "-o")],
    record: options.Record = None,
    quick: options.Quick = False,
) -> None:
    """The README's picture: a photo drawn of the sample terrain, and the place found for it."""
    with tempfile.TemporaryDirectory() as name:
        terrain = read_dem([write_sample_dem(Path(name) / "sample.tif")])
        store = Path(name) / "places.h5"
        build_places(terrain, store, bounds_deg=SAMPLE_BOUNDS_DEG)
        eye = stand_at(terrain, lon=-84.2790, lat=36.6029, summit_within_m=0.0)
        photo, report = Path(name) / "photo.jpg", Path(name) / "report"
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

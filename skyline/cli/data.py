"""``skyline dem``, ``peaks``, ``info``, ``explain``, ``cache`` and ``store``: data on disk."""

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import ArrayLike
from typer import Argument, Option

from skyline.camera import pixel_size
from skyline.cli.console import (
    AsJson,
    Crs,
    Dems,
    NoCurvature,
    RefractionK,
    Reproject,
    StoreFile,
    Tolerance,
    Width,
    on_interrupt,
    parse_bounds,
    parse_numbers,
    print_line,
    print_note,
    print_written,
    progress_bar,
    read_terrain,
)
from skyline.errors import InputError, printable
from skyline.fetch.dem_tiles import SOURCES, fetch_dem
from skyline.fetch.overpass import fetch_peaks
from skyline.fetch.remote import RETRIES, TIMEOUT_S
from skyline.geodesy import Curvature, Frame
from skyline.match.areas import cache_folder, cached_areas, clear_cache
from skyline.render.context import describe_context
from skyline.render.horizon import RenderConfig, render_views
from skyline.store import (
    StoreReport,
    check_store,
    is_store,
    merge_stores,
    open_store,
    repair_store,
)
from skyline.store.format import PLACES, SCHEMA_VERSION
from skyline.terrain.conventions import model_of
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, place_on, stand_on

_DEFAULTS = RenderConfig()

Facts = dict[str, object]
Box = Annotated[str, Option(metavar="W,S,E,N", help="The box, in degrees (WGS 84).")]
Retries = Annotated[int, Option(min=0, max=100, help="How often to repeat a failed request.")]

NewStore = Annotated[Path, Option("--output", "-o", help="The new store; must not exist.")]

dem = typer.Typer(name="dem", help="Elevation data for an area.", no_args_is_help=True)
store = typer.Typer(
    name="store", help="Check, repair, merge and export stores.", no_args_is_help=True
)


@dem.callback()
def _group() -> None:
    """Do nothing: with this callback, `fetch` stays a subcommand although it is the only one."""


@dem.command()
def fetch(
    bbox: Box,
    folder: Annotated[
        Path, Option("--output", "-o", metavar="DIR", help="The folder for the tiles.")
    ],
    source: Annotated[
        str,
        Option(
            metavar="NAME|URL",
            help=f"{', '.join(SOURCES)}, or an address with {{lat:02d}}, {{lon:03d}}, {{ns}}, "
            "{ew}: the degrees of a tile's south-west corner without signs, and its hemispheres.",
        ),
    ] = "copernicus",
    retries: Retries = RETRIES,
    timeout: Annotated[
        int, Option(metavar="SECONDS", min=1, max=3600, help="How long to wait for an answer.")
    ] = TIMEOUT_S,
) -> None:
    """Fetch elevation tiles (cloud-optimized GeoTIFF), cut to a box, for `skyline build DIR/*.tif`.

    The box must contain the area to build and all terrain that is seen from it.
    After a stop or a failure, the same command continues.
    """
    bounds = parse_bounds(bbox)
    on_interrupt(
        "the tiles that were fetched are kept, and the same command continues with the others",
        lambda: any(folder.glob("*.tif")),
    )
    with progress_bar("fetching tiles") as progress:
        done = fetch_dem(bounds, source, folder, retries, timeout, progress)
    held = sum(path.stat().st_size for path in done.files)
    print_line(
        f"{folder}: {len(done.files)} tiles, {done.fetched} of them new, {held / 1e6:.1f} MB"
    )
    if done.missing:
        print_line(f"the source has no tile (usually sea) for: {', '.join(done.missing)}")


def peaks(
    bbox: Box,
    server: Annotated[
        str, Option(metavar="URL", help="An Overpass server: https://host/api/interpreter.")
    ],
    output: Annotated[Path, Option("--output", "-o", metavar="FILE", help="The GeoJSON to write.")],
    retries: Retries = RETRIES,
    timeout: Annotated[
        int,
        Option(metavar="SECONDS", min=1, max=3600, help="How long to wait for the whole answer."),
    ] = TIMEOUT_S,
) -> None:
    """Fetch the named peaks of a box from an Overpass server, for `--peaks`."""
    count = fetch_peaks(parse_bounds(bbox), server, output, retries, timeout)
    print_written(output, f"{count} peaks (OpenStreetMap contributors, ODbL)")


def cache(
    clear: Annotated[bool, Option("--clear", help="Remove all of it.")] = False,
    as_json: AsJson = False,
) -> None:
    """List what `locate` keeps: elevation tiles and stores of areas."""
    areas = [one.to_dict() for one in cached_areas()]
    total = _bytes_of(areas)
    if clear:
        count = clear_cache(print_note)
        left = _bytes_of([one.to_dict() for one in cached_areas()])
        print_line(f"{cache_folder()}: {count} areas removed, {(total - left) / 1e6:.1f} MB")
        return
    if as_json:
        about = {"folder": str(cache_folder()), "areas": areas}
        print_line(json.dumps(about | {"bytes": total}))
        return
    for one in areas:
        unfinished = "" if one["finished"] else ", unfinished"
        store = f"store {one['store_bytes'] / 1e6:.1f} MB{unfinished}"
        tiles = f"{one['tiles']} tiles {one['tile_bytes'] / 1e6:.1f} MB, " if one["tiles"] else ""
        box = ",".join(f"{side:g}" for side in one["bounds_deg"])
        changed = datetime.fromisoformat(one["changed"])
        print_line(f"{one['origin']} {box}: {tiles}{store}, {changed:%Y-%m-%d %H:%M}")
    print_line(f"{cache_folder()}: {len(areas)} areas, {total / 1e6:.1f} MB")


def _bytes_of(areas: list[dict[str, Any]]) -> int:
    """Return the size of all files of areas."""
    return sum(one["tile_bytes"] + one["store_bytes"] for one in areas)


def info(
    path: Annotated[
        list[str] | None, Argument(metavar="[DEM...|STORE]", help="The files of a DEM, or a store.")
    ] = None,
    gl: Annotated[bool, Option("--gl", help="Show which OpenGL is used, and why.")] = False,
    as_json: AsJson = False,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Describe a DEM, a store, or the OpenGL in use."""
    if not path and not gl:
        raise InputError("nothing to describe; name a DEM or a store, or give --gl")
    facts: Facts = {**describe_context()} if gl else {}
    if path:
        if len(path) == 1 and is_store(path[0]):
            facts |= describe_store(path[0])
        else:
            facts |= _describe_terrain(read_terrain(path, crs, reproject))
    _print_facts(facts, as_json)


def explain(
    dem: Dems,
    at: Annotated[
        str, Option(metavar="LON,LAT", help="Degrees (WGS 84), or easting and northing in metres.")
    ],
    width: Width = _DEFAULTS.width,
    tolerance_px: Tolerance = _DEFAULTS.tolerance_px,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    crs: Crs = None,
    reproject: Reproject = False,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on, which is left out, and the resulting error."""
    curvature = Curvature(refraction_k=k, enabled=not no_curvature)
    config = RenderConfig(width=width, tolerance_px=tolerance_px, curvature=curvature)
    wanted = "LON,LAT in degrees, or easting and northing in metres"
    first, second = parse_numbers(at, 2, f"--at is `{at}`; expected {wanted}")
    terrain = read_terrain(dem, crs, reproject)
    east_m: ArrayLike = first
    north_m: ArrayLike = second
    if max(abs(first), abs(second)) <= 360.0:
        east_m, north_m = place_on(terrain.frame, terrain.bounds_m, first, second)
    height_m = DEFAULT_EYE_HEIGHT_M
    eye = stand_on(terrain, easting_m=east_m, northing_m=north_m, eye_height_m=height_m)
    _print_facts(_describe_scene(terrain, eye, config), as_json)


def _print_facts(facts: Facts, as_json: bool) -> None:
    if as_json:
        print_line(json.dumps(facts))
        return
    rows = list(_rows(facts))
    width = max(len(name) for name, _ in rows)
    for name, text in rows:
        print_line(f"{name:<{width}}  {text}")


def _rows(facts: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the lines of a table of facts: name and text, numbers as options take them."""
    for name, value in facts.items():
        if isinstance(value, Mapping):
            yield from _rows(value, f"{prefix}{name}.")
            continue
        values = value if isinstance(value, list) else [value]
        shown = ["-" if one is None else _shown(one) for one in values]
        if not any(isinstance(one, str) for one in values):
            shown = [",".join(shown)]
        for line, text in enumerate(shown):
            yield "" if line else f"{prefix}{name}", text


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _describe_terrain(field: HeightField) -> Facts:
    west, south, east, north = field.bounds_m
    turn_deg = field.frame.convergence_deg(
        easting_m=(west + east) / 2.0, northing_m=(south + north) / 2.0
    )
    made = field.provenance
    return {
        "kind": "DEM",
        "files": list(made.files),
        "model": model_of(made.files),
        "frame": field.frame.name,
        **made.conventions,
        "resampling": made.resampling,
        "samples": f"{field.cols} x {field.rows}",
        "spacing_m": [field.spacing_east_m, field.spacing_north_m],
        "bounds_m": [west, south, east, north],
        "bounds_deg": list(field.frame.box_deg(easting_m=[west, east], northing_m=[south, north])),
        "height_range_m": list(field.height_range_m),
        "convergence_deg": float(turn_deg),
        **{name: getattr(made, name) for name in ("filled", "hollow", "despiked", "undeclared")},
        "digest": field.digest,
    }


def _describe_scene(terrain: HeightField, eye: Viewpoints, config: RenderConfig) -> Facts:
    """Return the terrain modelled for one viewpoint, the terrain left out, and the error."""
    # Only a skyline rendered without a tolerance shows the error that the tolerance makes.
    exact = render_views(terrain, eye, replace(config, tolerance_px=0.0))
    given = render_views(terrain, eye, config)
    drop_per_m2 = config.curvature.drop_per_m2
    place = {"easting_m": float(eye.easting_m[0]), "northing_m": float(eye.northing_m[0])}
    eye_m, reach_m = float(eye.eye_elevation_m[0]), terrain.reach_m(**place)
    sight_m = sight_range_m(terrain, eye_m, drop_per_m2)
    short = np.nanmax(exact.elevation_tan - given.elevation_tan, initial=0.0)
    depth_m = exact.depth_m
    return {
        **place,
        "eye_elevation_m": eye_m,
        "width": config.width,
        "tolerance_px": config.tolerance_px,
        "skyline_depth_m": [float(v) for v in np.nanquantile(depth_m, [0.0, 0.5, 1.0])]
        if np.isfinite(depth_m).any()
        else [],
        "flagged_columns": float((exact.flags != 0).mean()),
        "data_reach_m": reach_m,
        "sight_m": sight_m,
        "samples_beyond_sight": share_beyond(terrain, eye, sight_m),
        "curvature": "modelled" if config.curvature.enabled else "left out (--no-curvature)",
        "curvature_bound_px": curvature_bound_px(reach_m, drop_per_m2, config.width),
        "passed_over_bound_px": config.tolerance_px,
        "passed_over_measured_px": float(short / pixel_size(config.width)),
    }


def curvature_bound_px(reach_m: float, drop_per_m2: float, width: int) -> float:
    """Return the greatest error of a skyline without curvature, in px of ``width`` columns.

    ``reach_m`` is the distance of the farthest sample.
    """
    # v changes by drop d^2 / z, and d is at most the root of 2 times z.
    return float(np.sqrt(2.0)) * drop_per_m2 * reach_m / pixel_size(width)


def sight_range_m(field: HeightField, eye_elevation_m: float, drop_per_m2: float) -> float:
    """Return the distance beyond which nothing rises over the dip horizon; inf on a flat Earth.

    From e above the lowest ground the line of sight that grazes it touches at sqrt(e / drop) and
    meets the highest sample, H above, at sqrt(H / drop) farther on.
    """
    if drop_per_m2 == 0.0:
        return float(np.inf)
    lowest, highest = field.height_range_m
    above_m = max(eye_elevation_m - lowest, 0.0)
    return float((np.sqrt(above_m) + np.sqrt(highest - lowest)) / np.sqrt(drop_per_m2))


def share_beyond(field: HeightField, eye: Viewpoints, distance_m: float) -> float:
    """Return the share of the samples that lie farther from one eye."""
    row, col = field.to_grid(easting_m=eye.easting_m[0], northing_m=eye.northing_m[0])
    south = (np.arange(field.rows) - row) * field.spacing_north_m
    east = (np.arange(field.cols) - col) * field.spacing_east_m
    half_chord = np.sqrt(np.maximum(distance_m**2 - south**2, 0.0))
    within = np.searchsorted(east, half_chord, "right") - np.searchsorted(east, -half_chord)
    within[np.abs(south) > distance_m] = 0
    return float(1.0 - within.sum() / (field.rows * field.cols))


def describe_store(path: str) -> Facts:
    """Return the facts of a store; raises `StoreError` where it cannot be read."""
    with open_store(path) as store:
        header, eyes = store.header, store.eyes()
        frame = Frame(header.frame_wkt)
        facts: Facts = {"kind": "store", header.holds: len(store)}
        if header.width:
            facts["width"] = header.width
        facts |= {
            "frame": frame.name,
            "dem_files": [printable(file) for file in header.dem_files],
            "dem_digest": header.dem_digest,
            "config": dict(header.config),
            "renderer": header.renderer,
            "package_version": header.package_version,
            "schema_version": SCHEMA_VERSION,
        }
        if len(store):
            facts["locations"] = len(np.unique(eyes.easting_m + 1j * eyes.northing_m))
            if header.holds == PLACES:
                blocks = store.places().blocks()
                spacing_m = 2.0 * np.concatenate([block.tolerance_m for block in blocks])
                facts["spacing_m"] = np.quantile(spacing_m, [0.0, 0.5, 1.0]).tolist()
            facts["bounds_deg"] = list(
                frame.box_deg(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
            )
        return facts


@store.command()
def check(store: StoreFile, as_json: AsJson = False) -> None:
    """Read a whole store and compare it with its checksums; exit code 2 if it is damaged."""
    report = check_store(store)
    if as_json:
        # The exit code must hold also where the output is not read.
        with suppress(BrokenPipeError):
            facts = {key: value for key, value in asdict(report).items() if key != "duplicates"}
            print_line(json.dumps({"store": printable(store), "whole": report.whole, **facts}))
        raise typer.Exit(0 if report.whole else InputError.exit_code)
    if not report.whole:
        first = "; ".join(damage.what for damage in report.damage[:3])
        more = f"; and {len(report.damage) - 3} more" if len(report.damage) > 3 else ""
        raise InputError(f"{store} is damaged: {first}{more}")
    print_line(f"{store}: {report.rows:,} {report.holds}, whole")


@store.command()
def repair(store: StoreFile, output: NewStore) -> None:
    """Save the undamaged rows of a store in a new store, in their order."""
    report = repair_store(store, output)
    _print_copied(report, output)
    for damage in report.damage:
        rows = f"rows {damage.first_row} to {damage.first_row + damage.rows - 1}"
        print_line(f"  left out {rows}: {damage.what}")


@store.command()
def merge(stores: Annotated[list[Path], Argument(metavar="STORE...")], output: NewStore) -> None:
    """Join stores of one DEM into one; a place that several have is kept once."""
    _print_copied(merge_stores(stores, output), output)


@store.command()
def export(
    store: StoreFile,
    output: Annotated[
        Path, Option("--output", "-o", metavar="FILE.gpkg", help="The GeoPackage to write.")
    ],
) -> None:
    """Write the locations of the places as a GeoPackage for QGIS, with its style (extra `geo`)."""
    from skyline.report.exports import write_geopackage  # noqa: PLC0415  (slow to load)

    with open_store(store) as opened:
        count = write_geopackage(opened, output)
    print_line(f"{output}: {count:,} places, {output.stat().st_size / 1e6:.1f} MB")


def _print_copied(report: StoreReport, path: Path) -> None:
    size = path.stat().st_size
    each = f", {size / report.rows:.0f} bytes each" if report.rows else ""
    again = f", {report.duplicates} duplicates left out" if report.duplicates else ""
    lost = sum(damage.rows for damage in report.damage)
    damaged = f", {lost} damaged rows left out" if lost else ""
    print_line(f"{path}: {report.rows:,} {report.holds}{each}{again}{damaged}")

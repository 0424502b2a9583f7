"""``skyline info`` and ``explain``: facts about a DEM, a store, OpenGL, and a skyline."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np
from typer import Argument, Option

from skyline.cli.console import AsJson, Crs, Dems, print_line, read_terrain
from skyline.errors import InputError, numbers_of, printable
from skyline.geodesy import Frame
from skyline.render.context import describe_context
from skyline.render.horizon import RenderConfig, render_views
from skyline.skylines import pixel_size
from skyline.store.header import PLACES, SCHEMA_VERSION
from skyline.store.read import is_store, open_store
from skyline.terrain.conventions import model_of
from skyline.terrain.eyes import Viewpoints, place_on, stand_on
from skyline.terrain.heightfield import HeightField

Facts = dict[str, object]


def info(
    path: Annotated[
        list[str] | None,
        Argument(
            metavar="[DEM...|STORE]", help="The files of a DEM, a folder of them, or a store."
        ),
    ] = None,
    gl: Annotated[bool, Option("--gl", help="Show which OpenGL is used, and why.")] = False,
    as_json: AsJson = False,
    crs: Crs = None,
) -> None:
    """Describe a DEM, a store, or the OpenGL in use."""
    if not path and not gl:
        raise InputError("nothing to describe; name a DEM or a store, or give --gl")
    facts: Facts = {**describe_context()} if gl else {}
    if path:
        if len(path) == 1 and is_store(path[0]):
            facts |= _describe_store(path[0])
        else:
            facts |= _describe_terrain(read_terrain(path, crs))
    _print_facts(facts, as_json)


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
        "bounds_deg": list(field.box_deg),
        "height_range_m": list(field.height_range_m),
        "convergence_deg": float(turn_deg),
        **{name: getattr(made, name) for name in ("filled", "hollow", "despiked", "undeclared")},
        "digest": field.digest,
    }


def _describe_store(path: str) -> Facts:
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


def explain(
    dem: Dems,
    at: Annotated[
        str, Option(metavar="LON,LAT", help="Degrees (WGS 84), or easting and northing in metres.")
    ],
    crs: Crs = None,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on, which is left out, and the resulting error."""
    wanted = "LON,LAT in degrees, or easting and northing in metres"
    first, second = numbers_of(at.split(","), 2, f"--at is `{at}`; expected {wanted}")
    terrain = read_terrain(dem, crs)
    east_m, north_m = np.array([[first], [second]])
    if max(abs(first), abs(second)) <= 360.0:
        east_m, north_m = place_on(terrain, first, second)
    eye = stand_on(terrain, easting_m=east_m, northing_m=north_m)
    _print_facts(_describe_scene(terrain, eye), as_json)


def _describe_scene(terrain: HeightField, eye: Viewpoints) -> Facts:
    """Return the terrain modelled for one viewpoint, the terrain left out, and the error."""
    config = RenderConfig()
    # Only a skyline rendered without a tolerance shows the error that the tolerance makes.
    exact = render_views(terrain, eye, replace(config, tolerance_px=0.0))
    given = render_views(terrain, eye, config)
    drop_per_m2 = config.curvature.drop_per_m2
    place = {"easting_m": float(eye.easting_m[0]), "northing_m": float(eye.northing_m[0])}
    eye_m, reach_m = float(eye.eye_elevation_m[0]), terrain.reach_m(**place)
    sight_m = sight_range_m(terrain, eye_m, drop_per_m2)
    short = np.nanmax(exact.v - given.v, initial=0.0)
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
    """Return the distance beyond which nothing rises over the dip horizon.

    From e above the lowest ground the line of sight that grazes it touches at sqrt(e / drop) and
    meets the highest sample, H above, at sqrt(H / drop) farther on.
    """
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

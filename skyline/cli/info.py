"""``skyline info``: facts about a DEM, a store, or the OpenGL in use."""

import json
from collections.abc import Iterator, Mapping
from typing import Annotated

import numpy as np
from typer import Argument, Option

from skyline.cli.console import AsJson, Crs, Reproject, print_line, read_terrain
from skyline.errors import InputError, printable
from skyline.geodesy import Frame
from skyline.render.context import describe_context
from skyline.store import is_store, open_store
from skyline.store.format import PLACES, SCHEMA_VERSION
from skyline.terrain.conventions import model_of
from skyline.terrain.heightfield import HeightField

Facts = dict[str, object]


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
            facts |= _describe_store(path[0])
        else:
            facts |= _describe_terrain(read_terrain(path, crs, reproject))
    print_facts(facts, as_json)


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


def _describe_store(path: str) -> Facts:
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


def print_facts(facts: Facts, as_json: bool) -> None:
    """Print facts as JSON, or as a table of names and texts."""
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

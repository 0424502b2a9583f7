"""``skyline info`` and ``skyline explain``: what a DEM or a store is, and what a skyline needs."""

import json
from typing import Annotated

import typer

from skyline.console import Crs, Dems, NoCurvature, RefractionK, Reproject, Tolerance, Width
from skyline.describe import describe_scene, describe_store, describe_terrain
from skyline.errors import InputError
from skyline.geodesy import Curvature
from skyline.pipeline.config import RenderConfig
from skyline.render.context import describe_context
from skyline.store import is_store
from skyline.terrain.dem import DemOptions, read_dem
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import stand_on

_DEFAULTS = RenderConfig()

AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def info(
    path: Annotated[
        list[str] | None,
        typer.Argument(metavar="[DEM...|STORE]", help="The files of a DEM, or a store."),
    ] = None,
    gl: Annotated[bool, typer.Option("--gl", help="Say which OpenGL is used and why.")] = False,
    as_json: AsJson = False,
    crs: Crs = None,
    reproject: Reproject = False,
) -> None:
    """Describe a DEM, a store, or the OpenGL in use."""
    if not path and not gl:
        raise InputError("nothing to describe; name a DEM or a store, or give --gl")
    facts: dict[str, object] = {**describe_context()} if gl else {}
    if path:
        if len(path) == 1 and is_store(path[0]):
            facts |= describe_store(path[0])
        else:
            facts |= describe_terrain(read_dem(path, DemOptions(crs=crs, reproject=reproject)))
    _say_facts(facts, as_json)


def explain(
    dem: Dems,
    at: Annotated[
        str,
        typer.Option(
            metavar="LON,LAT", help="Degrees (WGS 84), or easting and northing in metres."
        ),
    ],
    width: Width = _DEFAULTS.width,
    tolerance_px: Tolerance = _DEFAULTS.tolerance_px,
    k: RefractionK = _DEFAULTS.curvature.refraction_k,
    no_curvature: NoCurvature = False,
    crs: Crs = None,
    reproject: Reproject = False,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on, what is left out, and what error that makes."""
    curvature = Curvature(refraction_k=k, enabled=not no_curvature)
    config = RenderConfig(width=width, tolerance_px=tolerance_px, curvature=curvature)
    pair = _parse_pair(at)
    terrain = read_dem(dem, DemOptions(crs=crs, reproject=reproject))
    eye = stand_on(terrain, *_place_m(terrain, pair), config.eye_height_m)
    _say_facts(describe_scene(terrain, eye, config), as_json)


def _parse_pair(text: str) -> tuple[float, float]:
    try:
        first, second = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"--at is `{text}`; expected LON,LAT in degrees, or easting and northing in metres"
        ) from error
    return first, second


def _place_m(terrain: HeightField, pair: tuple[float, float]) -> tuple[float, float]:
    """Return easting and northing of degrees that lie on the map; other numbers are metres."""
    if abs(pair[0]) <= 180.0 and abs(pair[1]) <= 90.0:
        east, north = (float(value) for value in terrain.frame.from_lonlat(*pair))
        low_east, low_north, high_east, high_north = terrain.bounds_m
        if low_east <= east <= high_east and low_north <= north <= high_north:
            return east, north
    return pair


def _say_facts(facts: dict[str, object], as_json: bool) -> None:
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for name, value in facts.items():
        values = value if isinstance(value, list) else [value]
        for line, item in enumerate(values):
            shown = f"{item:.9g}" if isinstance(item, float) else item
            typer.echo(f"{name if line == 0 else '':<24} {shown}")

"""``skyline explain``: the terrain that a skyline depends on, and the error of leaving some out."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from typer import Option

from skyline.camera import pixel_size
from skyline.cli.console import AsJson, Crs, Dems, Reproject, parse_numbers, read_terrain
from skyline.cli.info import Facts, print_facts
from skyline.render.horizon import RenderConfig, render_views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import DEFAULT_EYE_HEIGHT_M, Viewpoints, place_on, stand_on


def explain(
    dem: Dems,
    at: Annotated[
        str, Option(metavar="LON,LAT", help="Degrees (WGS 84), or easting and northing in metres.")
    ],
    crs: Crs = None,
    reproject: Reproject = False,
    as_json: AsJson = False,
) -> None:
    """Show which terrain a skyline depends on, which is left out, and the resulting error."""
    wanted = "LON,LAT in degrees, or easting and northing in metres"
    first, second = parse_numbers(at, 2, f"--at is `{at}`; expected {wanted}")
    terrain = read_terrain(dem, crs, reproject)
    east_m: ArrayLike = first
    north_m: ArrayLike = second
    if max(abs(first), abs(second)) <= 360.0:
        east_m, north_m = place_on(terrain.frame, terrain.bounds_m, first, second)
    height_m = DEFAULT_EYE_HEIGHT_M
    eye = stand_on(terrain, easting_m=east_m, northing_m=north_m, eye_height_m=height_m)
    print_facts(_describe_scene(terrain, eye), as_json)


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

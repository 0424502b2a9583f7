"""Which terrain a skyline depends on, which is left out, and the resulting error."""

from dataclasses import replace

import numpy as np

from skyline.render.horizon import RenderConfig, render_views
from skyline.skylines import pixel_size
from skyline.terrain.eyes import Viewpoints
from skyline.terrain.heightfield import HeightField
from skyline.terrain.sight_range import share_beyond, sight_range_m


def explain_skyline(terrain: HeightField, eye: Viewpoints) -> dict[str, object]:
    """Return the terrain modelled for one viewpoint, the terrain left out, and the error."""
    config = RenderConfig()
    # Only a skyline rendered without a tolerance shows the error that the tolerance makes.
    exact = render_views(terrain, eye, replace(config, tolerance_px=0.0))
    given = render_views(terrain, eye, config)
    drop_per_m2 = config.curvature.drop_per_m2
    place = {"easting_m": float(eye.easting_m[0]), "northing_m": float(eye.northing_m[0])}
    eye_m = float(eye.eye_elevation_m[0])
    reach_m = terrain.reach_m(**place)
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
    # The tangent changes by drop d^2 / z, and d is at most the root of 2 times z.
    return float(np.sqrt(2.0)) * drop_per_m2 * reach_m / pixel_size(width)

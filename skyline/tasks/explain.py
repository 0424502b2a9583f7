"""The terrain on which a skyline depends, and the rest's error."""

from collections.abc import Sequence

import numpy as np

from skyline.geodesy.earth import Curvature
from skyline.render.horizon import RenderConfig, render_views
from skyline.skylines import pixel_size
from skyline.tasks.listener import Listener
from skyline.tasks.terrain import read_terrain
from skyline.terrain.sight_range import share_beyond, sight_range_m
from skyline.terrain.viewpoints import position_on, stand_on

MEANINGS = {
    "width": "columns of a view of 90 degrees",
    "skyline_depth_m": "least, median and greatest distance of the skyline",
    "flagged_columns": "share of the skyline at the model's edge or a hole; a larger model may "
    "change it",
    "data_reach_m": "distance of the model's farthest sample",
    "sight_m": "no terrain as high as the model's can be seen beyond this distance",
    "samples_beyond_sight": "share of the model's samples that lie beyond it",
    "curvature_bound_px": "greatest error if the Earth's curvature, which is included, were left "
    "out",
}
"""The meanings of facts, in words."""


def explain_skyline(
    dem: Sequence[str], crs: str | None, position: tuple[float, float], listener: Listener
) -> dict[str, object]:
    """Return facts about the skyline at a longitude and a latitude.

    They are the terrain that is modelled, the terrain that is left out, and the resulting error.
    Raises as `read_terrain`, and `OffMapError` for a position off the map.
    """
    terrain = read_terrain(listener, dem, crs)
    easting_m, northing_m = position_on(terrain, *position)
    eye = stand_on(terrain, easting_m=easting_m, northing_m=northing_m)
    config = RenderConfig()
    views = render_views(terrain, eye, config)
    stands = {"easting_m": float(eye.easting_m[0]), "northing_m": float(eye.northing_m[0])}
    eye_m = float(eye.eye_elevation_m[0])
    reach_m = terrain.reach_m(**stands)
    sight_m = sight_range_m(terrain, eye_m, config.curvature)
    return {
        **stands,
        "eye_elevation_m": eye_m,
        "width": config.width,
        "skyline_depth_m": [float(v) for v in np.nanquantile(views.depth_m, [0.0, 0.5, 1.0])]
        if np.isfinite(views.depth_m).any()
        else [],
        "flagged_columns": float((views.flags != 0).mean()),
        "data_reach_m": reach_m,
        "sight_m": sight_m,
        "samples_beyond_sight": share_beyond(terrain, eye, sight_m),
        "curvature_bound_px": curvature_bound_px(reach_m, config.curvature, config.width),
    }


def curvature_bound_px(reach_m: float, curvature: Curvature, width: int) -> float:
    """Return the greatest error of a skyline without curvature.

    The error is in px of ``width`` columns. ``reach_m`` is the distance of the farthest sample.
    """
    # The tangent changes by drop d^2 / z, and d is at most the root of 2 times z.
    return float(np.sqrt(2.0)) * curvature.drop_per_m2 * reach_m / pixel_size(width)

"""Training photographs of another kind: views of made terrain, as demos and tests draw them.

Their sky is the query maker's: smooth, with clouds that gather about the ridge.
"""

from functools import lru_cache

import numpy as np

from skyline.geodesy import Frame
from skyline.render.depth import DepthRenderer
from skyline.terrain.heightfield import HeightField
from skyline_bench.queries.photographs import Scenery, draw_photo
from skyline_bench.queries.synthetic import QueryConfig, make_queries
from skyline_bench.training.landscapes import (
    CELL_M,
    COVER,
    GROUND,
    SKY,
    UNKNOWN,
    TrainingPhoto,
    draw_heights,
)

_CELLS = 400
_FRAME = Frame.from_crs("EPSG:32632")
_WEST_M, _NORTH_M = 600_000.0, 5_180_000.0
_RENDERED_PX = 1024
"""Columns of the depth images of a heading, of 90 degrees."""
_POSES = 4
"""Poses of which the one that shows most skyline is drawn: most others show a slope alone."""
_PLACES_SHARE = 0.3
"""Share of the terrain, at its middle, in which eyes stand."""


def draw_view(seed: tuple[int, ...], terrain_seed: int, size_px: tuple[int, int]) -> TrainingPhoto:
    """Draw one photograph from a random place of made terrain, in random weather."""
    rng = np.random.default_rng([13, *seed])
    terrain = _terrain(terrain_seed)
    bottom, top = terrain.height_range_m
    scenery = Scenery(
        visibility_m=float(np.exp(rng.uniform(np.log(8e3), np.log(300e3)))),
        snow_line_m=float(rng.choice([np.inf, rng.uniform(bottom, top)])),
        tree_line_m=float(rng.uniform(bottom - 0.3 * (top - bottom), top + 0.5 * (top - bottom))),
        clouds=float(rng.uniform(0.0, 1.0)),
    )
    width, height = size_px
    config = QueryConfig(
        fov_deg=(30.0, 90.0),
        occluded_share=(0.0, 0.3),
        width_px=width,
        height_px=height,
        eye_height_m=float(np.exp(rng.uniform(np.log(2.0), np.log(300.0)))),
        azimuths=16 * width,
    )
    west, south, east, north = terrain.bounds_m
    margin = 0.5 * (1.0 - _PLACES_SHARE)
    aside, along = margin * (east - west), margin * (north - south)
    area = west + aside, south + along, east - aside, north - along
    queries = make_queries(terrain, area, _POSES, int(rng.integers(1 << 31)), config)
    query = max(queries, key=lambda one: np.count_nonzero(np.isfinite(one.row_px)))
    with DepthRenderer(terrain, _RENDERED_PX) as renderer:
        image = draw_photo(renderer, query, int(rng.integers(1 << 31)), scenery)
    # Rows of queries count pixel centres.
    row = query.row_px + 0.5
    row = np.where((row > 1.0) & (row < height - 1.0), row, np.nan)
    rows = np.arange(height)[:, np.newaxis] + 0.5
    label = np.where(rows < row, SKY, GROUND).astype(np.uint8)
    label[:, np.isnan(row)] = UNKNOWN
    for occluder in query.occluders:
        columns = slice(*occluder.columns)
        hidden = rows > occluder.row_px + 0.5
        label[:, columns][hidden] = COVER
        row[columns][occluder.row_px < row[columns] - 0.5] = np.nan
    return TrainingPhoto(image, label, np.asarray(row, dtype=np.float32))


@lru_cache(maxsize=1)
def _terrain(seed: int) -> HeightField:
    """Return terrain of a random spacing, kept for the photographs after."""
    rng = np.random.default_rng([17, seed])
    heights = draw_heights(rng, seed)[:_CELLS, :_CELLS]
    spacing_m = float(np.exp(rng.uniform(np.log(20.0), np.log(90.0))))
    heights = heights * np.float32(spacing_m / CELL_M)
    return HeightField(heights, _WEST_M, _NORTH_M, spacing_m, spacing_m, _FRAME)

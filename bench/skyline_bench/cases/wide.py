"""Hard cases of the whole map: plains, planets, holes, tiny grids and large coordinates."""

from dataclasses import replace
from functools import partial

import numpy as np

from skyline.arrays import Float64Array
from skyline.camera import HEADINGS, columns_u
from skyline.geodesy import Curvature
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.cases.closed_forms import (
    FLAT,
    HORIZON_ONLY,
    ClosedForm,
    SceneCase,
    eyes_anywhere,
    eyes_at,
    field_of,
    rough_field,
    rough_heights,
)
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import Scene

MARS_RADIUS_M = 3_389_500.0

# --- plains ---------------------------------------------------------------------------------

_PLAIN_SPACING_M, _PLAIN_HALF = 100.0, 128


def _plain(*eye_heights_m: float) -> Scene:
    """Stand in the middle of a plain of 25.6 km."""
    field = field_of(np.zeros((2 * _PLAIN_HALF + 1,) * 2), _PLAIN_SPACING_M)
    middle = [float(_PLAIN_HALF)] * len(eye_heights_m)
    return Scene(field, eyes_at(field, middle, middle, eye_heights_m))


def _plain_skyline(scene: Scene) -> ClosedForm:
    """Return the dip of the horizon, or of the data's end where that is nearer."""
    eye_height = np.repeat(scene.viewpoints.eye_elevation_m, len(HEADINGS))[:, np.newaxis]
    drop = scene.curvature.drop_per_m2 * (1.0 + columns_u(scene.width) ** 2)
    end = _PLAIN_HALF * _PLAIN_SPACING_M
    # v(z) = -h / z - drop z is greatest at sqrt(h / drop).
    depth = np.minimum(np.sqrt(eye_height / drop), end)
    # An edge of length L hangs up to c L^2 / 4 below the parabola; rows are crossed within half
    # a spacing of the greatest v, which costs drop (spacing / 2)^2 / z.
    length_squared = 2.0 * _PLAIN_SPACING_M**2
    hang = scene.curvature.drop_per_m2 * length_squared / 4.0
    off = drop.max() * (_PLAIN_SPACING_M / 2.0) ** 2
    return ClosedForm(-eye_height / depth - drop * depth, float((hang + off) / depth.min()))


def _constant(eye_height_m: float) -> Scene:
    field = field_of(np.full((37, 53), 1234.5), 16.0)
    row, col = [18.0, 9.25, 3.0], [26.0, 17.5, 49.125]
    return Scene(field, eyes_at(field, row, col, eye_height_m), curvature=FLAT)


def _constant_skyline(scene: Scene) -> ClosedForm:
    """Return v = -h / z with z where each column leaves the map."""
    west, south, east, north = scene.field.bounds_m
    eyes = scene.viewpoints
    to_north, to_east = north - eyes.northing_m, east - eyes.easting_m
    to_south, to_west = eyes.northing_m - south, eyes.easting_m - west
    ahead = np.stack([to_north, to_east, to_south, to_west], axis=1)[..., np.newaxis]
    to_right, to_left = np.roll(ahead, -1, axis=1), np.roll(ahead, 1, axis=1)
    u = columns_u(scene.width)
    depth = np.minimum(ahead, np.where(u > 0.0, to_right, to_left) / np.maximum(np.abs(u), 1e-30))
    above = eyes.eye_elevation_m - scene.field.height_range_m[0]
    return ClosedForm((-above[:, np.newaxis, np.newaxis] / depth).reshape(-1, scene.width))


PLAIN_CASES = (
    SceneCase(
        "endless plain, dip of the horizon",
        "a flat maximum of v between vertices 100 m apart, where curvature meets eye height",
        lambda: _plain(0.5, 2.0, 9.0),
        _plain_skyline,
    ),
    SceneCase(
        "endless plain, the data's end",
        "the horizon lies beyond the data, so every column ends at the border, truncated",
        lambda: _plain(50.0, 1000.0),
        _plain_skyline,
    ),
    SceneCase(
        "constant DEM",
        "a height range of 0 scales stored heights by 0 / 0",
        lambda: _constant(2.0),
        _constant_skyline,
    ),
    SceneCase(
        "constant DEM, eye height 0",
        "every point of the map ties at v = 0",
        lambda: _constant(0.0),
        _constant_skyline,
        HORIZON_ONLY,
    ),
)

# --- planets --------------------------------------------------------------------------------


def _planet(curvature: Curvature) -> Scene:
    field = field_of(rough_heights(400, 400, 1500.0, seed=11), 128.0)
    return Scene(field, eyes_anywhere(field, 2, 10.0), curvature=curvature)


PLANET_CASES = tuple(
    SceneCase(name, breaks, partial(_planet, curvature))
    for name, breaks, curvature in (
        ("refraction 0", "a default of 0.13 slips in for 0", Curvature(refraction_k=0.0)),
        ("refraction 0.25", "refraction enters twice, or not at all", Curvature(refraction_k=0.25)),
        ("Mars", "the Earth's radius is written into a shader", Curvature(MARS_RADIUS_M, 0.0)),
        ("no curvature", "a drop of 0 is divided by", FLAT),
    )
)

# --- holes ----------------------------------------------------------------------------------


def _holed_heights() -> Float64Array:
    """Return rough terrain with a void, a one-sample void, thin necks and lone samples."""
    heights = rough_heights(96, 96, seed=12)
    heights[30:40, 50:60] = np.nan
    heights[60, 40] = np.nan
    # A neck one cell wide between two voids, and one of a row of samples, which is no surface.
    heights[70:74, 20:30], heights[70:74, 32:40] = np.nan, np.nan
    heights[75:77, 20:30] = np.nan
    # Lone samples in a void belong to no triangle.
    heights[10:20, 10:30] = np.nan
    heights[15, 12:28:3] = 5000.0
    return heights


def _beside_voids() -> Scene:
    field = field_of(_holed_heights())
    # On rims, at corners of voids, inside half cells, between the two voids, south of the spikes.
    row = [29.0, 40.0, 29.25, 40.25, 60.0, 60.75, 72.5, 74.5, 22.375]
    col = [55.0, 49.0, 59.75, 60.5, 41.0, 39.25, 30.5, 18.0, 20.5]
    return Scene(field, eyes_at(field, row, col, 1.0))


def _void_ahead() -> Scene:
    """Stand on the southern rim of a void that fills the north, and north-east of one."""
    heights = rough_heights(64, 64, seed=13)
    heights[:31] = np.nan
    field = field_of(heights)
    return Scene(field, eyes_at(field, [31.0, 31.0, 63.0], [20.0, 40.375, 20.5], 5.0))


HOLE_CASES = (
    SceneCase(
        "voids next to the eye",
        "a hole's stand-in height enters an edge; lone samples and thin necks are drawn",
        _beside_voids,
    ),
    SceneCase(
        "heading without data",
        "no edge is crossed: what is read back is a fill value, not NaN and no data",
        _void_ahead,
    ),
)

# --- tiny grids -----------------------------------------------------------------------------


def _tiny(rows: int, cols: int) -> Scene:
    field = field_of(rough_heights(max(rows, 2), max(cols, 2), 20.0, seed=14)[:rows, :cols])
    row = np.array([0.25, 0.0, 0.625]) * (rows - 1)
    col = np.array([0.75, 0.0, 0.125]) * (cols - 1)
    return Scene(field, eyes_at(field, row, col, [2.0, 0.0, 0.5]), 65)


TINY_CASES = tuple(
    SceneCase(f"{rows} x {cols} DEM", breaks, partial(_tiny, rows, cols))
    for rows, cols, breaks in (
        (2, 2, "one cell: trees, tiles and textures smaller than any of their levels"),
        (2, 9, "one strip of cells, seen along and across"),
        (1, 12, "one row has samples and edges, but no triangle: no surface to be seen"),
        (12, 1, "one column, likewise"),
        (1, 1, "one sample, likewise"),
    )
)

# --- large coordinates ----------------------------------------------------------------------


def _far_from_origin() -> Scene:
    """Stand in a field of half-metre samples at an easting and a northing of 10,000 km."""
    heights = rough_heights(96, 96, 12.0, seed=15) + 7000.0
    field = field_of(heights, 0.5, west_m=1e7, north_m=1e7)
    return Scene(field, eyes_anywhere(field, 4, [0.0, 0.25, 1.75, 20.0]))


def _same_at_origin(scene: Scene) -> ClosedForm:
    """Return the oracle's skylines of the same place, moved to the origin."""
    moved = replace(scene.field, west_m=0.0, north_m=0.0)
    eyes = scene.viewpoints
    near = Viewpoints(eyes.easting_m - 1e7, eyes.northing_m - 1e7, eyes.eye_elevation_m)
    # The difference of two numbers within a factor of 2 is exact, so nothing is lost.
    views = oracle.skyline(moved, near, scene.width, scene.curvature)
    return ClosedForm(views.elevation_tan.astype(np.float64))


LARGE_CASES = (
    SceneCase(
        "eastings of 10,000 km with samples of 0.5 m",
        "32-bit floats are a metre apart there",
        _far_from_origin,
        _same_at_origin,
    ),
    SceneCase(
        "heights over 8 km above the datum",
        "32-bit heights less a 32-bit eye: half a millimetre lost",
        lambda: Scene(
            field := field_of(rough_field(16).heights_m.astype(np.float64) / 64.0 + 8800.0, 2.0),
            eyes_anywhere(field, 4, [0.0, 0.0, 0.1, 2.0]),
        ),
    ),
)

WIDE_CASES = (*PLAIN_CASES, *PLANET_CASES, *HOLE_CASES, *TINY_CASES, *LARGE_CASES)

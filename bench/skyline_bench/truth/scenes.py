"""Hard cases of the eye's place, of terrain, and of maps.

The terrain is steep or close.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from skyline.arrays import Float64Array
from skyline.geodesy.earth import Curvature
from skyline.skylines import HEADINGS, columns_u
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.truth import closed_forms as forms
from skyline_bench.truth import oracle
from skyline_bench.truth.agreement import SkylineScene

MAX_DEPTH_WIDTH = 641
"""A depth image of W x W pixels takes long above this."""


_SHARE = np.arange(1.0, 10.0) * 7.0 / 64.0
_LOW_AND_HIGH_M = np.tile([0.0, 2.0, 50.0], 3)


def _eye_at_offset(row_share: float, col_share: float) -> SkylineScene:
    """Stand so many shares of a cell south and east of samples."""
    field = forms.rough_field()
    row, col = forms.spots(field, len(_SHARE))
    row = row + row_share * _SHARE
    col = col + col_share * _SHARE
    return SkylineScene(field, forms.eyes_at(field, row, col, _LOW_AND_HIGH_M))


def _eye_near_edges() -> SkylineScene:
    """Eyes close to an edge, a diagonal or a sample.

    They are 4 m to 0.06 mm away, and no higher than the ground.
    """
    field = forms.rough_field()
    away = 2.0 ** -np.array([3.0, 5.0, 7.0, 8.0, 9.0, 10.0, 12.0, 15.0, 19.0])
    row, col = forms.spots(field, 3 * len(away))
    zero = np.zeros_like(away)
    row += np.concatenate([away, 0.375 + away, away])
    col += np.concatenate([0.375 + zero, 0.375 + zero, 0.5 * away])
    return SkylineScene(field, forms.eyes_at(field, row, col, 0.0))


def _columns_along_diagonals(
    spacing_east_m: float, spacing_north_m: float, width: int
) -> SkylineScene:
    field = forms.field_of(forms.rough_heights(64, 96, seed=5), spacing_east_m, spacing_north_m)
    row, col = forms.spots(field, 6)
    share = np.array([0.0, 0.0, 0.25, 0.25, 0.5, 0.75])
    return SkylineScene(field, forms.eyes_at(field, row + share, col + share, 40.0), width)


def _of_width(width: int) -> forms.SceneCase:
    def scene() -> SkylineScene:
        field = forms.rough_field()
        return SkylineScene(field, forms.eyes_anywhere(field, 1, 2.0), width)

    return forms.SceneCase(
        f"W = {width}",
        "columns per group of lanes: a remainder left out, or written twice",
        scene,
        paths=("horizon", "depth") if width <= MAX_DEPTH_WIDTH else forms.HORIZON_ONLY,
    )


def _long_cells() -> SkylineScene:
    field = forms.field_of(forms.rough_heights(40, 400, 200.0, seed=6), 10.0, 200.0)
    return SkylineScene(field, forms.eyes_anywhere(field, 3, 2.0))


_UNDERFOOT = "the edge underfoot lies in no direction, or in both"

GRID_CASES = (
    *(
        forms.SceneCase(f"eye on a {where}", breaks, partial(_eye_at_offset, *shares))
        for where, breaks, shares in (
            ("sample", "edges that start at the eye have depth 0, and rays along them meet nothing "
             "else", (0.0, 0.0)),
            ("row's edge", _UNDERFOOT, (0.0, 1.0)),
            ("column's edge", _UNDERFOOT, (1.0, 0.0)),
            ("diagonal", "the side of the diagonal is decided by rounding", (1.0, 1.0)),
        )
    ),
    forms.SceneCase("eye a hair off an edge",
        "an edge's height over the eye is rounded, then divided by next to nothing",
        _eye_near_edges, paths=forms.HORIZON_ONLY),
    forms.SceneCase("eye height 0",
        "the ground underfoot rises or falls from the eye itself: 0 / 0",
        lambda: SkylineScene(field := forms.rough_field(), forms.eyes_anywhere(field, 8, 0.0))),
    forms.SceneCase("columns along grid lines",
        "the middle column of an odd W runs along a row or column and meets samples only",
        lambda: replace(_eye_at_offset(0.0, 0.0), width=641)),
    forms.SceneCase("columns along diagonals",
        "a ray parallel to the diagonals divides by a rate of exactly 0",
        lambda: _columns_along_diagonals(3.0, 8.0, 8)),
    forms.SceneCase("columns almost along diagonals",
        "a ray parallel to the diagonals but for rounding crosses one at any depth",
        lambda: _columns_along_diagonals(20.0, 50.0, 5)),
    forms.SceneCase("samples 20 times as far apart north as east",
        "one strip of cells is crossed by a ray through twenty cells", _long_cells),
    *(_of_width(width) for width in (2, 3, 7, 64, 161, 640, 1023, 2048, 8191, 8192)),
)  # fmt: skip


def _pyramid() -> SkylineScene:
    """Return the summit of a pyramid, |east| + |north|.

    Its flat faces fold along grid lines.
    """
    steps = np.abs(np.arange(-64.0, 65.0))
    heights = 4000.0 - 16.0 * (steps[:, np.newaxis] + steps)
    field = forms.field_of(heights)
    eyes = forms.eyes_at(field, [64.0] * 3, [64.0] * 3, [0.5, 2.0, 100.0])
    return SkylineScene(field, eyes, 641, forms.FLAT)


def _pyramid_skyline(scene: SkylineScene) -> forms.ClosedForm:
    # y(z) = -h - slope z (1 + |u|), so v is greatest where the data ends, 64 cells ahead.
    u = np.abs(columns_u(scene.width))
    eyes = scene.viewpoints
    ground = scene.field.height_at(easting_m=eyes.easting_m, northing_m=eyes.northing_m)
    above = np.repeat(eyes.eye_elevation_m - ground, len(HEADINGS))[:, np.newaxis]
    return forms.ClosedForm(-above / (64.0 * forms.SPACING_M) - 0.5 * (1.0 + u))


_PIT_CELLS = 1
_PIT_SPACING_M = 16.0


def _pit(depth_m: float) -> SkylineScene:
    """Return a square pit with walls of one cell.

    Its middle is one cell from their foot.
    """
    steps = np.abs(np.arange(-40, 41))
    floor = np.maximum(steps[:, np.newaxis], steps) <= _PIT_CELLS
    field = forms.field_of(np.where(floor, 0.0, depth_m), _PIT_SPACING_M)
    return SkylineScene(field, forms.eyes_at(field, [40.0], [40.0], 2.0), 640, forms.FLAT)


def _pit_skyline(scene: SkylineScene) -> forms.ClosedForm:
    # The rim is a square 2 cells out, but in the corners to the north-east and south-west the
    # split cuts across it, from (1, 2) to (2, 1): a line at east + north = 3 cells.
    u = columns_u(scene.width)
    rim = _PIT_CELLS + 1.0
    north = np.where(u > 1.0 - 1.0 / rim, (2.0 * _PIT_CELLS + 1.0) / (1.0 + u), rim)
    depth = _PIT_SPACING_M * np.stack([north, north[::-1], north, north[::-1]])
    rise = float(scene.field.height_range_m[1] - scene.viewpoints.eye_elevation_m[0])
    return forms.ClosedForm(rise / depth)


def _below_a_crest(slope: float) -> SkylineScene:
    """Stand on a slope to the north, just below the crest.

    The eye is 1 mm (2^-10 m) below the crest.
    """
    spacing = 4.0
    profile = -slope * spacing * np.abs(np.arange(41.0) - 16.0)
    field = forms.field_of(np.broadcast_to(profile[:, np.newaxis], (41, 41)), spacing)
    off = 2.0**-10 / spacing
    eyes = forms.eyes_at(field, [16.0 + off] * 2, [20.25, 20.0], 0.0)
    return SkylineScene(field, eyes, 640, forms.FLAT)


def _slope_skyline(scene: SkylineScene) -> forms.ClosedForm:
    """Return the skyline of the eye's own slope.

    Uphill the crest is a millimetre away; downhill the slope has no end.
    """
    field = scene.field
    slope = float(field.heights_m[16, 0] - field.heights_m[17, 0]) / field.spacing_north_m
    u = columns_u(scene.width)
    tan = [slope * oracle.directions_at(heading, u)[:, 1] for heading in HEADINGS]
    return forms.ClosedForm(np.tile(np.stack(tan), (len(scene.viewpoints), 1)))


def _at_a_wall() -> SkylineScene:
    """Stand 1 mm (2^-10 m) before the foot of a wall.

    The wall rises 60 m in one cell of half a metre.
    """
    heights = np.zeros((64, 64))
    heights[:20] = 60.0
    field = forms.field_of(heights, 0.5)
    off = 2.0**-10 / 0.5
    eyes = forms.eyes_at(field, [20.0 + off] * 3, [30.25] * 3, [0.0, 0.125, 2.0])
    return SkylineScene(field, eyes, 640, forms.FLAT)


def _cliff() -> SkylineScene:
    heights = forms.rough_heights(96, 96, 200.0, seed=8)
    heights[:40] += 3000.0
    field = forms.field_of(heights)
    # At the foot, halfway up the face, on the brink, and back in the plain.
    row = np.array([40.25, 39.5, 38.96875, 78.0])
    return SkylineScene(field, forms.eyes_at(field, row, [50.125, 49.25, 48.5, 47.0], 2.0))


def _spike() -> SkylineScene:
    heights = np.full((80, 80), 300.0)
    heights[40, 40] = 400.0
    field = forms.field_of(heights)
    # On its tip, on its flank, a cell away and half the map away, with the tip between columns.
    row = [40.0, 40.25, 41.0, 70.3125]
    col = [40.0, 40.125, 40.0, 60.5625]
    return SkylineScene(field, forms.eyes_at(field, row, col, [2.0, 0.0, 2.0, 2.0]), 640)


def _near_and_far() -> SkylineScene:
    """Return a view of a near edge and a far summit.

    The edge is at 0.1 m, and the summit at 250 km.
    """
    spacing = 250.0
    heights = np.full((1030, 41), -400.0)
    # The row just north of the eye falls from west to east, through the eye's own height.
    heights[1010:] = 50.0 * (20.0 - np.arange(41.0))
    heights[10:14] = 9000.0
    field = forms.field_of(heights, spacing)
    row = 1010.0 + 0.1 / spacing
    return SkylineScene(field, forms.eyes_at(field, [row] * 2, [20.0, 20.0], [0.0, 0.005]), 641)


def _long() -> SkylineScene:
    field = forms.field_of(forms.rough_heights(10_001, 6, 100.0, seed=9), 8.0)
    return SkylineScene(field, forms.eyes_at(field, [9998.7, 5000.0], [2.3, 3.0], 60.0), 16)


STEEP_CASES = (
    forms.SceneCase("summit",
        "all skylines are dips: a maximum that starts from 0 never falls below it",
        _pyramid, _pyramid_skyline),
    forms.SceneCase("pit with walls of 63 degrees",
        "skylines past 45 degrees leave the depth image, and bounds for small v",
        partial(_pit, 64.0), _pit_skyline),
    forms.SceneCase("pit with walls of 88 degrees",
        "skylines past 85 degrees: v above 11", partial(_pit, 1000.0), _pit_skyline),
    forms.SceneCase("eye 1 mm from a wall",
        "depth of the nearest edge is 0.002 of a cell and its v is in the hundreds", _at_a_wall),
    *(
        forms.SceneCase(f"eye 1 mm below a crest of {steep} degrees",
            "the skyline itself is 1 mm away, its height over the eye lost in rounding",
            partial(_below_a_crest, slope), _slope_skyline, forms.HORIZON_ONLY)
        for steep, slope in ((45, 1.0), (87, 20.0))
    ),
    forms.SceneCase("3 km cliff in one cell",
        "a fraction along an edge costs 3 km times its rounding", _cliff),
    forms.SceneCase("one-sample spike",
        "one sample in 6,400 is the skyline: culled, or missed by rays", _spike),
    forms.SceneCase("0.1 m and 250 km in one view",
        "heights, depths and curvature over six decades",
        _near_and_far, paths=forms.HORIZON_ONLY),
    forms.SceneCase("10,000 rows of 6 samples",
        "more strips than a tree of blocks is deep, and next to none across",
        _long, paths=forms.HORIZON_ONLY),
)  # fmt: skip


MARS_RADIUS_M = 3_389_500.0


_PLAIN_SPACING_M = 100.0
_PLAIN_HALF = 128
"""Samples from the middle of the plain to its border."""


def _plain(*eye_heights_m: float) -> SkylineScene:
    """Stand in the middle of a plain of 25.6 km."""
    field = forms.field_of(np.zeros((2 * _PLAIN_HALF + 1,) * 2), _PLAIN_SPACING_M)
    middle = [float(_PLAIN_HALF)] * len(eye_heights_m)
    return SkylineScene(field, forms.eyes_at(field, middle, middle, eye_heights_m))


def _plain_skyline(scene: SkylineScene) -> forms.ClosedForm:
    """Return the dip of the horizon, even past the data's end."""
    eye_height = np.repeat(scene.viewpoints.eye_elevation_m, len(HEADINGS))[:, np.newaxis]
    drop = scene.curvature.drop_per_m2 * (1.0 + columns_u(scene.width) ** 2)
    # v(z) = -h / z - drop z is greatest at sqrt(h / drop).
    depth = np.sqrt(eye_height / drop)
    # An edge of length L hangs up to c L^2 / 4 below the parabola; rows are crossed within half
    # a spacing of the greatest v, which costs drop (spacing / 2)^2 / z.
    length_squared = 2.0 * _PLAIN_SPACING_M**2
    hang = scene.curvature.drop_per_m2 * length_squared / 4.0
    off = drop.max() * (_PLAIN_SPACING_M / 2.0) ** 2
    return forms.ClosedForm(-eye_height / depth - drop * depth, float((hang + off) / depth.min()))


def _constant(eye_height_m: float) -> SkylineScene:
    field = forms.field_of(np.full((37, 53), 1234.5), 16.0)
    row = [18.0, 9.25, 3.0]
    col = [26.0, 17.5, 49.125]
    return SkylineScene(field, forms.eyes_at(field, row, col, eye_height_m), curvature=forms.FLAT)


def _constant_skyline(scene: SkylineScene) -> forms.ClosedForm:
    """Return v = -h/z at z where columns leave the map."""
    west, south, east, north = scene.field.bounds_m
    eyes = scene.viewpoints
    to_north = north - eyes.northing_m
    to_east = east - eyes.easting_m
    to_south = eyes.northing_m - south
    to_west = eyes.easting_m - west
    ahead = np.stack([to_north, to_east, to_south, to_west], axis=1)[..., np.newaxis]
    to_right = np.roll(ahead, -1, axis=1)
    to_left = np.roll(ahead, 1, axis=1)
    u = columns_u(scene.width)
    depth = np.minimum(ahead, np.where(u > 0.0, to_right, to_left) / np.maximum(np.abs(u), 1e-30))
    above = eyes.eye_elevation_m - scene.field.height_range_m[0]
    return forms.ClosedForm((-above[:, np.newaxis, np.newaxis] / depth).reshape(-1, scene.width))


PLAIN_CASES = (
    forms.SceneCase("endless plain, dip of the horizon",
        "a flat maximum of v between vertices 100 m apart, where curvature meets eye height",
        lambda: _plain(0.5, 2.0, 9.0), _plain_skyline),
    forms.SceneCase("endless plain, the data's end",
        "the horizon lies beyond the data, which end far below it: truncated, and raised to it",
        lambda: _plain(50.0, 1000.0), _plain_skyline),
    forms.SceneCase("constant DEM", "a height range of 0 scales stored heights by 0 / 0",
        lambda: _constant(2.0), _constant_skyline),
    forms.SceneCase("constant DEM, eye height 0", "every point of the map ties at v = 0",
        lambda: _constant(0.0), _constant_skyline, forms.HORIZON_ONLY),
)  # fmt: skip


def _planet(curvature: Curvature) -> SkylineScene:
    field = forms.field_of(forms.rough_heights(400, 400, 1500.0, seed=11), 128.0)
    return SkylineScene(field, forms.eyes_anywhere(field, 2, 10.0), curvature=curvature)


PLANET_CASES = tuple(
    forms.SceneCase(name, breaks, partial(_planet, curvature))
    for name, breaks, curvature in (
        ("refraction 0", "a default of 0.13 slips in for 0", Curvature(refraction_k=0.0)),
        ("refraction 0.25", "refraction enters twice, or not at all", Curvature(refraction_k=0.25)),
        ("Mars", "the Earth's radius is written into a shader", Curvature(MARS_RADIUS_M, 0.0)),
        ("no curvature", "a drop of 0 is divided by", forms.FLAT),
    )
)


def _holed_heights() -> Float64Array:
    """Return rough terrain with holes of several kinds.

    It has a void, a void of one sample, thin necks and lone samples.
    """
    heights = forms.rough_heights(96, 96, seed=12)
    heights[30:40, 50:60] = np.nan
    heights[60, 40] = np.nan
    # A neck one cell wide between two voids, and one of a row of samples, which is no surface.
    heights[70:74, 20:30] = np.nan
    heights[70:74, 32:40] = np.nan
    heights[75:77, 20:30] = np.nan
    # Lone samples in a void belong to no triangle.
    heights[10:20, 10:30] = np.nan
    heights[15, 12:28:3] = 5000.0
    return heights


def _beside_voids() -> SkylineScene:
    field = forms.field_of(_holed_heights())
    # On rims, at corners of voids, inside half cells, between the two voids, south of the spikes.
    row = [29.0, 40.0, 29.25, 40.25, 60.0, 60.75, 72.5, 74.5, 22.375]
    col = [55.0, 49.0, 59.75, 60.5, 41.0, 39.25, 30.5, 18.0, 20.5]
    return SkylineScene(field, forms.eyes_at(field, row, col, 1.0))


def _void_ahead() -> SkylineScene:
    """Stand on the rims of voids.

    One eye stands on the southern rim of a void that fills the north, another north-east of a void.
    """
    heights = forms.rough_heights(64, 64, seed=13)
    heights[:31] = np.nan
    field = forms.field_of(heights)
    return SkylineScene(field, forms.eyes_at(field, [31.0, 31.0, 63.0], [20.0, 40.375, 20.5], 5.0))


HOLE_CASES = (
    forms.SceneCase("voids next to the eye",
        "a hole's stand-in height enters an edge; lone samples and thin necks are drawn",
        _beside_voids),
    forms.SceneCase("heading without data",
        "no edge is crossed: what is read back is a fill value, not NaN and no data", _void_ahead),
)  # fmt: skip


def _tiny(rows: int, cols: int) -> SkylineScene:
    field = forms.field_of(
        forms.rough_heights(max(rows, 2), max(cols, 2), 20.0, seed=14)[:rows, :cols]
    )
    row = np.array([0.25, 0.0, 0.625]) * (rows - 1)
    col = np.array([0.75, 0.0, 0.125]) * (cols - 1)
    return SkylineScene(field, forms.eyes_at(field, row, col, [2.0, 0.0, 0.5]), 65)


TINY_CASES = tuple(
    forms.SceneCase(f"{rows} x {cols} DEM", breaks, partial(_tiny, rows, cols))
    for rows, cols, breaks in (
        (2, 2, "one cell: trees, tiles and textures smaller than any of their levels"),
        (2, 9, "one strip of cells, seen along and across"),
        (1, 12, "one row has samples and edges, but no triangle: no surface to be seen"),
        (12, 1, "one column, likewise"),
        (1, 1, "one sample, likewise"),
    )
)


def _far_from_origin() -> SkylineScene:
    """Stand in a field far from its map's origin.

    The easting and the northing are 10,000 km, and samples are half a metre apart.
    """
    heights = forms.rough_heights(96, 96, 12.0, seed=15) + 7000.0
    field = forms.field_of(heights, 0.5, west_m=1e7, north_m=1e7)
    return SkylineScene(field, forms.eyes_anywhere(field, 4, [0.0, 0.25, 1.75, 20.0]))


def _same_at_origin(scene: SkylineScene) -> forms.ClosedForm:
    """Return the oracle's skylines of the same place, moved to the origin."""
    moved = replace(scene.field, west_m=0.0, north_m=0.0)
    eyes = scene.viewpoints
    near = Viewpoints(
        easting_m=eyes.easting_m - 1e7,
        northing_m=eyes.northing_m - 1e7,
        eye_elevation_m=eyes.eye_elevation_m,
    )
    # The difference of two numbers within a factor of 2 is exact, so nothing is lost.
    views = oracle.skyline(moved, near, scene.width, scene.curvature)
    return forms.ClosedForm(views.v.astype(np.float64))


def _over_8_km() -> SkylineScene:
    field = forms.field_of(forms.rough_field(16).heights_m.astype(np.float64) / 64 + 8800.0, 2.0)
    return SkylineScene(field, forms.eyes_anywhere(field, 4, [0.0, 0.0, 0.1, 2.0]))


LARGE_CASES = (
    forms.SceneCase("eastings of 10,000 km with samples of 0.5 m",
        "32-bit floats are a metre apart there", _far_from_origin, _same_at_origin),
    forms.SceneCase("heights over 8 km above the datum",
        "32-bit heights less a 32-bit eye: half a millimetre lost", _over_8_km),
)  # fmt: skip

WIDE_CASES = (*PLAIN_CASES, *PLANET_CASES, *HOLE_CASES, *TINY_CASES, *LARGE_CASES)

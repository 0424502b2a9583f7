"""Errors of rendered skylines against the oracle's, and their bounds.

A path's error must stay within a bound derived from how it computes, column by column. The horizon
path is bounded by the rounding of 32-bit floats, and the depth path by its quantization.
"""

import dataclasses
import itertools
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skyline.arrays import BoolArray, Float64Array
from skyline.geodesy.earth import Curvature
from skyline.render.depth import QUANTIZATION_PX, DepthRenderer
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import (
    DEFAULT_WIDTH,
    FLAG_HOLE,
    FLAG_NO_DATA,
    FLAG_OUT_OF_IMAGE,
    HEADINGS,
    Views,
    columns_u,
    pixel_size,
    rotation,
)
from skyline.terrain.heightfield import HeightField
from skyline.terrain.triangles import Triangles
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.measuring import Row
from skyline_bench.truth import oracle

EPSILON = 2.0**-24
"""Relative rounding error of a 32-bit float."""

_ASIDE = 16.0 * EPSILON
"""How far aside a ray may be, a unit of depth."""

_NEAR_PX = 0.008
"""The error that heights next to the eye may cause before the horizon path turns to float64."""


@dataclass(frozen=True, slots=True, eq=False)
class SkylineScene:
    """A scene to render: eyes on a surface.

    ``width`` is the number of columns of a view.
    """

    field: HeightField
    viewpoints: Viewpoints
    width: int = DEFAULT_WIDTH
    curvature: Curvature = dataclasses.field(default_factory=Curvature)

    def quick(self) -> "SkylineScene":
        """Return the scene with its first two viewpoints only."""
        return replace(self, viewpoints=self.viewpoints[:2])


@dataclass(frozen=True, slots=True, eq=False)
class SkylineTruth:
    """The true skylines of a scene."""

    views: Views  # float64
    # How far the ordinates of ``views`` may be from the exact surface's: 0 from the oracle, the
    # discretization of the terrain for a closed form.
    slack_px: float = 0.0


def oracle_truth(scene: SkylineScene) -> SkylineTruth:
    """Return the oracle's skylines of a scene."""
    return SkylineTruth(oracle.skyline(scene.field, scene.viewpoints, scene.width, scene.curvature))


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Rendered skylines against the truth, both (N, W)."""

    # Infinite where only one of the two meets data; 0 where the path promises nothing.
    error_px: Float64Array
    bound_px: Float64Array  # The error that the path's arithmetic allows
    flags_agree: BoolArray

    @property
    def holds(self) -> bool:
        """Whether every error is within its bound and every flag agrees."""
        return bool((self.error_px <= self.bound_px).all() and self.flags_agree.all())


@dataclass(frozen=True, slots=True)
class RenderPath:
    """A way to render skylines, and its promise."""

    name: str
    # Makes a renderer of a field, whose ``render`` gives four views a viewpoint.
    factory: Callable[[HeightField, int, Curvature], AbstractContextManager[Any]]
    # Compares rendered views of a scene with the truth.
    agreement: Callable[[SkylineScene, Views, SkylineTruth], Agreement]

    def render(self, scene: SkylineScene) -> Views:
        """Render a scene with a renderer of its own."""
        with self.factory(scene.field, scene.width, scene.curvature) as renderer:
            views: Views = renderer.render(scene.viewpoints)
            return views


def exact_agreement(scene: SkylineScene, views: Views, truth: SkylineTruth) -> Agreement:
    """Compare skylines computed exactly but for 32-bit arithmetic: the horizon path's promise.

    Flags must be the oracle's too, except where those floats cannot decide them
    (`undecided_columns`).
    """
    bound = float32_bound_px(scene, views, truth.views) + truth.slack_px
    error = _error_px(views, truth.views)
    agree = views.flags == truth.views.flags
    # Rays that cannot be decided are few, and finding them costs three times the oracle.
    doubtful = ~((error <= bound) & agree).reshape(len(scene.viewpoints), -1).all(axis=1)
    if doubtful.any():
        rows = np.repeat(doubtful, len(HEADINGS))
        part = replace(scene, viewpoints=scene.viewpoints[doubtful])
        undecided, spread = undecided_columns(part, bound[rows])
        agree[rows] |= undecided
        bound[rows] += spread
    return Agreement(error, bound, agree)


def quantized_agreement(scene: SkylineScene, views: Views, truth: SkylineTruth) -> Agreement:
    """Compare skylines read from depth images: the depth path's promise.

    Nothing is promised outside the image, and behind a hole, where a sliver of the surface
    without a foot may fall between pixel centres. Depth images show no other flags.
    """
    held = (views.flags & FLAG_OUT_OF_IMAGE) == 0
    held &= (truth.views.flags & (FLAG_NO_DATA | FLAG_HOLE)) == 0
    error = np.where(held, _error_px(views, truth.views), 0.0)
    # Vertices snap sideways too, which a steep skyline turns into height.
    bound = 0.5 + (QUANTIZATION_PX - 0.5) * (1.0 + _steepness(truth.views)) + truth.slack_px
    return Agreement(error, bound, np.ones(error.shape, dtype=bool))


def _steepness(views: Views) -> Float64Array:
    """Return the greatest |dv / du| (N, W) from columns to neighbours."""
    steps = np.abs(np.diff(np.nan_to_num(views.v), axis=1)) / pixel_size(views.width)
    steps = np.pad(steps, ((0, 0), (1, 1)))
    return np.asarray(np.maximum(steps[:, 1:], steps[:, :-1]), dtype=np.float64)


def float32_bound_px(scene: SkylineScene, views: Views, truth: Views) -> Float64Array:
    """Return a bound (N, W) on the error of 32-bit arithmetic, px.

    A crossing's ordinate is v = y / z with y = (1 - f) h0 + f h1 - drop, heights from the eye,
    f the fraction along the edge crossed, z the depth. With e = 2^-24, D the greatest height
    difference along an edge and its sag, s the finer spacing, r the ratio of the spacings, and
    roundings counted as `horizon.comp` makes them:

    - the weighted heights: 3 roundings each, and (1 - f) |h0| + f |h1| is at most |y| + drop +
      D / 2; the three sums after: 3 of |y| + drop; the drop itself: 6; 1 - f costs D once more;
    - f is where the ray is, at most r z / s cells aside: 9 e of that (5 in the slope, the depth,
      the product, the sum, the eye's offset), and costs D times as much;
    - the depth of a crossing 7 roundings, the division and the scale 2.

    Altogether |dv| <= e (15 |v| + 2.5 D / z + 18 drop / z + 9 r D / s). Nearer than one cell
    D / z grows; the renderer turns to float64 where it reckons that this costs 0.004 px. It takes
    the greatest height over the eye for D; the difference of two heights is at most twice as large.

    Where the truth and the rendering have different greatest crossings, the error is at most the
    worse of the two crossings' errors. So the lesser depth and the greater v are taken.
    """
    field = scene.field
    pixel = pixel_size(scene.width)
    coarse = max(field.spacing_east_m, field.spacing_north_m)
    depth = views.depth_m.astype(np.float64)
    nearer = np.fmin(depth, truth.depth_m)
    farther = np.fmax(depth, truth.depth_m)
    tan = np.fmax(np.abs(views.v.astype(np.float64)), np.abs(truth.v))
    # An edge's chord hangs below the curved ground by a part of this.
    sag = scene.curvature.drop_per_m2 * (field.spacing_east_m**2 + field.spacing_north_m**2)
    step = greatest_step_m(field) + sag
    # A point's horizontal distance is at most sqrt(2) times its depth.
    drop_tan = 2.0 * scene.curvature.drop_per_m2 * farther
    error = 15.0 * tan + 18.0 * drop_tan + 9.0 * coarse * step / field.spacing_m**2
    relief_px = 2.5 * EPSILON * step / pixel
    near_px = np.minimum(relief_px / nearer, max(relief_px / field.spacing_m, _NEAR_PX))
    bound_px = np.nan_to_num(EPSILON * error / pixel + near_px, posinf=0.0)
    return np.asarray(bound_px, dtype=np.float64)


def greatest_step_m(field: HeightField) -> float:
    """Return the greatest height difference along the surface's edges.

    0 without edges.
    """
    heights = field.heights_m.astype(np.float64)
    diagonals = heights[1:, 1:] - heights[:-1, :-1]
    steps = np.diff(heights, axis=0), np.diff(heights, axis=1), diagonals
    return max(float(np.nanmax(np.abs(step), initial=0.0)) for step in steps)


def undecided_columns(
    scene: SkylineScene, bound_px: Float64Array
) -> tuple[BoolArray, Float64Array]:
    """Find the columns whose flags 32-bit floats cannot decide.

    Where a ray passes a sample is known to `_ASIDE` of its depth. Whether it passes left or right
    of one on the border of the map or of a hole is open within that; and whether the skyline is
    on such a border or inside is open where both have v within the bound (N, W) of each other.

    Return which columns (N, W) these are, and how far apart the skylines to both sides of a column
    may be, (N, W) px: next to nothing but where the ray passes such a sample, or runs almost along
    the edge that it sees as the skyline; infinite where only one side meets data.
    """
    u = columns_u(scene.width)
    pixel = pixel_size(scene.width)
    exact, left, right = (
        oracle.rivals(scene.field, scene.viewpoints, u + aside, scene.curvature)
        for aside in (0.0, -2.0 * _ASIDE, 2.0 * _ASIDE)
    )
    with np.errstate(invalid="ignore"):
        lead_px = np.abs(exact[1] - exact[0]) / pixel
    passes_rim = _columns_past_rims(scene)
    sides = np.stack([np.maximum(*each) for each in (left, right, exact)])
    with np.errstate(invalid="ignore"):
        spread_px = np.where(np.isneginf(sides).all(axis=0), 0.0, np.ptp(sides, axis=0) / pixel)
    # The sides are looked at 32 e apart, for which v may differ by 4 times what 9 e cost.
    spread_px = spread_px + np.where(passes_rim, 4.0 * bound_px, 0.0)
    return passes_rim | (lead_px <= 2.0 * bound_px), np.asarray(spread_px, dtype=np.float64)


def _columns_past_rims(scene: SkylineScene) -> BoolArray:
    """Mark the columns (N, W) whose rays pass the surface's rim.

    The rim is the samples where the surface ends.
    """
    field = scene.field
    eyes = scene.viewpoints
    u = columns_u(scene.width)
    triangles = Triangles.of(field.heights_m)
    ways = itertools.product((False, True), repeat=2)
    row, col = np.nonzero(np.logical_or.reduce([triangles.entries(*way) for way in ways]))
    easting, northing = field.to_map(row, col)
    passes = np.zeros((len(eyes), len(HEADINGS), scene.width), dtype=bool)
    for index in range(len(eyes)):
        east = easting - eyes.easting_m[index]
        north = northing - eyes.northing_m[index]
        for heading in HEADINGS:
            right, _, depth = rotation(heading) @ np.stack([east, np.zeros_like(east), north])
            ahead = depth > 0.0
            at = right[ahead] / depth[ahead]
            slack = _ASIDE * (1.0 + field.spacing_m / depth[ahead])
            nearest = np.clip(np.rint((at + 1.0) / pixel_size(scene.width) - 0.5), 0, len(u) - 1)
            column = nearest.astype(np.int64)
            passes[index, heading, column[np.abs(u[column] - at) <= slack]] = True
    return passes.reshape(-1, scene.width)


def _error_px(views: Views, truth: Views) -> Float64Array:
    seen = ~np.isnan(views.v)
    expected = ~np.isnan(truth.v)
    error = np.abs(views.v - truth.v) / pixel_size(views.width)
    return np.where(seen & expected, error, np.where(seen == expected, 0.0, np.inf))


DEPTH = RenderPath("depth", DepthRenderer, quantized_agreement)
"""The paper's rasterizer."""

HORIZON = RenderPath(
    "horizon",
    lambda field, width, curvature: HorizonRenderer(field, RenderConfig(width, curvature)),
    exact_agreement,
)
"""The horizon rasterizer, exact but for 32-bit floats."""


PIXEL_TAN = pixel_size(DEFAULT_WIDTH)
"""The px of every comparison, 2 / 640 in v, so that errors of different widths compare."""


def compare(views: Views, truth: Views) -> Row:
    """Compare views with the oracle's of the same viewpoints and width.

    Return ``rms_px`` and ``max_px`` over the ``columns`` that neither side flags, None without any.
    ``flagged_share`` of all columns is left out because either side flags them; ``missing`` are
    unflagged columns of the truth where the other has no value, whatever its flags are.
    """
    clear = truth.flags == 0
    missing = clear & np.isnan(views.v)
    flagged = ~clear | (views.flags != 0)
    compared = ~flagged & ~missing
    error_px = (views.v.astype(np.float64) - truth.v)[compared] / PIXEL_TAN
    return {
        "rms_px": float(np.sqrt(np.mean(error_px**2))) if error_px.size else None,
        "max_px": float(np.abs(error_px).max()) if error_px.size else None,
        "columns": error_px.size,
        "flagged_share": float(flagged.mean()) if flagged.size else 0.0,
        "missing": int(missing.sum()),
    }

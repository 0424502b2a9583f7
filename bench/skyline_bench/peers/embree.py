"""A peer to be measured against: skylines from Embree's rays, a bisection in every column.

The scene is the exact surface, so that all renderers share one physics.
Curvature depends on the eye and a ray tracer's scene does not, so the samples are dropped around
the DEM's middle c instead. That drop and the one around an eye e differ at p by a constant and
2 k (p - e).(e - c), k being the drop per square metre: a shear. It keeps straight edges straight
and moves the ordinate of a column with ground direction g (metres over the ground per metre of
depth) by 2 k g.(e - c) at any depth. The rays are tilted by that much; nothing is approximated.

Needs ``embreex``, the optional extra ``peers``. One call to it runs on one thread and lets others
run, so the viewpoints are shared out among as many threads as there are cores.
"""

from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, Int64Array
from skyline.camera import DEFAULT_WIDTH, HEADINGS, check_width, ground_directions
from skyline.geodesy import Curvature
from skyline.skylines import FLAG_NO_DATA, Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.mesh import Triangles
from skyline.terrain.viewpoints import Viewpoints
from skyline_bench.measuring.timing import core_count, over_cores

_STEEPEST_TAN = 1e4
"""A column without a hit below this dip meets no data."""

_COARSEST_STRIDE = 64
_FIRST_STEP = 1.0 / 64.0
"""Of the neighbours' difference; of 1/4 to 1/128 and none, about the fastest for Embree."""

_VIEWPOINTS_A_CALL = 8


def is_installed() -> bool:
    """Whether ``embreex`` is there to be imported."""
    return find_spec("embreex") is not None


class EmbreePeer:
    """Skylines of one height field by Embree's rays, ``width`` columns W a view.

    The curvature is by default the Earth's with k = 0.13.
    """

    def __init__(
        self, field: HeightField, width: int = DEFAULT_WIDTH, curvature: Curvature | None = None
    ) -> None:
        self.field = field
        self.width = check_width(width)
        self.curvature = curvature or Curvature()
        # On a sample, so that the samples' own offsets are short numbers in float32.
        easting, northing = field.to_map(field.rows // 2, field.cols // 2)
        self._middle_m = np.array([float(easting), float(northing)])
        self._datum_m = float(np.mean(field.height_range_m))
        self._scene = _scene(self._vertices(), _triangles(field))
        self._directions = np.stack([ground_directions(turn, width) for turn in HEADINGS])

    def render(self, viewpoints: Viewpoints, depth: int) -> Views:
        """Find the skylines of N viewpoints in all four headings.

        The skyline of a column is the middle of its last bracket, which is as wide as after
        ``depth`` bisections of the field of view.

        Of the 4 N views depth is NaN throughout, and `FLAG_NO_DATA` is the only flag.
        """
        share = max(-(-len(viewpoints) // core_count()), 1)
        # Of the paper's field of view, in which v is from -1 to 1.
        find = partial(self._skylines, bracket=2.0 / 2.0**depth)
        parts = over_cores(find, viewpoints, min(share, _VIEWPOINTS_A_CALL))
        tan = np.concatenate([np.zeros((0, self.width)), *parts])
        return Views(
            np.repeat(viewpoints.easting_m, len(HEADINGS)),
            np.repeat(viewpoints.northing_m, len(HEADINGS)),
            np.repeat(viewpoints.eye_elevation_m, len(HEADINGS)),
            np.tile(np.array(HEADINGS, dtype=np.uint8), len(viewpoints)),
            tan,
            np.full_like(tan, np.nan),
            np.where(np.isnan(tan), FLAG_NO_DATA, 0).astype(np.uint8),
        )

    def _vertices(self) -> Float32Array:
        """Return the samples as (rows * cols, 3) east, up, north of the middle, curved."""
        field = self.field
        easting, northing = field.to_map(*np.indices((field.rows, field.cols)))
        east, north = easting - self._middle_m[0], northing - self._middle_m[1]
        heights = np.nan_to_num(field.heights_m, nan=self._datum_m).astype(np.float64)
        up = heights - self._datum_m - self.curvature.drop_per_m2 * (east**2 + north**2)
        return np.stack([east, up, north], axis=-1).astype(np.float32).reshape(-1, 3)

    def _skylines(self, viewpoints: Viewpoints, bracket: float) -> Float64Array:
        """Return elevation_tan of every column of a few viewpoints' four views, (4 N, W)."""
        offset = np.stack([viewpoints.easting_m, viewpoints.northing_m], axis=1) - self._middle_m
        drop_m = self.curvature.drop_per_m2 * np.square(offset).sum(axis=1)
        up = viewpoints.eye_elevation_m - self._datum_m - drop_m
        eyes = np.stack([offset[:, 0], up, offset[:, 1]], axis=1).astype(np.float32)
        apart = np.einsum("hwk,nk->nhw", self._directions, offset)
        views = len(HEADINGS) * len(viewpoints)
        ground = self._directions.reshape(-1, 2).astype(np.float32)
        rays = _Rays(
            self._scene,
            np.repeat(eyes, len(HEADINGS) * self.width, axis=0),
            np.tile(ground, (len(viewpoints), 1)),
        )
        # The true ordinates less those in the scene.
        shear_tan = 2.0 * self.curvature.drop_per_m2 * apart.reshape(views, self.width)
        columns = np.arange(shear_tan.size).reshape(shear_tan.shape)
        return np.asarray(_from_neighbours(rays, columns, bracket) + shear_tan)


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Everything about M = views * W columns but the ordinate to look along."""

    scene: Any
    eyes: Float32Array  # (M, 3); east, up, north of each column's eye in the scene
    ground: Float32Array  # (M, 2); each column's ground direction

    def blocked(self, columns: Int64Array, tan: Float64Array) -> BoolArray:
        """Return whether the terrain stands in the way of a ray at ordinate ``tan``."""
        directions = np.empty((len(columns), 3), dtype=np.float32)
        directions[:, 0::2] = self.ground[columns]
        directions[:, 1] = tan
        hit = self.scene.run(self.eyes[columns], directions, query="OCCLUDED")
        return np.asarray(hit == 0)


def _from_neighbours(rays: _Rays, columns: Int64Array, bracket: float) -> Float64Array:
    """Return the skyline of (views, W) columns, every stride's from the coarser stride's."""
    tan = np.full(columns.shape, np.nan)
    first = slice(0, None, _COARSEST_STRIDE)
    start = np.zeros(columns[:, first].shape)
    tan[:, first] = _around(rays, columns[:, first], start, start + 0.25, bracket)
    stride = _COARSEST_STRIDE
    while stride > 1:
        half = stride // 2
        between = columns[:, half::stride]
        left = tan[:, 0::stride][:, : between.shape[1]]
        right = tan[:, stride::stride]
        right = np.concatenate([right, left[:, right.shape[1] :]], axis=1)
        guess = np.nan_to_num((left + right) / 2.0)
        step = np.maximum(bracket, _FIRST_STEP * np.nan_to_num(np.abs(left - right)))
        tan[:, half::stride] = _around(rays, between, guess, step, bracket)
        stride = half
    return tan


def _around(
    rays: _Rays, columns: Int64Array, guess: Float64Array, step: Float64Array, bracket: float
) -> Float64Array:
    """Return the skyline of columns, looked for around guesses in growing steps.

    It has the shape of the columns, and is NaN where no ray hits anything.
    """
    shape = columns.shape
    columns, guess, step = columns.ravel(), guess.ravel(), step.ravel()
    rising = rays.blocked(columns, guess)
    stride = np.where(rising, step, -step)
    near, far = guess.copy(), np.full(len(guess), np.nan)
    looking = np.arange(len(columns))
    while looking.size:
        probe = near[looking] + stride[looking]
        passed = rays.blocked(columns[looking], probe) != rising[looking]
        far[looking[passed]] = probe[passed]
        looking, probe = looking[~passed], probe[~passed]
        near[looking] = probe
        stride[looking] *= 2.0
        looking = looking[np.abs(probe) < _STEEPEST_TAN]
    tan = np.full(len(guess), np.nan)
    found = np.flatnonzero(~np.isnan(far))
    low, high = np.minimum(near[found], far[found]), np.maximum(near[found], far[found])
    wide = np.flatnonzero(high - low > bracket)
    while wide.size:
        middle = (low[wide] + high[wide]) / 2.0
        hit = rays.blocked(columns[found[wide]], middle)
        low[wide] = np.where(hit, middle, low[wide])
        high[wide] = np.where(hit, high[wide], middle)
        wide = wide[high[wide] - low[wide] > bracket]
    tan[found] = (low + high) / 2.0
    return tan.reshape(shape)


def _triangles(field: HeightField) -> NDArray[np.int32]:
    """Return the vertices of every triangle of the surface, (T, 3)."""
    triangles = Triangles.of(field.heights_m)
    corner = np.arange(field.rows * field.cols, dtype=np.int32).reshape(field.rows, field.cols)
    north_west, south_east = corner[:-1, :-1], corner[1:, 1:]
    there = triangles.north_east[1:-1, 1:-1], triangles.south_west[1:-1, 1:-1]
    halves = (north_west, corner[:-1, 1:], south_east), (north_west, south_east, corner[1:, :-1])
    return np.concatenate(
        [np.stack([one[k] for one in half], axis=1) for k, half in zip(there, halves, strict=True)]
    )


def _scene(vertices: Float32Array, triangles: NDArray[np.int32]) -> Any:
    """Build Embree's scene.

    Not in its robust mode: that is a quarter slower, and the errors are the same.
    """
    from embreex.mesh_construction import TriangleMesh  # noqa: PLC0415  (an extra)
    from embreex.rtcore_scene import EmbreeScene  # noqa: PLC0415

    scene = EmbreeScene()
    TriangleMesh(scene, vertices, triangles)
    # The first call commits the scene, which must not happen in two threads at once.
    scene.run(np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32), query="OCCLUDED")
    return scene

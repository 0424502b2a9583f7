"""Parts of a height field on the GPU, with trees of slabs.

A part is a `Window`. A field up to a limit is one window. A larger one is cut into windows that
share their border lines of samples, and a skyline over it is the greatest of its skylines over the
windows.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array
from skyline.errors import ContextError
from skyline.render.context import GlContext
from skyline.skylines import HEADINGS
from skyline.terrain.heightfield import HeightField
from skyline.terrain.slab_tree import (
    MAX_LEVELS,
    blocks_before,
    fill_levels,
    fill_mark_levels,
    level_count,
    level_shapes,
)
from skyline.terrain.triangles import Triangles

SLOPE_BINS = 16
"""Bins of rays' slopes, from the steepest left to the steepest right; each has its own bounds."""

EMPTY = np.float32(-3e38)
"""The height of holes, and of everything off the map."""

_COLUMN_APRON = 4
"""Empty columns beside the samples; the shader's COLUMN_APRON."""

_TREES_AT_ONCE = 2
"""Threads that build trees: NumPy lets them run side by side, and each takes its memory."""


@dataclass(frozen=True, slots=True)
class GpuLimits:
    """How much GPU memory a column renderer takes."""

    field_cells: int = 5120
    """Cells along a side of the largest field that is one window: its textures take some 0.9 GB."""
    window_cells: int = 1280
    """Cells along a side of the windows of larger fields. One eye sees few of them."""
    resident_samples: int = 1 << 27
    """Number of samples whose windows stay on the GPU, at some 36 bytes a sample: 4.8 GB hold
    650,000 km2 of a model of 70 m. A build that loads windows anew for each few hundred views
    spends nearly all its time on that."""
    result_bytes: int = 1 << 26
    """Bytes of the results of the views that are rendered together."""


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of samples.

    It has rows ``row`` to ``row + rows - 1``, and columns ``col`` to ``col + cols - 1``.
    """

    row: int
    col: int
    rows: int
    cols: int

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.rows * self.cols

    @classmethod
    def all_of(cls, field: HeightField, limits: GpuLimits) -> list["Window"]:
        """Cut a field into windows of about equal size."""
        is_one = max(field.rows, field.cols) <= limits.field_cells + 1
        max_cells = limits.field_cells if is_one else limits.window_cells
        return [
            cls(row, col, rows, cols)
            for row, rows in _cuts(field.rows, max_cells)
            for col, cols in _cuts(field.cols, max_cells)
        ]


def _cuts(samples: int, max_cells: int) -> Iterator[tuple[int, int]]:
    """Yield start and length of spans that share their end samples."""
    cells = samples - 1
    spans = max(-(-cells // max_cells), 1)
    edges = [cells * index // spans for index in range(spans + 1)]
    for start, stop in itertools.pairwise(edges):
        yield start, stop - start + 1


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """A texture with the trees of all headings."""

    texture: moderngl.Texture
    """A texel holds the eight slabs of a band, for one bin of slopes and block of columns."""
    levels: tuple[tuple[tuple[int, int, int], ...], ...]
    """By heading, and by level up to `MAX_LEVELS`: first row in the texture, rows a bin, blocks
    before column 0."""


class WindowTextures:
    """The textures of one window that `horizon.comp` reads."""

    @classmethod
    def shared(cls, context: GlContext, field: HeightField, window: Window) -> "WindowTextures":
        """Return the textures of a window, which renderers of one field share."""
        # The textures hold their field, so that no other one can have its identity.
        key = id(field), window
        textures: WindowTextures | None = context.shared.get(key)
        if textures is None:
            textures = context.shared[key] = cls(context.ctx, field, window)
        return textures

    def __init__(self, ctx: moderngl.Context, field: HeightField, window: Window) -> None:
        self._ctx = ctx
        self._field = field
        self.window = window
        ratio = field.spacing_north_m / field.spacing_east_m
        self.slope_max = (ratio, 1.0 / ratio)
        """Greatest slope of a ray, cells across per strip, for headings 0, 2 and 1, 3."""
        self._levels = level_count(max(window.rows, window.cols) - 1)
        self.top_level = self._levels - 1
        """Coarsest level of the trees."""
        heights = _with_apron(field, window)
        holes = np.isnan(heights)
        self.rims: Trees | None = None
        """One bit per slab: whether the surface may begin again there, after a hole. None where
        there are no holes."""
        self.dangling = False
        """Whether there are edges without triangles."""
        if holes[1:-1, 1:-1].any() or min(window.rows, window.cols) < 2:
            triangles = Triangles.of(heights)
            holes |= ~triangles.samples
            self.dangling = triangles.has_dangling_edges
            self.rims = self._trees_of_rims(triangles)
        heights[holes] = EMPTY
        inner = heights[1:-1, 1:-1]
        present = ~holes
        where = present[1:-1, 1:-1]
        self.lowest_m = float(inner.min(where=where, initial=np.float32(np.inf)))
        """Lowest sample; 0 where there are none."""
        self.highest_m = float(inner.max(where=where, initial=np.float32(-np.inf)))
        """Highest sample; 0 where there are none."""
        if self.lowest_m > self.highest_m:
            self.lowest_m = self.highest_m = 0.0
        # Two less than the greatest code of 16 bits, since codes are rounded up.
        self.code_step_m = max(self.highest_m - self.lowest_m, 1.0) / 65533
        self.columns = tuple(_columns(ctx, seen) for seen in (inner, inner.T))
        """float32 metres for headings 0, 2 and 1, 3, `EMPTY` for holes and off the window: a texel
        is three neighbours along the axis."""
        self.present = _upload(ctx, present.view("u1")[..., np.newaxis], "u1")
        """1 where there is a sample, else 0; with the samples next to the window."""
        self.slabs = self._trees_of_heights(inner)
        """Upper bounds of the heights: code c stands for ``lowest_m + c * code_step_m``."""

    def _trees_of_heights(self, heights_m: Float32Array) -> Trees:
        """Build the trees of slabs over heights (rows, cols).

        Headings of one axis share a tree.
        """
        codes = self._coded(heights_m)
        axes = codes, codes.T
        slopes = [np.linspace(-most, most, SLOPE_BINS + 1) for most in self.slope_max]
        atlas = _Atlas([self._shapes(*one) for one in zip(axes, slopes, strict=True)], 4, "<u4")

        def build(tree: int) -> None:
            levels = [level.view("<u2") for level in atlas.levels(tree)]
            fill_levels(np.ascontiguousarray(axes[tree]), slopes[tree], levels)

        with ThreadPoolExecutor(_TREES_AT_ONCE) as pool:
            list(pool.map(build, range(len(axes))))
        return atlas.upload(self._ctx, [blocks_before(one) for one in slopes])

    def _shapes(self, seen: NDArray[Any], slopes: Float64Array) -> list[tuple[int, int, int]]:
        lines, columns = seen.shape
        return level_shapes(lines, columns, slopes, self._levels)

    def _coded(self, heights_m: Float32Array) -> NDArray[np.uint16]:
        """Return the codes (rows, cols) of heights, rounded up."""
        codes = np.maximum(heights_m, np.float32(self.lowest_m))
        codes -= np.float32(self.lowest_m)
        codes /= np.float32(self.code_step_m)
        # A fiftieth of a step is more than float32 rounds off.
        codes += np.float32(0.02)
        whole: NDArray[np.uint16] = np.ceil(codes, out=codes).astype("<u2")
        return whole

    def _trees_of_rims(self, triangles: Triangles) -> Trees:
        """Mark where rays may meet the surface again.

        The triangles have an apron of one cell around the window.
        """
        quadrants = [(north, east) for north in (False, True) for east in (False, True)]
        with ThreadPoolExecutor(_TREES_AT_ONCE) as pool:
            found = pool.map(lambda quadrant: triangles.entries(*quadrant), quadrants)
            marks = {
                quadrant: one[1:-1, 1:-1] for quadrant, one in zip(quadrants, found, strict=True)
            }
            return self._trees_of_marks(marks, pool)

    def _trees_of_marks(
        self, marks: Mapping[tuple[bool, bool], BoolArray], pool: Executor
    ) -> Trees:
        """Build the trees of marks.

        The marks are given by the quadrant into which rays go: north or not, east or not.
        """
        axes = marks[False, False], marks[False, False].T
        slopes = [np.linspace(-most, most, SLOPE_BINS + 1) for most in self.slope_max]
        shapes = [self._shapes(*one) for one in zip(axes, slopes, strict=True)]
        atlas = _Atlas([shapes[heading % 2] for heading in HEADINGS], 1, "u1")

        def build(heading: int) -> None:
            axis = heading % 2
            whole = [level[..., 0] for level in atlas.levels(heading)]
            middle = SLOPE_BINS // 2
            for grows, bins in ((False, slice(middle)), (True, slice(middle, None))):
                seen = marks[_quadrant(heading, grows)]
                some = slopes[axis][bins.start : (bins.stop or SLOPE_BINS) + 1]
                levels = [level[bins] for level in whole]
                fill_mark_levels(seen.T if axis else seen, some, levels)

        list(pool.map(build, HEADINGS))
        return atlas.upload(self._ctx, [blocks_before(slopes[one % 2]) for one in HEADINGS])


class _Atlas:
    """One array of texels for the levels of two or four trees.

    Of two trees, each serves both headings of an axis. Four stand in two stacks side by side,
    because one stack of four would be higher than a texture may be. A ray that leaves its own tree
    may meet the next one: superfluous marks and bounds cost time, but change no skyline.
    """

    def __init__(
        self, shapes: Sequence[Sequence[tuple[int, int, int]]], components: int, dtype: str
    ) -> None:
        """Make room for trees, whose levels have the shapes (bins, bands, blocks)."""
        width = max(blocks for tree in shapes for _, _, blocks in tree)
        # By tree, the first row, the first column and the shape of each level.
        self._levels: list[list[tuple[int, int, tuple[int, int, int]]]] = []
        height = top = 0
        for number, tree in enumerate(shapes):
            stack, nth = divmod(number, 2)
            top = top if nth else 0
            levels = []
            for shape in tree:
                levels.append((top, stack * width, shape))
                top += shape[0] * shape[1]
            self._levels.append(levels)
            height = max(height, top)
        columns = _pitch(width * -(-len(shapes) // 2))
        self._texels: NDArray[Any] = np.zeros((height, columns, components), dtype)

    def levels(self, tree: int) -> list[NDArray[Any]]:
        """Return the texels of each level of a tree.

        They are (bins, bands, blocks, components), and are to be written.
        """
        found = []
        for top, left, (bins, bands, blocks) in self._levels[tree]:
            texels = self._texels[top : top + bins * bands, left : left + blocks]
            found.append(texels.reshape(bins, bands, blocks, -1))
        return found

    def upload(self, ctx: moderngl.Context, before: Sequence[int]) -> Trees:
        """Return the texture and its levels.

        ``before`` has the `blocks_before` of each tree.
        """
        by_tree = []
        for levels, blocks in zip(self._levels, before, strict=True):
            here = [(top, shape[1], left + blocks) for top, left, shape in levels]
            by_tree.append((*here, *[(0, 0, 0)] * (MAX_LEVELS - len(here))))
        texture = _upload(ctx, self._texels, self._texels.dtype.str[1:])
        return Trees(texture, tuple(by_tree[heading % len(by_tree)] for heading in HEADINGS))


def _quadrant(heading: int, grows: bool) -> tuple[bool, bool]:
    """Return whether rays along a heading go north, and whether east.

    The rays' slope in array order is positive if it ``grows``, else negative. It is in columns per
    row for headings 0 and 2, and in rows per column for 1 and 3.
    """
    forward = heading in (1, 2)
    aside = grows == forward
    return (not aside, forward) if heading % 2 else (not forward, aside)


def _with_apron(field: HeightField, window: Window) -> Float32Array:
    """Return a window's heights with a border one sample wide.

    Samples off the map are NaN.
    """
    heights = np.full((window.rows + 2, window.cols + 2), np.nan, dtype=np.float32)
    top = window.row - 1
    left = window.col - 1
    row = max(top, 0)
    col = max(left, 0)
    part = field.part(slice(row, top + window.rows + 2), slice(col, left + window.cols + 2))
    heights[row - top :, col - left :][: part.shape[0], : part.shape[1]] = part
    return heights


def _columns(ctx: moderngl.Context, heights: Float32Array) -> moderngl.Texture:
    """Upload heights seen along their first axis.

    Texel m of a column has lines 2 m to 2 m + 2.
    """
    lines, columns = heights.shape
    leaves = max(-(-(lines - 1) // 2), 1)
    inner = slice(_COLUMN_APRON, _COLUMN_APRON + columns)
    texels = np.full((leaves, _pitch(columns + 2 * _COLUMN_APRON), 3), EMPTY, dtype=np.float32)
    for line in range(3):
        seen = heights[line : line + 2 * leaves : 2]
        texels[: len(seen), inner, line] = seen
    return _upload(ctx, texels, "f4")


def _pitch(columns: int) -> int:
    """Return the width of a texture for some columns.

    It is an odd multiple of 16 texels: at a power of two, neighbouring rows would share cache
    lines.
    """
    return (-(-columns // 16) | 1) * 16


def _upload(ctx: moderngl.Context, values: NDArray[Any], dtype: str) -> moderngl.Texture:
    """Upload texels (rows, columns, components).

    Columns are padded to a `_pitch`. Raises `ContextError` if OpenGL refuses the texture, which
    would then read as zeros.
    """
    lines, columns, components = values.shape
    if missing := _pitch(columns) - columns:
        values = np.pad(values, ((0, 0), (0, missing), (0, 0)))
        columns += missing
    texture = ctx.texture((columns, lines), components, values, dtype=dtype)
    if (error := ctx.error) != "GL_NO_ERROR":
        raise ContextError(
            f"OpenGL refuses a texture of {columns} x {lines} texels ({error}); free memory "
            "of the GPU, or give fewer tiles or a coarser DEM"
        )
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture

"""Windows: the parts of a height field that lie on the GPU, each with its tree of slabs.

A field up to the largest window is one window. A larger one is cut into windows that share their
border lines of samples, and a skyline over it is the greatest of its skylines over the windows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import moderngl
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from skyline.terrain.heightfield import HeightField
from skyline.terrain.pyramid import EMPTY, MAX_LEVELS, SlabLevel, level_count, slab_levels
from skyline.terrain.triangles import Triangles

Float32Array = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

MAX_FIELD_CELLS = 4096
"""Cells along a side of the largest field that is one window: its textures take some 450 MB."""

MAX_WINDOW_CELLS = 2048
"""Cells along a side of the windows of larger fields."""

SLOPE_BINS = 16

_CODES = 65535
_TEXELS_A_LINE = 16


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle of samples: rows ``row`` to ``row + rows - 1``, and columns likewise."""

    row: int
    col: int
    rows: int
    cols: int

    @classmethod
    def all_of(cls, field: HeightField) -> list["Window"]:
        """Cut a field into windows of about equal size."""
        whole = max(field.rows, field.cols) <= MAX_FIELD_CELLS + 1
        max_cells = MAX_FIELD_CELLS if whole else MAX_WINDOW_CELLS
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
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        yield start, stop - start + 1


@dataclass(frozen=True, slots=True)
class Axis:
    """The tree of one axis, strips being rows of cells (headings 0, 2) or columns (1, 3).

    Attributes
    ----------
    levels : tuple of (int, int, int)
        For `MAX_LEVELS` levels: first row in the texture, rows a bin, blocks before column 0.
    slope_max : float
        Greatest slope of a ray, cells across per strip.
    """

    levels: tuple[tuple[int, int, int], ...]
    slope_max: float


class WindowTextures:
    """What the shaders read of one window (`horizon_walk.glsl`).

    Attributes
    ----------
    heights : moderngl.Texture
        float32 metres with an apron of one sample, `EMPTY` for holes and off the map.
    slabs : moderngl.Texture
        The trees of both axes, 16-bit codes; code c stands for ``code_m[0] + c * code_m[1]``.
    rims : moderngl.Texture or None
        The same layout, a bit a slab: whether the surface may begin again there, after a hole.
    axes : tuple of Axis
        Rows as strips, columns as strips.
    top_level : int
        Coarsest level of the trees.
    dangling : bool
        Whether there are edges without triangles.
    """

    def __init__(self, ctx: moderngl.Context, field: HeightField, window: Window) -> None:
        self.window = window
        heights, near_hole, self.dangling = _samples(field, window)
        inner = heights[1:-1, 1:-1]
        present = inner > EMPTY
        self.lowest_m = float(inner.min(where=present, initial=np.float32(np.inf)))
        self.highest_m = float(inner.max(where=present, initial=np.float32(-np.inf)))
        step_m = max(self.highest_m - self.lowest_m, 1.0) / (_CODES - 2)
        self.code_m = (self.lowest_m, step_m)
        self.top_level = level_count(max(window.rows, window.cols) - 1) - 1
        ratio = field.spacing_north_m / field.spacing_east_m
        slopes = (ratio, 1.0 / ratio)
        pack = partial(_packed_codes, lowest_m=self.lowest_m, step_m=step_m)
        atlas, levels = _atlas(_trees(inner, slopes, self.top_level + 1), pack)
        self.axes = tuple(Axis(*axis) for axis in zip(levels, slopes, strict=True))
        self.heights = _texture(ctx, heights[..., np.newaxis], "f4")
        self.slabs = _texture(ctx, atlas, "u4")
        self.rims: moderngl.Texture | None = None
        if near_hole is not None:
            marks = np.where(near_hole, np.float32(1.0), EMPTY)
            atlas, _ = _atlas(_trees(marks, slopes, self.top_level + 1), _packed_bits)
            self.rims = _texture(ctx, atlas, "u1")

    def release(self) -> None:
        """Free the textures."""
        for texture in (self.heights, self.slabs, self.rims):
            if texture is not None:
                texture.release()


def _samples(field: HeightField, window: Window) -> tuple[Float32Array, BoolArray | None, bool]:
    """Return a window's heights with their apron, which samples lie by a hole, and danglers.

    Samples that are a corner of no triangle are no part of the surface, and are left out.
    """
    heights = np.full((window.rows + 2, window.cols + 2), np.nan, dtype=np.float32)
    top, left = window.row - 1, window.col - 1
    first_row, first_col = max(top, 0), max(left, 0)
    part = field.heights_m[first_row : top + window.rows + 2, first_col : left + window.cols + 2]
    rows = slice(first_row - top, first_row - top + part.shape[0])
    cols = slice(first_col - left, first_col - left + part.shape[1])
    heights[rows, cols] = part
    holes = np.isnan(heights)
    on_map = np.zeros(heights.shape, dtype=bool)
    on_map[rows, cols] = True
    near_hole, dangling = None, False
    if (holes & on_map).any():
        triangles = Triangles.of(heights)
        holes |= ~triangles.samples
        dangling = triangles.has_dangling_edges
        beside = maximum_filter(holes & on_map, size=3) & ~holes
        near_hole = beside[1:-1, 1:-1]
    heights[holes] = EMPTY
    return heights, near_hole, dangling


def _trees(
    heights: Float32Array, slopes: tuple[float, float], levels: int
) -> Iterator[tuple[int, SlabLevel]]:
    """Yield the levels of the trees of both axes, with the number of their axis."""
    for axis, seen in enumerate((heights, np.ascontiguousarray(heights.T))):
        for level in slab_levels(seen, slopes[axis], SLOPE_BINS, levels):
            yield axis, level


def _atlas(
    trees: Iterator[tuple[int, SlabLevel]],
    pack: Callable[[Float32Array], NDArray[np.unsignedinteger]],
) -> tuple[NDArray[np.unsignedinteger], list[tuple[tuple[int, int, int], ...]]]:
    """Stack packed levels into one (rows, columns, components) array; return it and where they are."""
    blocks: list[NDArray[np.unsignedinteger]] = []
    places: list[list[tuple[int, int, int]]] = [[], []]
    row = 0
    for axis, level in trees:
        packed = pack(level.maxima)
        places[axis].append((row, packed.shape[1], level.first_block))
        block = packed.reshape(-1, *packed.shape[2:])
        blocks.append(block)
        row += len(block)
    atlas = np.zeros(
        (row, max(block.shape[1] for block in blocks), blocks[0].shape[2]), blocks[0].dtype
    )
    row = 0
    for block in blocks:
        atlas[row : row + len(block), : block.shape[1]] = block
        row += len(block)
    none = (0, 0, 0)
    return atlas, [tuple(p + [none] * (MAX_LEVELS - len(p))) for p in places]


def _packed_codes(maxima: Float32Array, lowest_m: float, step_m: float) -> NDArray[np.uint32]:
    """Return four words of two codes a band, rounded up."""
    # A fiftieth of a step is more than float32 rounds off.
    above_m = np.maximum(maxima, np.float32(lowest_m)) - np.float32(lowest_m)
    codes = np.ceil(above_m / np.float32(step_m) + np.float32(0.02))
    codes = codes.clip(0, _CODES).astype(np.uint32)
    return codes[..., 0::2] | codes[..., 1::2] << 16


def _packed_bits(maxima: Float32Array) -> NDArray[np.uint8]:
    """Return a byte of SLABS bits a band."""
    return np.packbits(maxima > EMPTY, axis=-1, bitorder="little")


def _texture(ctx: moderngl.Context, values: NDArray[np.generic], dtype: str) -> moderngl.Texture:
    """Upload (rows, columns, components), columns padded to a pitch that is no power of two."""
    columns = -(-values.shape[1] // _TEXELS_A_LINE) | 1
    padded = np.zeros((values.shape[0], columns * _TEXELS_A_LINE, values.shape[2]), values.dtype)
    padded[:, : values.shape[1]] = values
    texture = ctx.texture((padded.shape[1], len(padded)), values.shape[2], padded, dtype=dtype)
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture

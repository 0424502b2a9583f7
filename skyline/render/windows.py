"""Windows: the parts of a height field that lie on the GPU, each with its trees of slabs.

A field up to a limit is one window. A larger one is cut into windows that share their border
lines of samples, and a skyline over it is the greatest of its skylines over the windows.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.render.trees import HeightCode, Trees, upload
from skyline.terrain.heightfield import HeightField
from skyline.terrain.pyramid import EMPTY, level_count
from skyline.terrain.triangles import Triangles

MAX_FIELD_CELLS = 5120
"""Cells along a side of the largest field that is one window: its textures take some 1.1 GB."""

MAX_WINDOW_CELLS = 2048
"""Cells along a side of the windows of larger fields."""


_COLUMN_APRON = 4
"""As COLUMN_APRON of the shaders."""


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
    for start, stop in itertools.pairwise(edges):
        yield start, stop - start + 1


class WindowTextures:
    """What the shaders read of one window (`horizon_march.glsl`).

    Attributes
    ----------
    heights : moderngl.Texture
        float32 metres with an apron of one sample, `EMPTY` for holes and off the map.
    columns : 2 moderngl.Texture
        The samples again, for headings 0, 2 and 1, 3: a texel is three neighbours along the axis.
    slabs : Trees
        Upper bounds of the heights, in this code.
    rims : Trees or None
        A bit a slab: whether the surface may begin again there, after a hole.
    slope_max : (float, float)
        Greatest slope of a ray, cells across per strip, for headings 0, 2 and for 1, 3.
    top_level : int
        Coarsest level of the trees.
    dangling : bool
        Whether there are edges without triangles.
    """

    def __init__(self, ctx: moderngl.Context, field: HeightField, window: Window) -> None:
        self.window = window
        ratio = field.spacing_north_m / field.spacing_east_m
        self.slope_max = (ratio, 1.0 / ratio)
        levels = level_count(max(window.rows, window.cols) - 1)
        self.top_level = levels - 1
        heights = _with_apron(field, window)
        holes = np.isnan(heights)
        self.rims, self.dangling = None, False
        if holes[1:-1, 1:-1].any() or min(window.rows, window.cols) < 2:
            triangles = Triangles.of(heights)
            holes |= ~triangles.samples
            self.dangling = triangles.has_dangling_edges
            self.rims = Trees.of_rims(ctx, triangles, self.slope_max, levels)
        heights[holes] = EMPTY
        inner, present = heights[1:-1, 1:-1], ~holes[1:-1, 1:-1]
        self.lowest_m = float(inner.min(where=present, initial=np.float32(np.inf)))
        self.highest_m = float(inner.max(where=present, initial=np.float32(-np.inf)))
        if self.lowest_m > self.highest_m:
            self.lowest_m = self.highest_m = 0.0
        self.code = HeightCode.over(self.lowest_m, self.highest_m)
        self.heights = upload(ctx, heights[..., np.newaxis], "f4")
        self.columns = tuple(_columns(ctx, seen) for seen in (inner, inner.T))
        self.slabs = Trees.of_heights(ctx, inner, self.code, self.slope_max, levels)

    def release(self) -> None:
        """Free the textures."""
        self.heights.release()
        for texture in self.columns:
            texture.release()
        self.slabs.texture.release()
        if self.rims is not None:
            self.rims.texture.release()


def _with_apron(field: HeightField, window: Window) -> NDArray[np.float32]:
    """Return a window's heights and one sample around them, NaN off the map."""
    heights = np.full((window.rows + 2, window.cols + 2), np.nan, dtype=np.float32)
    top, left = window.row - 1, window.col - 1
    row, col = max(top, 0), max(left, 0)
    part = field.heights_m[row : top + window.rows + 2, col : left + window.cols + 2]
    heights[row - top :, col - left :][: part.shape[0], : part.shape[1]] = part
    return heights


def _columns(ctx: moderngl.Context, heights: NDArray[np.float32]) -> moderngl.Texture:
    """Upload heights seen along their first axis: texel m of a column has lines 2 m to 2 m + 2."""
    lines, columns = heights.shape
    leaves = max(-(-(lines - 1) // 2), 1)
    padded = np.full((2 * leaves + 2, columns + 2 * _COLUMN_APRON), EMPTY, dtype=np.float32)
    padded[:lines, _COLUMN_APRON:-_COLUMN_APRON] = heights
    texels = np.stack([padded[line : line + 2 * leaves : 2] for line in (0, 1, 2, 2)], axis=-1)
    return upload(ctx, texels, "f4")

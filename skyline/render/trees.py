"""Trees of slabs as textures, one for each heading."""

import itertools
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array
from skyline.camera import HEADINGS
from skyline.errors import ContextError
from skyline.terrain.pyramid import MAX_LEVELS, SlabLevel, slab_levels
from skyline.terrain.triangles import Triangles

Packed = NDArray[np.uint32] | NDArray[np.uint8]

SLOPE_BINS = 16

_MAX_CODE = 65535
_TEXELS_A_LINE = 16
_TREES_A_STACK = 2
_TREES_AT_ONCE = 2
"""Built in threads: NumPy lets them run side by side, and each takes its memory."""


@dataclass(frozen=True, slots=True)
class HeightCode:
    """16-bit heights: code c stands for ``lowest_m + c * step_m``."""

    lowest_m: float
    step_m: float

    @classmethod
    def over(cls, lowest_m: float, highest_m: float) -> "HeightCode":
        """Return the finest code for a range of heights."""
        return cls(lowest_m, max(highest_m - lowest_m, 1.0) / (_MAX_CODE - 2))

    def packed(self, maxima: Float32Array) -> NDArray[np.uint32]:
        """Return (..., 4) words of two codes, rounded up, of (..., 8) heights."""
        codes = np.maximum(maxima, np.float32(self.lowest_m))
        codes -= np.float32(self.lowest_m)
        codes /= np.float32(self.step_m)
        # A fiftieth of a step is more than float32 rounds off.
        codes += np.float32(0.02)
        words: NDArray[np.uint32] = np.ceil(codes, out=codes).astype("<u2").view("<u4")
        return words


@dataclass(frozen=True, slots=True, eq=False)
class Trees:
    """A texture with the trees of all headings."""

    texture: moderngl.Texture
    """A texel holds the eight slabs of a band, for one bin of slopes and block of columns."""
    levels: tuple[tuple[tuple[int, int, int], ...], ...]
    """4 tuples of `MAX_LEVELS` (int, int, int). By heading and level: first row in the texture,
    rows a bin, blocks before column 0."""

    @classmethod
    def of_heights(
        cls,
        ctx: moderngl.Context,
        heights_m: Float32Array,
        code: HeightCode,
        slope_max: tuple[float, float],
        levels: int,
    ) -> "Trees":
        """Build the bounds of heights (rows, cols); headings of one axis share a tree."""

        def built(seen: Float32Array, steepest: float) -> list[_Packed]:
            slopes = np.linspace(-steepest, steepest, SLOPE_BINS + 1)
            tree = slab_levels(np.ascontiguousarray(seen), slopes, levels)
            return [_Packed(code.packed(level.maxima), level.first_block) for level in tree]

        with ThreadPoolExecutor(_TREES_AT_ONCE) as pool:
            axes = list(pool.map(built, (heights_m, heights_m.T), slope_max))
        return cls._stack(ctx, axes, "u4")

    @classmethod
    def of_rims(
        cls,
        ctx: moderngl.Context,
        triangles: Triangles,
        slope_max: tuple[float, float],
        levels: int,
    ) -> "Trees":
        """Mark where rays may come upon the surface again, for triangles with an apron of one."""

        def built(heading: int) -> list[_Packed]:
            steepest = slope_max[heading % 2]
            halves = []
            for grows, bounds in ((False, (-steepest, 0.0)), (True, (0.0, steepest))):
                marks = triangles.entries(*_quadrant(heading, grows))[1:-1, 1:-1].view(np.uint8)
                seen = np.ascontiguousarray(marks.T if heading % 2 else marks)
                halves.append(slab_levels(seen, np.linspace(*bounds, SLOPE_BINS // 2 + 1), levels))
            return [_packed_marks(lower, upper) for lower, upper in zip(*halves, strict=True)]

        with ThreadPoolExecutor(_TREES_AT_ONCE) as pool:
            return cls._stack(ctx, list(pool.map(built, HEADINGS)), "u1")

    @classmethod
    def _stack(
        cls, ctx: moderngl.Context, trees: Sequence[Sequence["_Packed"]], dtype: str
    ) -> "Trees":
        """Put trees into one texture; two trees serve the headings of each axis.

        Two stand one under the other and the next two beside them: four would be higher than a
        texture may be. A ray that leaves its own tree may meet the next; a mark or a bound too
        many costs time and changes nothing.
        """
        levels = [level.texels for tree in trees for level in tree]
        width = max(texels.shape[2] for texels in levels)
        stacks = [
            trees[first : first + _TREES_A_STACK] for first in range(0, len(trees), _TREES_A_STACK)
        ]
        height = max(
            sum(len(p.texels) * p.texels.shape[1] for tree in stack for p in tree)
            for stack in stacks
        )
        atlas = np.zeros((height, width * len(stacks), levels[0].shape[3]), levels[0].dtype)
        places = []
        for left, stack in zip(itertools.count(0, width), stacks):
            top = 0
            for tree in stack:
                here = []
                for p in tree:
                    rows = p.texels.reshape(-1, *p.texels.shape[2:])
                    atlas[top : top + len(rows), left : left + rows.shape[1]] = rows
                    here.append((top, p.texels.shape[1], left + p.first_block))
                    top += len(rows)
                places.append((*here, *[(0, 0, 0)] * (MAX_LEVELS - len(here))))
        return cls(upload(ctx, atlas, dtype), tuple(places[h % len(places)] for h in HEADINGS))


@dataclass(frozen=True, slots=True, eq=False)
class _Packed:
    """A level as texels, (bins, bands, blocks, components)."""

    texels: Packed
    first_block: int


def _packed_marks(lower: SlabLevel, upper: SlabLevel) -> _Packed:
    marks = np.concatenate([lower.maxima, upper.maxima])
    return _Packed(np.packbits(marks, axis=-1, bitorder="little"), lower.first_block)


def _quadrant(heading: int, grows: bool) -> tuple[bool, bool]:
    """Return whether rays go north and east, whose slope in array order is positive or negative.

    The slope is columns a row for headings 0 and 2, rows a column for 1 and 3.
    """
    forward = heading in (1, 2)
    aside = grows == forward
    return (not aside, forward) if heading % 2 else (not forward, aside)


def upload(ctx: moderngl.Context, values: NDArray[np.generic], dtype: str) -> moderngl.Texture:
    """Upload (rows, columns, components), columns padded to a pitch that is no power of two.

    Raises `ContextError` where OpenGL refuses the texture, which would read as zeros.
    """
    columns = (-(-values.shape[1] // _TEXELS_A_LINE) | 1) * _TEXELS_A_LINE
    padded = np.zeros((values.shape[0], columns, values.shape[2]), values.dtype)
    padded[:, : values.shape[1]] = values
    texture = ctx.texture((columns, len(padded)), values.shape[2], padded, dtype=dtype)
    if (error := ctx.error) != "GL_NO_ERROR":
        raise ContextError(
            f"OpenGL refuses a texture of {columns} x {len(padded)} texels ({error}); free memory "
            "of the GPU, or give fewer tiles or a coarser DEM"
        )
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    texture.repeat_x = texture.repeat_y = False
    return texture


def split_float(values: NDArray[np.float64]) -> tuple[Float32Array, Float32Array]:
    """Return the nearest float32 and what it leaves."""
    high = values.astype(np.float32)
    return high, (values - high).astype(np.float32)

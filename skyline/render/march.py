"""Runs the horizon march on the GPU: as compute shaders, or as fragment shaders below OpenGL 4.3.

Both read the same windows and eyes and give the same skylines: `horizon_march.glsl` is the march.
"""

import math
from abc import ABC, abstractmethod
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.render.context import GlContext
from skyline.render.shaders import compile_compute, compile_program
from skyline.render.windows import SLOPE_BINS, WindowTextures

EYE_DTYPE = np.dtype(
    [
        ("nearest", "<i4", 2),
        ("offset", "<f4", 2),
        ("offset_low", "<f4", 2),
        ("elevation_m", "<f4", 2),
        ("turn_tan", "<f4", 2),
    ]
)
"""As struct Eye of the shaders; ``nearest`` is relative to the window.

``turn_tan`` is the tangent of an angle by which all of an eye's columns are turned clockwise; none
may leave the view of 90 degrees.
"""

NOTHING = np.float32(-1e30)
"""v of a column that has met no data yet."""

_DOUBLE_VERSION = 400
_MAX_GROUPS = 65_535
_MAX_RESULT_BYTES = 1 << 26
_MANY_EYES = 16

_Program = Any
"""`moderngl.Program` or `moderngl.ComputeShader`."""


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Results, (rows, W): elevation_tan (`NOTHING` without data), depth_m float32, flags uint8."""

    elevation_tan: Float32Array
    depth_m: Float32Array
    flags: NDArray[np.uint8]


class RayMarcher(ABC):
    """Holds rows of results and raises them by marches on the GPU.

    Parameters
    ----------
    u : (W,) float64
        Abscissas of the columns, of magnitude at most 1.
    tolerance : (W,) float64
        How far v may fall short of the skyline's in each column; 0 is exact but for float32.
    spacing_m : (float, float)
        East, north.
    """

    def __init__(
        self,
        context: GlContext,
        u: Float64Array,
        tolerance: Float64Array,
        spacing_m: tuple[float, float],
        drop_per_m2: float,
    ) -> None:
        self._context, self._ctx, self._width = context, context.ctx, len(u)
        self._spacing_m, self._drop_per_m2 = spacing_m, drop_per_m2
        self._is_exact, self._widest_u = not tolerance.any(), float(np.abs(u).max())
        self._programs: dict[frozenset[tuple[str, str]], _Program] = {}
        aims = np.stack([*split_float(u), tolerance.astype(np.float32)], axis=-1)
        self._aims = self._ctx.texture((len(u), 1), 3, aims, dtype="f4", alignment=1)
        self._aims.filter = (moderngl.NEAREST, moderngl.NEAREST)

    @property
    def max_rows(self) -> int:
        """Rows of results that there may be at a time."""
        return _MAX_RESULT_BYTES // (12 * self._width)

    @abstractmethod
    def begin(self, rows: int) -> None:
        """Make room for results; the first march of each row writes it all."""

    def run(
        self,
        heading: int,
        double: bool,
        first: bool,
        window: WindowTextures,
        eyes: NDArray[np.void],
        first_row: int,
    ) -> None:
        """March over a window from every eye.

        Parameters
        ----------
        double : bool
            Compute crossings in float64, where the OpenGL has it.
        first : bool
            Whether nothing was marched for these results before.
        eyes : (N,) of `EYE_DTYPE`
            Those that face ``heading``.
        first_row : int
            Of the results, the first eye's.
        """
        slope_max = window.slope_max[heading % 2]
        columns = window.columns[heading % 2]
        turned = bool(eyes["turn_tan"].any())
        # Rays fall short of slope_max by a column's half: at equal spacings two cells do.
        cells = math.ceil(slope_max * (1.0 if turned else self._widest_u)) + 1
        double = double and self._context.version_code >= _DOUBLE_VERSION
        switches = {"HOLES": bool(window.rims), "DANGLING": window.dangling, "RAISE": not first}
        defines = {
            "HEADING": str(heading),
            "CELLS": str(cells),
            "REAL": "double" if double else "float",
            **{name: "" for name, on in switches.items() if on},
        }
        key = frozenset(defines.items())
        if key not in self._programs:
            self._programs[key] = self._compile(defines)
        program = self._programs[key]
        values = {
            "heights_m": 0,
            "slabs": 1,
            "samples": (window.window.cols, window.window.rows),
            "spacing_m": self._spacing_m,
            "columns_m": 7,
            "columns_end": (columns.width - 1, columns.height - 1),
            "drop_per_m2": self._drop_per_m2,
            "slack_m": self._slack_m(window, eyes),
            "code_m": (window.lowest_m, window.code_step_m),
            "levels": list(window.slabs.levels[heading]),
            "top_level": window.top_level,
            "bins": SLOPE_BINS,
            "slope_max": slope_max,
            "width": self._width,
            "aims": 8,
        }
        window.heights.use(0)
        window.slabs.texture.use(1)
        columns.use(7)
        self._aims.use(8)
        if window.rims:
            window.rims.texture.use(6)
            values |= {"rims": 6, "rim_levels": list(window.rims.levels[heading])}
        set_uniforms(program, values)
        self._march(program, eyes, first_row)

    @abstractmethod
    def read(self) -> Results:
        """Return the results."""

    def release(self) -> None:
        """Free what is held on the GPU."""
        self._aims.release()
        for program in self._programs.values():
            program.release()
        self._programs = {}

    @abstractmethod
    def _compile(self, defines: dict[str, str]) -> _Program: ...

    @abstractmethod
    def _march(self, program: _Program, eyes: NDArray[np.void], first_row: int) -> None: ...

    def _slack_m(self, window: WindowTextures, eyes: NDArray[np.void]) -> float:
        """Return more than all float32 rounding in the y of a crossing."""
        eye_m = eyes["elevation_m"][:, 0]
        high = max(window.highest_m, float(eye_m.max())) - min(window.lowest_m, float(eye_m.min()))
        samples = np.array([window.window.rows, window.window.cols])
        farthest = np.abs(eyes["nearest"]).max(axis=0) + samples
        reach = float(np.hypot(*(farthest * self._spacing_m[::-1])))
        return 1e-3 + 1e-6 * (high + self._drop_per_m2 * reach**2)


class ComputeMarcher(RayMarcher):
    """Marches in compute shaders: a lane is a column, many columns a lane."""

    _results: tuple[moderngl.Buffer, ...] = ()
    _rows = 0

    def begin(self, rows: int) -> None:
        """See `RayMarcher.begin`."""
        self._free()
        self._rows = rows
        # Zero rows need no memory, but OpenGL knows no empty buffer.
        size = max(4 * rows * self._width, 4)
        self._results = tuple(self._ctx.buffer(reserve=size) for _ in range(3))

    def read(self) -> Results:
        """See `RayMarcher.read`."""
        shape, size = (self._rows, self._width), 4 * self._rows * self._width
        tan, depth, flags = (result.read()[:size] for result in self._results)
        return Results(
            np.frombuffer(tan, np.float32).reshape(shape),
            np.frombuffer(depth, np.float32).reshape(shape),
            np.frombuffer(flags, np.uint32).reshape(shape).astype(np.uint8),
        )

    def release(self) -> None:
        """See `RayMarcher.release`."""
        self._free()
        super().release()

    def _march(self, program: _Program, eyes: NDArray[np.void], first_row: int) -> None:
        buffer = self._ctx.buffer(eyes.tobytes())
        for binding, bound in enumerate((buffer, *self._results)):
            bound.bind_to_storage_buffer(binding)
        run = self._run(len(eyes))
        groups = math.ceil(self._width / (self._lanes * run))
        at_once = _MAX_GROUPS // groups
        for first in range(0, len(eyes), at_once):
            set_uniforms(program, {"run": run, "first_eye": first, "first_row": first_row})
            program.run(min(at_once, len(eyes) - first) * groups)
        self._ctx.memory_barrier()
        buffer.release()

    @property
    def _lanes(self) -> int:
        # On a CPU eight lanes fill a vector register and a long run makes good first bounds; a
        # GPU has its warps of 32 and wants many of them.
        return 8 if self._context.software else 32

    def _run(self, eyes: int) -> int:
        """Return how many columns a lane takes."""
        longest = 80 if self._context.software else 5
        # With a tolerance the first bounds show in the result, which must not depend on the batch.
        if self._is_exact and eyes < _MANY_EYES:
            longest = max(longest // 8, 1)
        groups = math.ceil(self._width / (self._lanes * longest))
        return math.ceil(self._width / (self._lanes * groups))

    def _free(self) -> None:
        for buffer in self._results:
            buffer.release()
        self._results = ()

    def _compile(self, defines: dict[str, str]) -> moderngl.ComputeShader:
        return compile_compute(self._ctx, "horizon.comp", {"LANES": str(self._lanes), **defines})


class FragmentMarcher(RayMarcher):
    """Marches in fragment shaders: a fragment is a column, a row of the target a view.

    Results wait in main memory, and go to the GPU and back for each march.
    """

    _results: Results

    @property
    def max_rows(self) -> int:
        """See `RayMarcher.max_rows`."""
        return min(super().max_rows, int(self._ctx.info["GL_MAX_TEXTURE_SIZE"]))

    def begin(self, rows: int) -> None:
        """See `RayMarcher.begin`."""
        shape = (rows, self._width)
        self._results = Results(
            np.full(shape, NOTHING), np.zeros(shape, np.float32), np.zeros(shape, np.uint8)
        )

    def read(self) -> Results:
        """See `RayMarcher.read`."""
        return self._results

    def _march(self, program: _Program, eyes: NDArray[np.void], first_row: int) -> None:
        count, results = len(eyes), self._results
        rows, size = slice(first_row, first_row + count), (self._width, count)
        fields = [eyes[name] for name in EYE_DTYPE.names or ()]
        texels = np.concatenate([*fields, np.zeros((count, 2))], axis=1, dtype=np.float32)
        known = np.stack([results.elevation_tan[rows], results.depth_m[rows]], axis=-1)
        with ExitStack() as held:

            def texture(
                size: tuple[int, int], components: int, values: NDArray[Any] | None, dtype: str
            ) -> moderngl.Texture:
                made = self._ctx.texture(size, components, values, dtype=dtype, alignment=1)
                held.callback(made.release)
                made.filter = (moderngl.NEAREST, moderngl.NEAREST)
                return made

            texture((3, count), 4, texels, "f4").use(2)
            texture(size, 2, known, "f4").use(3)
            texture(size, 1, results.flags[rows], "u1").use(4)
            set_uniforms(program, {"eyes": 2, "known": 3, "known_flags": 4})
            skyline, flags = texture(size, 2, None, "f4"), texture(size, 1, None, "u1")
            self._draw(program, [skyline, flags])
            values = np.frombuffer(skyline.read(), np.float32).reshape(count, -1, 2)
            results.elevation_tan[rows], results.depth_m[rows] = values[..., 0], values[..., 1]
            bits = np.frombuffer(flags.read(alignment=1), np.uint8)
            results.flags[rows] = bits.reshape(count, -1)

    def _draw(self, program: moderngl.Program, targets: list[moderngl.Texture]) -> None:
        """Cover two targets of the same size with fragments."""
        ctx = self._ctx
        framebuffer, triangle = ctx.framebuffer(targets), ctx.vertex_array(program, [])
        framebuffer.use()
        ctx.enable_only(moderngl.NOTHING)
        triangle.render(moderngl.TRIANGLES, vertices=3)
        # A framebuffer must not be bound after its release.
        ctx.detect_framebuffer(0).use()
        framebuffer.release()
        triangle.release()

    def _compile(self, defines: dict[str, str]) -> moderngl.Program:
        return compile_program(self._ctx, "fullscreen.vert", "horizon.frag", defines)


def set_uniforms(program: _Program, values: dict[str, Any]) -> None:
    """Set the uniforms that the compiler kept."""
    for name, value in values.items():
        if name in program:
            program[name] = value


def split_float(values: NDArray[np.float64]) -> tuple[Float32Array, Float32Array]:
    """Return the nearest float32 and what it leaves."""
    high = values.astype(np.float32)
    return high, (values - high).astype(np.float32)

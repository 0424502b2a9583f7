"""Runs the horizon march on the GPU: as compute shaders, or as fragment shaders below OpenGL 4.3.

Both read the same windows and eyes and give the same skylines: `horizon_march.glsl` is the march.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.render.context import GlContext
from skyline.render.shaders import compile_compute, compile_program
from skyline.render.trees import SLOPE_BINS, split_float
from skyline.render.windows import WindowTextures

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
_Compiler = Callable[[dict[str, str]], _Program]


@dataclass(frozen=True, slots=True)
class March:
    """What to look for, for eyes that face one way."""

    heading: int
    double: bool
    """Compute crossings in float64, where the OpenGL has it."""
    first: bool
    """Whether nothing was marched for these results before."""


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """What all marches of a renderer share."""

    u: Float64Array
    """(W,) float64. Abscissas of the columns, of magnitude at most 1."""
    tolerance: Float64Array
    """(W,) float64. How far v may fall short of the skyline's in each column; 0 is exact but for
    float32."""
    spacing_m: tuple[float, float]
    """East, north."""
    drop_per_m2: float

    @property
    def width(self) -> int:
        """Number of columns W."""
        return len(self.u)

    @property
    def is_exact(self) -> bool:
        """Whether no column may fall short of its skyline."""
        return not self.tolerance.any()


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Results, (rows, W): elevation_tan (`NOTHING` without data), depth_m float32, flags uint8."""

    elevation_tan: Float32Array
    depth_m: Float32Array
    flags: NDArray[np.uint8]


class RayMarcher(ABC):
    """Holds rows of results on the GPU and raises them by marches."""

    max_rows: int

    def __init__(self, context: GlContext, settings: Settings) -> None:
        self._ctx, self._settings = context.ctx, settings
        self._programs = _Programs(context, settings, self._compile)

    @abstractmethod
    def begin(self, rows: int) -> None:
        """Make room for results; the first march of each row writes it all."""

    @abstractmethod
    def run(
        self, march: March, window: WindowTextures, eyes: NDArray[np.void], first_row: int
    ) -> None:
        """March over a window from every eye; the first eye's result is in ``first_row``."""

    @abstractmethod
    def read(self) -> Results:
        """Return the results."""

    @abstractmethod
    def _compile(self, defines: dict[str, str]) -> _Program: ...

    def release(self) -> None:
        """Free what is held on the GPU."""
        self._programs.release()


class ComputeMarcher(RayMarcher):
    """Marches in compute shaders: a lane is a column, many columns a lane."""

    def __init__(self, context: GlContext, settings: Settings) -> None:
        super().__init__(context, settings)
        self.max_rows = _MAX_RESULT_BYTES // (12 * settings.width)
        # On a CPU eight lanes fill a vector register and a long run makes good first bounds; a
        # GPU has its warps of 32 and wants many of them.
        self._lanes, self._long_run = (8, 80) if context.software else (32, 5)
        self._results: list[moderngl.Buffer] = []
        self._rows = 0

    def begin(self, rows: int) -> None:
        """See `RayMarcher.begin`."""
        self._free()
        self._rows = rows
        cells = rows * self._settings.width
        # Zero rows need no memory, but OpenGL knows no empty buffer.
        self._results = [self._ctx.buffer(reserve=max(4 * cells, 4)) for _ in range(3)]

    def run(
        self, march: March, window: WindowTextures, eyes: NDArray[np.void], first_row: int
    ) -> None:
        """See `RayMarcher.run`."""
        program = self._programs.ready(march, window, eyes)
        buffer = self._ctx.buffer(eyes.tobytes())
        for binding, bound in enumerate((buffer, *self._results)):
            bound.bind_to_storage_buffer(binding)
        run = self._run(len(eyes))
        groups = math.ceil(self._settings.width / (self._lanes * run))
        at_once = _MAX_GROUPS // groups
        for first in range(0, len(eyes), at_once):
            values: dict[str, object] = {
                "run": run,
                "first_eye": first,
                "first_row": first_row,
            }
            set_uniforms(program, values)
            program.run(min(at_once, len(eyes) - first) * groups)
        self._ctx.memory_barrier()
        buffer.release()

    def read(self) -> Results:
        """See `RayMarcher.read`."""
        shape = (self._rows, self._settings.width)
        size = 4 * self._rows * self._settings.width
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

    def _run(self, eyes: int) -> int:
        # With a tolerance the first bounds show in the result, which must not depend on the batch.
        few = self._settings.is_exact and eyes < _MANY_EYES
        longest = max(self._long_run // 8, 1) if few else self._long_run
        groups = math.ceil(self._settings.width / (self._lanes * longest))
        return math.ceil(self._settings.width / (self._lanes * groups))

    def _free(self) -> None:
        for buffer in self._results:
            buffer.release()
        self._results = []

    def _compile(self, defines: dict[str, str]) -> moderngl.ComputeShader:
        return compile_compute(self._ctx, "horizon.comp", {"LANES": str(self._lanes), **defines})


class FragmentMarcher(RayMarcher):
    """Marches in fragment shaders: a fragment is a column, a row of the target a view.

    Results wait in main memory, and go to the GPU and back for each march.
    """

    def __init__(self, context: GlContext, settings: Settings) -> None:
        super().__init__(context, settings)
        largest = int(context.ctx.info["GL_MAX_TEXTURE_SIZE"])
        self.max_rows = min(_MAX_RESULT_BYTES // (12 * settings.width), largest)
        self._results = _no_rows(0, settings.width)

    def begin(self, rows: int) -> None:
        """See `RayMarcher.begin`."""
        self._results = _no_rows(rows, self._settings.width)

    def run(
        self, march: March, window: WindowTextures, eyes: NDArray[np.void], first_row: int
    ) -> None:
        """See `RayMarcher.run`."""
        program = self._programs.ready(march, window, eyes)
        texels = np.concatenate(
            [*(eyes[name] for name in EYE_DTYPE.names or ()), np.zeros((len(eyes), 2))],
            axis=1,
            dtype=np.float32,
        )
        rows = slice(first_row, first_row + len(eyes))
        results = self._results
        known = np.stack([results.elevation_tan[rows], results.depth_m[rows]], axis=-1)
        size = (self._settings.width, len(eyes))
        with ExitStack() as held:
            sources = [
                held.enter_context(self._texture((3, len(eyes)), 4, texels, "f4")),
                held.enter_context(self._texture(size, 2, known, "f4")),
                held.enter_context(self._texture(size, 1, results.flags[rows], "u1")),
            ]
            skyline = held.enter_context(self._texture(size, 2, None, "f4"))
            flags = held.enter_context(self._texture(size, 1, None, "u1"))
            for unit, source in enumerate(sources, start=2):
                source.use(unit)
            set_uniforms(program, {"eyes": 2, "known": 3, "known_flags": 4})
            self._draw(program, [skyline, flags])
            values = np.frombuffer(skyline.read(), np.float32).reshape(len(eyes), -1, 2)
            results.elevation_tan[rows], results.depth_m[rows] = values[..., 0], values[..., 1]
            bits = np.frombuffer(flags.read(alignment=1), np.uint8)
            results.flags[rows] = bits.reshape(len(eyes), -1)

    def read(self) -> Results:
        """See `RayMarcher.read`."""
        return self._results

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

    @contextmanager
    def _texture(
        self, size: tuple[int, int], components: int, values: NDArray[np.generic] | None, dtype: str
    ) -> Iterator[moderngl.Texture]:
        data = None if values is None else np.ascontiguousarray(values)
        texture = self._ctx.texture(size, components, data, dtype=dtype, alignment=1)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        try:
            yield texture
        finally:
            texture.release()

    def _compile(self, defines: dict[str, str]) -> moderngl.Program:
        return compile_program(self._ctx, "fullscreen.vert", "horizon.frag", defines)


class _Programs:
    """Compiles the variants of the march as they are asked for, and sets their uniforms."""

    def __init__(self, context: GlContext, settings: Settings, compile_variant: _Compiler) -> None:
        self._has_double = context.version_code >= _DOUBLE_VERSION
        self._settings, self._compile = settings, compile_variant
        self._compiled: dict[frozenset[tuple[str, str]], _Program] = {}
        aims = [*split_float(settings.u), settings.tolerance.astype(np.float32)]
        self._aims = context.ctx.texture(
            (settings.width, 1), 3, np.stack(aims, axis=-1), dtype="f4", alignment=1
        )
        self._aims.filter = (moderngl.NEAREST, moderngl.NEAREST)

    def ready(self, march: March, window: WindowTextures, eyes: NDArray[np.void]) -> _Program:
        """Return the program for a march, its uniforms set and the window's textures bound."""
        slope_max = window.slope_max[march.heading % 2]
        columns = window.columns[march.heading % 2]
        rims = window.rims
        turned = bool(eyes["turn_tan"].any())
        steepest = slope_max * (1.0 if turned else float(np.abs(self._settings.u).max()))
        defines = self._defines(march, steepest, window.dangling, rims is not None)
        key = frozenset(defines.items())
        if key not in self._compiled:
            self._compiled[key] = self._compile(defines)
        program, settings = self._compiled[key], self._settings
        values: dict[str, object] = {
            "heights_m": 0,
            "slabs": 1,
            "samples": (window.window.cols, window.window.rows),
            "spacing_m": settings.spacing_m,
            "columns_m": 7,
            "columns_end": (columns.width - 1, columns.height - 1),
            "drop_per_m2": settings.drop_per_m2,
            "slack_m": _slack_m(window, eyes, settings),
            "code_m": (window.code.lowest_m, window.code.step_m),
            "levels": list(window.slabs.levels[march.heading]),
            "top_level": window.top_level,
            "bins": SLOPE_BINS,
            "slope_max": slope_max,
            "width": settings.width,
            "aims": 8,
        }
        set_uniforms(program, values)
        window.heights.use(0)
        window.slabs.texture.use(1)
        columns.use(7)
        self._aims.use(8)
        if rims is not None:
            rims.texture.use(6)
            set_uniforms(program, {"rims": 6, "rim_levels": list(rims.levels[march.heading])})
        return program

    def release(self) -> None:
        """Free all programs and what they share."""
        self._aims.release()
        for program in self._compiled.values():
            program.release()
        self._compiled = {}

    def _defines(
        self, march: March, steepest: float, dangling: bool, holes: bool
    ) -> dict[str, str]:
        # Rays fall short of slope_max by a column's half: at equal spacings two cells do.
        cells = math.ceil(steepest) + 1
        switches = {
            "HOLES": holes,
            "DANGLING": dangling,
            "RAISE": not march.first,
        }
        return {
            "HEADING": str(march.heading),
            "CELLS": str(cells),
            "REAL": "double" if march.double and self._has_double else "float",
            **{name: "" for name, on in switches.items() if on},
        }


def set_uniforms(program: _Program, values: dict[str, object]) -> None:
    """Set the uniforms that the compiler kept."""
    for name, value in values.items():
        if name in program:
            program[name] = value


def _no_rows(rows: int, width: int) -> Results:
    shape = (rows, width)
    return Results(
        np.full(shape, NOTHING), np.zeros(shape, np.float32), np.zeros(shape, dtype=np.uint8)
    )


def _slack_m(window: WindowTextures, eyes: NDArray[np.void], settings: Settings) -> float:
    """Return more than all float32 rounding in the y of a crossing."""
    eye_m = eyes["elevation_m"][:, 0]
    high = max(window.highest_m, float(eye_m.max())) - min(window.lowest_m, float(eye_m.min()))
    nearest = np.abs(eyes["nearest"]).max(axis=0) + np.array(
        [window.window.rows, window.window.cols]
    )
    reach = float(np.hypot(*(nearest * settings.spacing_m[::-1])))
    return 1e-3 + 1e-6 * (high + settings.drop_per_m2 * reach**2)

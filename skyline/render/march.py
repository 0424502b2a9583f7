"""Runs the horizon march, the compute shader `horizon.comp`, on the GPU."""

import math
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array
from skyline.render.context import GlContext
from skyline.render.shaders import compile_compute
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
"""As struct Eye of `horizon.comp`; ``nearest`` is relative to the window.

``turn_tan`` is the tangent of an angle by which all of an eye's columns are turned clockwise; none
may leave the view of 90 degrees.
"""

NOTHING = np.float32(-1e30)
"""v of a column that has met no data yet."""

_MAX_GROUPS = 65_535
_MAX_RESULT_BYTES = 1 << 26
_MANY_EYES = 16


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """The skylines of the columns, (rows, W); elevation_tan is `NOTHING` without data."""

    elevation_tan: Float32Array
    depth_m: Float32Array
    flags: NDArray[np.uint8]


class RayMarcher:
    """Holds rows of results and raises them by marches on the GPU.

    A lane of the shader is a column, and takes many columns in turn.

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
        self._programs: dict[frozenset[tuple[str, str]], moderngl.ComputeShader] = {}
        aims = np.stack([*split_float(u), tolerance.astype(np.float32)], axis=-1)
        self._aims = self._ctx.texture((len(u), 1), 3, aims, dtype="f4", alignment=1)
        self._aims.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._results: tuple[moderngl.Buffer, ...] = ()
        self._rows = 0

    @property
    def max_rows(self) -> int:
        """Rows of results that there may be at a time."""
        return _MAX_RESULT_BYTES // (12 * self._width)

    def begin(self, rows: int) -> None:
        """Make room for results; the first march of each row writes all of it."""
        self._free()
        self._rows = rows
        # Zero rows need no memory, but OpenGL knows no empty buffer.
        size = max(4 * rows * self._width, 4)
        self._results = tuple(self._ctx.buffer(reserve=size) for _ in range(3))

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
            Compute crossings in float64.
        first : bool
            Whether no march has written these results before.
        eyes : (N,) of `EYE_DTYPE`
            The eyes that face ``heading``.
        first_row : int
            The first eye's row of the results.
        """
        slope_max = window.slope_max[heading % 2]
        columns = window.columns[heading % 2]
        turned = bool(eyes["turn_tan"].any())
        # Rays fall short of slope_max by a column's half: at equal spacings two cells do.
        cells = math.ceil(slope_max * (1.0 if turned else self._widest_u)) + 1
        switches = {"HOLES": bool(window.rims), "DANGLING": window.dangling, "RAISE": not first}
        program = self._program(
            HEADING=str(heading),
            CELLS=str(cells),
            REAL="double" if double else "float",
            **{name: "" for name, on in switches.items() if on},
        )
        columns_a_lane = self._columns_a_lane(len(eyes))
        textures = {
            "heights_m": window.heights,
            "slabs": window.slabs.texture,
            "columns_m": columns,
            "aims": self._aims,
        }
        values: dict[str, Any] = {
            "samples": (window.window.cols, window.window.rows),
            "spacing_m": self._spacing_m,
            "columns_end": (columns.width - 1, columns.height - 1),
            "drop_per_m2": self._drop_per_m2,
            "slack_m": self._slack_m(window, eyes),
            "code_m": (window.lowest_m, window.code_step_m),
            "levels": list(window.slabs.levels[heading]),
            "top_level": window.top_level,
            "bins": SLOPE_BINS,
            "slope_max": slope_max,
            "width": self._width,
            "run": columns_a_lane,
            "first_row": first_row,
        }
        if window.rims:
            textures["rims"] = window.rims.texture
            values["rim_levels"] = list(window.rims.levels[heading])
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            values[name] = unit
        _set_uniforms(program, values)
        buffer = self._ctx.buffer(eyes.tobytes())
        for binding, bound in enumerate((buffer, *self._results)):
            bound.bind_to_storage_buffer(binding)
        groups = math.ceil(self._width / (self._lanes * columns_a_lane))
        at_once = _MAX_GROUPS // groups
        for first_eye in range(0, len(eyes), at_once):
            _set_uniforms(program, {"first_eye": first_eye})
            program.run(min(at_once, len(eyes) - first_eye) * groups)
        self._ctx.memory_barrier()
        buffer.release()

    def read(self) -> Results:
        """Return the results."""
        shape, size = (self._rows, self._width), 4 * self._rows * self._width
        tan, depth, flags = (result.read()[:size] for result in self._results)
        return Results(
            np.frombuffer(tan, np.float32).reshape(shape),
            np.frombuffer(depth, np.float32).reshape(shape),
            np.frombuffer(flags, np.uint32).reshape(shape).astype(np.uint8),
        )

    def release(self) -> None:
        """Free all buffers, textures and programs on the GPU."""
        self._free()
        self._aims.release()
        for program in self._programs.values():
            program.release()
        self._programs = {}

    @property
    def _lanes(self) -> int:
        # On a CPU eight lanes fill a vector register and a long run makes good first bounds; a
        # GPU has its warps of 32 and wants many of them.
        return 8 if self._context.software else 32

    def _columns_a_lane(self, eyes: int) -> int:
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

    def _program(self, **defines: str) -> moderngl.ComputeShader:
        """Return the march compiled with macros."""
        key = frozenset(defines.items())
        if key not in self._programs:
            defines["LANES"] = str(self._lanes)
            self._programs[key] = compile_compute(self._ctx, "horizon.comp", defines)
        return self._programs[key]

    def _slack_m(self, window: WindowTextures, eyes: NDArray[np.void]) -> float:
        """Return a bound above all float32 rounding in the y of a crossing."""
        eye_m = eyes["elevation_m"][:, 0]
        high = max(window.highest_m, float(eye_m.max())) - min(window.lowest_m, float(eye_m.min()))
        samples = np.array([window.window.rows, window.window.cols])
        farthest = np.abs(eyes["nearest"]).max(axis=0) + samples
        reach = float(np.hypot(*(farthest * self._spacing_m[::-1])))
        return 1e-3 + 1e-6 * (high + self._drop_per_m2 * reach**2)


def _set_uniforms(program: moderngl.ComputeShader, values: dict[str, Any]) -> None:
    """Set the uniforms that the compiler kept."""
    for name, value in values.items():
        if name in program:
            program[name] = value


def split_float(values: NDArray[np.float64]) -> tuple[Float32Array, Float32Array]:
    """Return the nearest float32 and the remainder."""
    high = values.astype(np.float32)
    return high, (values - high).astype(np.float32)

"""Skylines in columns at any abscissas: marches of the compute shader `horizon.comp` on the GPU.

A column's skyline is the greatest v over the edges that its half-plane crosses. The GPU marches
each column's ray over a tree of upper bounds and evaluates only what can still be the greatest;
only v, depth and flags of W columns a view come back.
"""

import math
from dataclasses import dataclass
from typing import Any

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import Float32Array, Float64Array, Rows
from skyline.errors import ContextError, InputError
from skyline.geodesy import Curvature
from skyline.render.context import Renderer, compile_shaders
from skyline.render.eyes import Eyes, split_float
from skyline.render.windows import SLOPE_BINS, Window, WindowTextures
from skyline.skylines import FLAG_NO_DATA
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

MAX_SPACING_RATIO = 64.0

NEAR_ERROR_PX = 0.02
"""Largest error of rounding near the eye, in pixels; float64 is used where float32 exceeds it."""

_NOTHING = np.float32(-1e30)
"""v of a column that has met no data yet, as in the shader."""

_RESIDENT_SAMPLES = 1 << 25
"""Number of samples whose windows stay on the GPU, at some 43 bytes a sample."""

_MAX_GROUPS = 65_535
_MAX_RESULT_BYTES = 1 << 26
_MANY_EYES = 16


@dataclass(frozen=True, slots=True, eq=False)
class Results(Rows):
    """The skylines of N views in W columns, (N, W) each; v and depth are NaN without data."""

    elevation_tan: Float32Array
    depth_m: Float32Array
    flags: NDArray[np.uint8]


class ColumnRenderer(Renderer):
    """Renders skylines of one height field in columns at any abscissas.

    Parameters
    ----------
    u, tolerance : (W,) float64
        Each column's abscissa, of magnitude at most 1, and the greatest amount by which its v may
        be too small; with 0 it is exact to float32.
    near_error : float
        Largest rounding error of v near the eye; float64 is used where float32 exceeds it.

    Raises `InputError` if samples are much longer than wide, and `ContextError` if no OpenGL
    context can be made.
    """

    def __init__(
        self,
        field: HeightField,
        u: Float64Array,
        tolerance: Float64Array,
        near_error: float,
        curvature: Curvature,
    ) -> None:
        self.field, self.width, self.curvature = field, len(u), curvature
        self._near_error = near_error
        self._spacing_m = east, north = field.spacing_east_m, field.spacing_north_m
        if max(east, north) > MAX_SPACING_RATIO * min(east, north):
            raise InputError(
                f"samples are {east:g} x {north:g} m apart; expected one spacing at most "
                f"{MAX_SPACING_RATIO:g} times the other: resample the DEM"
            )
        super().__init__()
        self._ctx = self._context.ctx
        self._is_exact, self._widest_u = not tolerance.any(), float(np.abs(u).max())
        self._max_views = max(_MAX_RESULT_BYTES // (12 * self.width), 1)
        self._programs: dict[frozenset[tuple[str, str]], moderngl.ComputeShader] = {}
        aims = np.stack([*split_float(u), tolerance.astype(np.float32)], axis=-1)
        self._aims = self._ctx.texture((len(u), 1), 3, aims, dtype="f4", alignment=1)
        self._aims.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._results: tuple[moderngl.Buffer, ...] = ()
        self._windows = Window.all_of(field)
        self._resident: dict[Window, WindowTextures] = {}

    def release(self) -> None:  # noqa: D102  (as of the base)
        self._results, self._programs, self._resident = (), {}, {}
        super().release()

    def _skylines(
        self, viewpoints: Viewpoints, heading: NDArray[np.uint8], turn_rad: Float64Array
    ) -> Results:
        """Render N views, in batches whose results fit the GPU; columns without data are flagged.

        ``turn_rad`` (N,) turns the columns of an eye clockwise; none may leave its view.
        """
        starts = range(0, max(len(viewpoints), 1), self._max_views)
        parts = [slice(start, start + self._max_views) for start in starts]
        return Results.concatenate(
            [self._batch(viewpoints[part], heading[part], turn_rad[part]) for part in parts]
        )

    def _batch(
        self, viewpoints: Viewpoints, heading: NDArray[np.uint8], turn_rad: Float64Array
    ) -> Results:
        """Render one batch; see `_skylines`."""
        eyes = Eyes(self.field, viewpoints, heading, self._near_error, turn_rad)
        self._reserve(len(eyes))
        for place, window in enumerate(eyes.nearest_first(self._windows)):
            if place == 0 or self._may_rise(window, eyes):
                textures, near = self._load(window), eyes.relative_to(window)
                for rows, facing, double in eyes.groups():
                    self._march(facing, double, place == 0, textures, near, rows)
        tan, depth, flags = (
            eyes.in_order(self._read(index, len(eyes), kind))
            for index, kind in enumerate(("<f4", "<f4", "<u4"))
        )
        missing, nan = tan == _NOTHING, np.float32(np.nan)
        return Results(
            np.where(missing, nan, tan),
            np.where(missing, nan, depth),
            flags.astype(np.uint8) | np.where(missing, np.uint8(FLAG_NO_DATA), np.uint8(0)),
        )

    def _reserve(self, rows: int) -> None:
        """Make room for ``rows`` rows of results; the first march of a row writes all of it."""
        self._results = ()
        self._ctx.gc()
        # Zero rows need no memory, but OpenGL knows no empty buffer.
        size = max(4 * rows * self.width, 4)
        try:
            self._results = tuple(self._ctx.buffer(reserve=size) for _ in range(3))
        except moderngl.Error as error:
            raise ContextError(
                f"the GPU has no room for skylines of {rows} x {self.width} columns ({error}); "
                "free its memory, or choose a smaller width"
            ) from error

    def _read(self, index: int, rows: int, kind: str) -> NDArray[Any]:
        """Return v (0), depth (1) or flags (2) of the views (rows, W) in sorted order."""
        data = self._results[index].read()[: 4 * rows * self.width]
        return np.frombuffer(data, kind).reshape(rows, self.width)

    def _may_rise(self, window: Window, eyes: Eyes) -> bool:
        """Return whether a window can raise any skyline found so far."""
        rows = slice(window.row, window.row + window.rows)
        cols = slice(window.col, window.col + window.cols)
        highest_m = float(np.fmax.reduce(self.field.heights_m[rows, cols], axis=None))
        if np.isnan(highest_m):
            return False
        least = self._read(0, len(eyes), "<f4").min(axis=1)
        bound = eyes.greatest_tan(window, highest_m, self.curvature.drop_per_m2)
        return bool((bound > least).any())

    def _load(self, window: Window) -> WindowTextures:
        """Return a window's textures, which stay while there is room for them."""
        if window not in self._resident:
            samples = sum(held.rows * held.cols for held in self._resident)
            if samples + window.rows * window.cols > _RESIDENT_SAMPLES:
                self._resident.clear()
                self._ctx.gc()
            self._resident[window] = WindowTextures.shared(self._ctx, self.field, window)
        return self._resident[window]

    def _march(
        self,
        heading: int,
        double: bool,
        first: bool,
        window: WindowTextures,
        near: NDArray[np.void],
        rows: slice,
    ) -> None:
        """March over a window from the eyes ``near[rows]``, all of which face ``heading``.

        Crossings are computed in float64 where ``double``. ``first`` is whether no march has
        written these rows of the results before.
        """
        eyes = near[rows]
        slope_max, columns = window.slope_max[heading % 2], window.columns[heading % 2]
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
            "drop_per_m2": self.curvature.drop_per_m2,
            "slack_m": self._slack_m(window, eyes),
            "code_m": (window.lowest_m, window.code_step_m),
            "levels": list(window.slabs.levels[heading]),
            "top_level": window.top_level,
            "bins": SLOPE_BINS,
            "slope_max": slope_max,
            "width": self.width,
            "run": columns_a_lane,
            "first_row": rows.start,
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
        groups = math.ceil(self.width / (self._lanes * columns_a_lane))
        at_once = _MAX_GROUPS // groups
        for first_eye in range(0, len(eyes), at_once):
            _set_uniforms(program, {"first_eye": first_eye})
            program.run(min(at_once, len(eyes) - first_eye) * groups)
        self._ctx.memory_barrier()

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
        groups = math.ceil(self.width / (self._lanes * longest))
        return math.ceil(self.width / (self._lanes * groups))

    def _program(self, **defines: str) -> moderngl.ComputeShader:
        """Return the march compiled with macros."""
        key = frozenset(defines.items())
        if key not in self._programs:
            defines["LANES"] = str(self._lanes)
            self._programs[key] = compile_shaders(self._ctx, "horizon.comp", defines=defines)
        return self._programs[key]

    def _slack_m(self, window: WindowTextures, eyes: NDArray[np.void]) -> float:
        """Return a bound above all float32 rounding in the y of a crossing."""
        eye_m = eyes["elevation_m"][:, 0]
        high = max(window.highest_m, float(eye_m.max())) - min(window.lowest_m, float(eye_m.min()))
        samples = np.array([window.window.rows, window.window.cols])
        farthest = np.abs(eyes["nearest"]).max(axis=0) + samples
        reach = float(np.hypot(*(farthest * self._spacing_m[::-1])))
        return 1e-3 + 1e-6 * (high + self.curvature.drop_per_m2 * reach**2)


def check_tolerance(tolerance: float, unit: str) -> float:
    """Return ``tolerance`` if it is finite and not negative, else raise `InputError`."""
    if not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise InputError(
            f"tolerance is {tolerance} {unit}; expected a finite number, 0 (exact) or more"
        )
    return float(tolerance)


def _set_uniforms(program: moderngl.ComputeShader, values: dict[str, Any]) -> None:
    """Set the uniforms that the compiler kept."""
    for name, value in values.items():
        if name in program:
            program[name] = value

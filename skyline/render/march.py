"""Skylines in columns at any abscissas, by the compute shader `horizon.comp`.

A column's skyline is the greatest v over the edges that its half-plane crosses. The GPU marches
each column's ray over a tree of upper bounds and evaluates only what can still be the greatest;
only v, depth and flags of W columns a view come back.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import moderngl
import numpy as np
from numpy.typing import NDArray

from skyline.arrays import BoolArray, Float32Array, Float64Array, IntArray, UInt8Array
from skyline.errors import ContextError, InputError
from skyline.geodesy.earth import Curvature
from skyline.render.context import Renderer, compile_shaders, in_context
from skyline.render.field_windows import SLOPE_BINS, GpuLimits, Window, WindowTextures
from skyline.skylines import FLAG_NO_DATA, HEADINGS, Views, raised_to_dip, rotation
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_Scalar = TypeVar("_Scalar", bound=np.generic)

MAX_SPACING_RATIO = 64.0
"""Greatest ratio of a field's two spacings."""

NEAR_ERROR_PX = 0.02
"""Largest rounding error near the eye, in pixels; float64 is used where float32 exceeds it."""

_NOTHING = np.float32(-1e30)
"""v of a column that has met no data yet, as in the shader."""

_EYE_DTYPE = np.dtype(
    [
        ("nearest", "<i4", 2),
        ("offset", "<f4", 2),
        ("offset_low", "<f4", 2),
        ("elevation_m", "<f4", 2),
        ("turn_tan", "<f4", 2),
        ("row", "<i4", 2),
    ]
)
"""The layout of struct Eye in `horizon.comp`; ``nearest`` is relative to the window.

``turn_tan`` is the tangent of an angle by which all of an eye's columns are turned clockwise; none
may leave the view of 90 degrees. The first value of ``row`` is the eye's row in the results.
"""
_OUTLOOKS_AT_ONCE = 1 << 20
"""Pairs of an eye and a window that are looked at together: they take some 0.2 GB."""
_TOUCHED_U = 1e-5
"""A ray this close to a window, in u, counts as meeting it; this is more than any rounding."""


@dataclass(frozen=True, slots=True)
class EyeGroup:
    """Eyes that one march takes together."""

    rows: IntArray
    """Their rows in sorted order."""
    heading: int
    """The heading that all of them face."""
    is_double: bool
    """Whether their crossings are computed in float64."""


class Eyes:
    """The eyes of N views, sorted by kind of march.

    ``turn_rad`` (N,) is the angle by which all columns of an eye are turned clockwise.
    ``near_error_v`` is the greatest error of v that rounding may make.
    """

    def __init__(
        self,
        field: HeightField,
        viewpoints: Viewpoints,
        heading: UInt8Array,
        near_error_v: float,
        turn_rad: Float64Array,
    ) -> None:
        self._spacing_m = np.array([field.spacing_north_m, field.spacing_east_m])
        row, col = field.to_grid(easting_m=viewpoints.easting_m, northing_m=viewpoints.northing_m)
        is_double = _needs_double(field, viewpoints, row, col, near_error_v)
        self._order = np.lexsort((is_double, heading))
        self._is_double = is_double[self._order]
        self._heading = heading[self._order]
        self._position = np.stack([row, col], axis=-1)[self._order]
        self._elevation_m = viewpoints.eye_elevation_m[self._order]
        self._turn_tan = np.tan(turn_rad)[self._order]

    def __len__(self) -> int:
        return len(self._order)

    def groups(self, of: IntArray) -> Iterator[EyeGroup]:
        """Yield the eyes ``of`` for each occurring heading and precision."""
        kind = 2 * self._heading[of].astype(np.int64) + self._is_double[of]
        for value in np.unique(kind):
            rows = of[kind == value]
            yield EyeGroup(rows, heading=int(value) // 2, is_double=bool(value % 2))

    def in_order(self, values: NDArray[_Scalar]) -> NDArray[_Scalar]:
        """Put (N, ...) results of sorted views back into the order given."""
        return values[np.argsort(self._order)]

    def relative_to(self, window: Window) -> NDArray[np.void]:
        """Return the sorted eyes (N,) in a window, for the shader."""
        eyes = np.zeros(len(self), dtype=_EYE_DTYPE)
        nearest = np.rint(self._position)
        eyes["nearest"] = nearest.astype(np.int64) - (window.row, window.col)
        eyes["offset"], eyes["offset_low"] = split_float(self._position - nearest)
        eyes["elevation_m"] = np.stack(split_float(self._elevation_m), axis=-1)
        eyes["turn_tan"] = np.stack(split_float(self._turn_tan), axis=-1)
        eyes["row"][:, 0] = np.arange(len(self))
        return eyes

    def nearest_of(self, windows: Sequence[Window]) -> IntArray:
        """Return the index (N,) of each eye's own or nearest window."""
        return np.asarray(np.hypot(*np.moveaxis(self._gap_m(windows), -1, 0)).argmin(axis=0))

    def aims(self, u: Float64Array) -> Float64Array:
        """Return the abscissas (N, W) at which the columns of each eye aim.

        ``u`` (W,) are the columns' abscissas before the eyes are turned.
        """
        turn = self._turn_tan[:, np.newaxis]
        return (u + turn) / (1.0 - u * turn)

    def outlook(
        self, windows: Sequence[Window], highest_m: Sequence[float], drop_per_m2: float
    ) -> "Outlook":
        """Return how windows lie before the eyes, with heights of at most ``highest_m``."""
        right, ahead = self._across_and_ahead(windows)
        # In a wedge of 90 degrees the depth is at least the distance over the root of 2.
        gap_m = self._gap_m(windows)
        nearest = np.maximum(ahead[0], np.hypot(*np.moveaxis(gap_m, -1, 0)) / np.sqrt(2.0))
        drop_m = drop_per_m2 * (gap_m**2).sum(axis=-1)
        # A metre covers all rounding.
        up_m = np.array(highest_m)[:, np.newaxis] - self._elevation_m + 1.0 - drop_m
        highest_v = up_m / np.maximum(np.where(up_m > 0.0, nearest, ahead[1]), 1e-3)
        # The abscissas between which a window lies, a rectangle whose sides face the camera.
        close, far = np.maximum(ahead, 1e-3)
        return Outlook(
            highest_v=np.where(ahead[1] > 0.0, highest_v, -np.inf),
            first_u=right[0] / np.where(right[0] > 0.0, far, close),
            last_u=right[1] / np.where(right[1] > 0.0, close, far),
        )

    def _across_and_ahead(self, windows: Sequence[Window]) -> tuple[Float64Array, Float64Array]:
        """Return the extents of K windows across and ahead of the eyes, metres.

        Each has the least (K, N) and the greatest distance (K, N), of either sign.
        """
        edges = np.stack(_corners(windows))[:, :, np.newaxis]
        south, east = np.moveaxis((edges - self._position) * self._spacing_m, -1, 0)
        turn = np.stack([rotation(heading)[::2, ::2] for heading in HEADINGS])[self._heading]
        ground = np.stack([east, -south], axis=-1)
        right, ahead = np.moveaxis(np.einsum("ngk,ewnk->ewng", turn, ground), -1, 0)
        return np.sort(right, axis=0), np.sort(ahead, axis=0)

    def _gap_m(self, windows: Sequence[Window]) -> Float64Array:
        """Return the eyes' distances (K, N, 2) from the rows and columns of K windows, metres."""
        first, last = (corner[:, np.newaxis] for corner in _corners(windows))
        outside = np.maximum(np.maximum(first - self._position, self._position - last), 0.0)
        return np.asarray(outside * self._spacing_m, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """How K windows lie before N eyes."""

    highest_v: Float64Array
    """(K, N). Greatest v that a window may have; -inf for one behind the eye."""
    first_u: Float64Array
    """(K, N). Least abscissa at which a window is seen."""
    last_u: Float64Array
    """(K, N). Greatest abscissa at which it is seen."""

    def rises_before(
        self, window: int, of: IntArray, v: Float32Array, aims: Float64Array
    ) -> IntArray:
        """Return before which of the eyes ``of`` a window may rise above their skylines.

        The skylines are ``v`` (N, W), at the abscissas ``aims`` (N, W).
        """
        first_u = self.first_u[window, of, np.newaxis] - _TOUCHED_U
        last_u = self.last_u[window, of, np.newaxis] + _TOUCHED_U
        faces = (aims[of] > first_u) & (aims[of] < last_u)
        is_lower = v[of] < self.highest_v[window, of, np.newaxis]
        return np.asarray(of[(faces & is_lower).any(axis=1)])


def _corners(windows: Sequence[Window]) -> tuple[IntArray, IntArray]:
    """Return row and column (K, 2) of the first and of the last samples of windows."""
    first = np.array([(one.row, one.col) for one in windows])
    return first, first + [(one.rows - 1, one.cols - 1) for one in windows]


def _rings_between(windows: Sequence[Window]) -> IntArray:
    """Return how far each window (K,) is from each (K,): 0 for itself, 1 for its neighbours."""
    places = [(window.row, window.col) for window in windows]
    rows, cols = (np.unique(one, return_inverse=True)[1] for one in np.transpose(places))
    off = [np.abs(one[:, np.newaxis] - one) for one in (rows, cols)]
    return np.asarray(np.maximum(*off))


def split_float(values: Float64Array) -> tuple[Float32Array, Float32Array]:
    """Return the nearest float32 and the remainder."""
    high = values.astype(np.float32)
    return high, (values - high).astype(np.float32)


def _needs_double(
    field: HeightField,
    viewpoints: Viewpoints,
    row: Float64Array,
    col: Float64Array,
    near_error_v: float,
) -> BoolArray:
    """Mark the eyes (N,) whose near edges need float64.

    Near these eyes, float32 blurs v by more than ``near_error_v``.

    A crossing at depth z among heights up to H above or below the eye has v to within r H / z,
    where r is the relative rounding error of its height. An edge nearer than c / (2 (G + H / s)) is
    below what follows it (c the eye's height over ground, G the steepest slope around, s the
    spacing), so that its error cannot show. The edges between these two depths are computed in
    float64.
    """
    steps = np.arange(-1, 3)
    rows = np.clip(np.floor(row).astype(np.int64)[:, None] + steps, 0, field.rows - 1)
    cols = np.clip(np.floor(col).astype(np.int64)[:, None] + steps, 0, field.cols - 1)
    heights = field.samples_at(rows[:, :, None], cols[:, None, :]).astype(np.float64)
    around = heights - viewpoints.eye_elevation_m[:, None, None]
    relief_m = np.fmax.reduce(np.abs(around), axis=(1, 2))
    slopes = [np.abs(np.diff(around, axis=axis)) for axis in (1, 2)]
    steepest_m = np.fmax(*(np.fmax.reduce(slope, axis=(1, 2)) for slope in slopes))
    spacing_m = field.spacing_m
    ground_m = field.height_at(easting_m=viewpoints.easting_m, northing_m=viewpoints.northing_m)
    clearance_m = viewpoints.eye_elevation_m - ground_m
    shows_from_m = clearance_m / (2.0 * (steepest_m + relief_m) / spacing_m + 1e-9)
    rounding = 3.0 * 2.0**-24
    blurred_to_m = rounding * relief_m / near_error_v
    lines = np.stack([row, col, col - row])
    offset = np.abs(lines - np.rint(lines))
    # An eye exactly on a line does not cross it.
    nearest_m = np.where(offset > 0.0, offset, 1.0).min(axis=0) * spacing_m / np.sqrt(2.0)
    return np.asarray(np.fmax(nearest_m, shows_from_m) < blurred_to_m, dtype=bool)


class ColumnRenderer(Renderer):
    """Renders skylines of one height field in columns at any abscissas.

    The skylines are exact to float32.

    ``u`` (W,) are the columns' abscissas, of magnitude at most 1. ``near_error_v`` is the largest
    rounding error of v near the eye; float64 is used where float32 exceeds it.

    Raises `InputError` if samples are much longer than wide, and `ContextError` if no OpenGL
    context can be made.
    """

    @in_context
    def __init__(
        self,
        name: str,
        field: HeightField,
        u: Float64Array,
        near_error_v: float,
        curvature: Curvature | None,
        limits: GpuLimits | None = None,
    ) -> None:
        super().__init__(name)
        self.field = field
        self.width = len(u)
        self.curvature = field.frame.curvature_or(curvature)
        self._limits = limits or GpuLimits()
        self._u = u
        self._widest_u = float(np.abs(u).max())
        self._near_error_v = near_error_v
        self._spacing_m = east, north = field.spacing_east_m, field.spacing_north_m
        if max(east, north) > MAX_SPACING_RATIO * min(east, north):
            raise InputError(
                f"samples are {east:g} x {north:g} m apart; expected one spacing at most "
                f"{MAX_SPACING_RATIO:g} times the other: resample the DEM"
            )
        self._ctx = self._context.ctx
        self._programs: dict[frozenset[tuple[str, str]], moderngl.ComputeShader] = {}
        aims = np.stack(split_float(u), axis=-1)
        self._aims = self._ctx.texture((len(u), 1), 2, aims, dtype="f4", alignment=1)
        self._aims.filter = (moderngl.NEAREST, moderngl.NEAREST)
        self._results: tuple[moderngl.Buffer, ...] = ()
        self._windows = Window.all_of(field, self._limits)
        self._rings = _rings_between(self._windows)
        self._resident: dict[Window, WindowTextures] = {}

    @in_context
    def close(self) -> None:
        """Free this renderer's memory on the GPU."""
        self._results = ()
        self._programs = {}
        self._resident = {}
        super().close()

    @in_context
    def load(self) -> None:
        """Load a field of one window onto the GPU; larger fields wait."""
        if len(self._windows) == 1:
            self._load(self._windows[0])

    @property
    def is_resident(self) -> bool:
        """Whether the whole field stays on the GPU.

        Otherwise each rendering loads it anew.
        """
        samples = sum(window.samples for window in self._windows)
        return samples <= self._limits.resident_samples

    @in_context
    def _skylines(
        self, viewpoints: Viewpoints, heading: UInt8Array, turn_rad: Float64Array
    ) -> Views:
        """Render N views in batches whose results fit the GPU, and whose outlooks the memory.

        The views are turned as `Eyes` says.
        """
        most = _OUTLOOKS_AT_ONCE // len(self._windows)
        at_once = max(min(self._limits.result_bytes // (12 * self.width), most), 1)
        starts = range(0, max(len(viewpoints), 1), at_once)
        parts = [slice(start, start + at_once) for start in starts]
        views = Views.concatenate(
            [self._batch(viewpoints[part], heading[part], turn_rad[part]) for part in parts]
        )
        u = np.tan(np.arctan(self._u) + turn_rad[:, np.newaxis]) if turn_rad.any() else self._u
        return raised_to_dip(views, u, self.field.height_range_m[0], self.curvature)

    def _batch(self, viewpoints: Viewpoints, heading: UInt8Array, turn_rad: Float64Array) -> Views:
        eyes = Eyes(self.field, viewpoints, heading, self._near_error_v, turn_rad)
        self._reserve(len(eyes))
        home = eyes.nearest_of(self._windows)
        for index in np.unique(home):
            self._march(self._windows[index], eyes, np.flatnonzero(home == index), is_first=True)
        if len(self._windows) > 1:
            self._march_on(eyes, home)
        v, depth, flags = (
            eyes.in_order(self._read(index, len(eyes), kind))
            for index, kind in enumerate(("<f4", "<f4", "<u4"))
        )
        missing = v == _NOTHING
        nan = np.float32(np.nan)
        return Views(
            viewpoints.easting_m,
            viewpoints.northing_m,
            viewpoints.eye_elevation_m,
            heading,
            np.where(missing, nan, v),
            np.where(missing, nan, depth),
            flags.astype(np.uint8) | np.where(missing, np.uint8(FLAG_NO_DATA), np.uint8(0)),
        )

    def _reserve(self, rows: int) -> None:
        """Make room for rows of results, which the first march writes whole."""
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
        """Return one result of the views, in their sorted order.

        The results are v (0), depth (1) and flags (2).
        """
        data = self._results[index].read()[: 4 * rows * self.width]
        return np.frombuffer(data, kind).reshape(rows, self.width)

    def _march_on(self, eyes: Eyes, home: IntArray) -> None:
        """Raise the eyes' skylines by the windows around their own, which is ``home`` (N,).

        Near windows come first, since near terrain hides most of what lies behind it. Their order
        depends on an eye alone, so that a view is the same in any batch, its marks of holes
        included.
        """
        ring = self._rings[:, home]
        drop_per_m2 = self.curvature.drop_per_m2
        bounds_m = [self._highest_m(window) for window in self._windows]
        outlook = eyes.outlook(self._windows, bounds_m, drop_per_m2)
        aims = eyes.aims(self._u)
        lowest_v = self._read(0, len(eyes), "<f4").min(axis=1)
        # Skylines only rise: most windows are too low from the beginning.
        ring = np.where(lowest_v < outlook.highest_v, ring, 0)
        for number in range(1, int(ring.max(initial=0)) + 1):
            for index in np.flatnonzero((ring == number).any(axis=1)).tolist():
                of = np.flatnonzero(ring[index] == number)
                v = self._read(0, len(eyes), "<f4")
                of = outlook.rises_before(index, of, v, aims)
                if not len(of):
                    continue
                window = self._windows[index]
                if window not in self._resident:
                    # Of a window that is not loaded, the field may know a bound alone.
                    highest_m = self._load(window).highest_m
                    known = eyes.outlook([window], [highest_m], drop_per_m2)
                    outlook.highest_v[index] = known.highest_v[0]
                    of = outlook.rises_before(index, of, v, aims)
                self._march(window, eyes, of, is_first=False)

    def _highest_m(self, window: Window) -> float:
        """Return the greatest height of a window, or a bound on it.

        -inf where it has none.
        """
        if window in self._resident:
            return self._resident[window].highest_m
        rows = slice(window.row, window.row + window.rows)
        cols = slice(window.col, window.col + window.cols)
        return self.field.highest_m(rows, cols)

    def _load(self, window: Window) -> WindowTextures:
        """Return a window's textures.

        They stay on the GPU until more recently used ones need the room.
        """
        textures = self._resident.pop(window, None)
        if textures is None:
            self._make_room(window.samples)
            textures = WindowTextures.shared(self._context, self.field, window)
        self._resident[window] = textures  # The last used one is the last.
        return textures

    def _make_room(self, samples: int) -> None:
        """Free the least recently used windows, until ``samples`` more have room."""
        held = sum(one.samples for one in self._resident)
        while self._resident and held + samples > self._limits.resident_samples:
            oldest = next(iter(self._resident))
            held -= oldest.samples
            del self._resident[oldest]
        self._ctx.gc()

    def _march(self, window: Window, eyes: Eyes, of: IntArray, *, is_first: bool) -> None:
        """March over a window from the eyes ``of``.

        ``is_first`` is whether no march has written the results of these eyes before.
        """
        textures = self._load(window)
        placed = eyes.relative_to(window)
        for group in eyes.groups(of):
            self._march_group(textures, placed[group.rows], group, is_first)

    def _march_group(
        self, window: WindowTextures, eyes: NDArray[np.void], group: EyeGroup, is_first: bool
    ) -> None:
        """March over a window from the eyes of a group."""
        slope_max = window.slope_max[group.heading % 2]
        # No ray is as steep as slope_max, so at equal spacings it crosses at most two cells.
        steepest = 1.0 if eyes["turn_tan"].any() else self._widest_u
        switches = {"HOLES": bool(window.rims), "DANGLING": window.dangling, "RAISE": not is_first}
        program = self._program(
            HEADING=str(group.heading),
            CELLS=str(math.ceil(slope_max * steepest) + 1),
            REAL="double" if group.is_double else "float",
            **{name: "" for name, on in switches.items() if on},
        )
        columns_a_lane = self._columns_a_lane(len(eyes))
        uniforms = self._uniforms(window, eyes, group.heading)
        uniforms["run"] = columns_a_lane
        for unit, (name, texture) in enumerate(self._textures(window, group.heading).items()):
            texture.use(unit)
            uniforms[name] = unit
        _set_uniforms(program, uniforms)
        buffer = self._ctx.buffer(eyes.tobytes())
        for binding, bound in enumerate((buffer, *self._results)):
            bound.bind_to_storage_buffer(binding)
        groups = math.ceil(self.width / (self._lanes * columns_a_lane))
        # Every OpenGL starts 65,535 work groups at once.
        at_once = 65_535 // groups
        for first_eye in range(0, len(eyes), at_once):
            _set_uniforms(program, {"first_eye": first_eye})
            program.run(min(at_once, len(eyes) - first_eye) * groups)
        self._ctx.memory_barrier()

    def _uniforms(
        self, window: WindowTextures, eyes: NDArray[np.void], heading: int
    ) -> dict[str, Any]:
        """Return the shader's uniforms of a window and of eyes.

        All eyes face ``heading``.
        """
        columns = window.columns[heading % 2]
        uniforms: dict[str, Any] = {
            "samples": (window.window.cols, window.window.rows),
            "spacing_m": self._spacing_m,
            "columns_end": (columns.width - 1, columns.height - 1),
            "drop_per_m2": self.curvature.drop_per_m2,
            "slack_m": self._slack_m(window, eyes),
            "code_m": (window.lowest_m, window.code_step_m),
            "levels": list(window.slabs.levels[heading]),
            "top_level": window.top_level,
            "bins": SLOPE_BINS,
            "slope_max": window.slope_max[heading % 2],
            "width": self.width,
        }
        if window.rims:
            uniforms["rim_levels"] = list(window.rims.levels[heading])
        return uniforms

    def _textures(self, window: WindowTextures, heading: int) -> dict[str, moderngl.Texture]:
        """Return a heading's textures of a window, by the shader's names."""
        textures = {
            "present": window.present,
            "slabs": window.slabs.texture,
            "columns_m": window.columns[heading % 2],
            "aims": self._aims,
        }
        if window.rims:
            textures["rims"] = window.rims.texture
        return textures

    @property
    def _lanes(self) -> int:
        # On a CPU eight lanes fill a vector register and a long run makes good first bounds; a
        # GPU has its warps of 32 and wants many of them.
        return 8 if self._context.software else 32

    def _columns_a_lane(self, eyes: int) -> int:
        longest = 80 if self._context.software else 5
        # Few eyes with long runs of columns would leave cores without work.
        if eyes < 16:
            longest = max(longest // 8, 1)
        groups = math.ceil(self.width / (self._lanes * longest))
        return math.ceil(self.width / (self._lanes * groups))

    def _program(self, **defines: str) -> moderngl.ComputeShader:
        key = frozenset(defines.items())
        if key not in self._programs:
            defines["LANES"] = str(self._lanes)
            self._programs[key] = compile_shaders(self._ctx, "horizon.comp", defines=defines)
        return self._programs[key]

    def _slack_m(self, window: WindowTextures, eyes: NDArray[np.void]) -> float:
        """Return a bound of the float32 rounding of a crossing's height."""
        eye_m = eyes["elevation_m"][:, 0]
        high = max(window.highest_m, float(eye_m.max())) - min(window.lowest_m, float(eye_m.min()))
        samples = np.array([window.window.rows, window.window.cols])
        farthest = np.abs(eyes["nearest"]).max(axis=0) + samples
        reach = float(np.hypot(*(farthest * self._spacing_m[::-1])))
        return 1e-3 + 1e-6 * (high + self.curvature.drop_per_m2 * reach**2)


def _set_uniforms(program: moderngl.ComputeShader, values: dict[str, Any]) -> None:
    """Set the uniforms that the compiler kept."""
    for name, value in values.items():
        if name in program:
            program[name] = value

"""The horizon rasterizer: skylines themselves, exact to float32, without an image.

A column's skyline is the greatest v over the edges that its half-plane crosses. The GPU marches
each column's ray over a tree of upper bounds and evaluates only what can still be the greatest
(`shaders/horizon.comp`); only v, depth and flags of W columns a view come back.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Self

import moderngl
import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float64Array
from skyline.camera import DEFAULT_WIDTH, HEADINGS, check_width, columns_u, pixel_size
from skyline.errors import ContextError, InputError
from skyline.geodesy import Curvature
from skyline.render.context import acquire_context
from skyline.render.eyes import Eyes
from skyline.render.march import NOTHING, RayMarcher, Results
from skyline.render.windows import Window, WindowTextures
from skyline.skylines import FLAG_NO_DATA, Views
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints

_log = logging.getLogger(__name__)

MAX_SPACING_RATIO = 64.0

NEAR_ERROR_PX = 0.02
"""Largest error of rounding near the eye, in pixels; float64 is used where float32 exceeds it."""

_RESIDENT_SAMPLES = 1 << 25
"""Samples whose windows stay on the GPU, some 43 bytes each."""


class ColumnRenderer:
    """Renders skylines of one height field in columns at any abscissas.

    Parameters
    ----------
    u, tolerance : (W,) float64
        Each column's abscissa, of magnitude at most 1, and how far its v may fall short.
    near_error : float
        Largest rounding error of v near the eye; float64 is used where float32 exceeds it.

    Raises
    ------
    InputError
        Samples are much longer than wide.
    ContextError
        No OpenGL context can be made.
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
        spacing_m = east, north = field.spacing_east_m, field.spacing_north_m
        if max(spacing_m) > MAX_SPACING_RATIO * min(spacing_m):
            raise InputError(
                f"samples are {east:g} x {north:g} m apart; expected one spacing at most "
                f"{MAX_SPACING_RATIO:g} times the other: resample the DEM"
            )
        self._context = acquire_context()
        self._marcher = RayMarcher(self._context, u, tolerance, spacing_m, curvature.drop_per_m2)
        self._max_views = self._marcher.max_rows
        self._windows = Window.all_of(field)
        self._resident: dict[Window, WindowTextures] = {}

    def release(self) -> None:
        """Free this renderer's buffers, textures and programs; the context stays for others."""
        self._marcher.release()
        for window in self._resident.values():
            window.release()
        self._resident = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _batches(
        self, viewpoints: Viewpoints, heading: NDArray[np.uint8], turn_rad: Float64Array
    ) -> Iterator[tuple[slice, Results]]:
        """Render in batches that fit the GPU; where one does not, in halves of it.

        ``turn_rad`` (N,) turns the columns of an eye clockwise; none may leave its view.

        Yields which views, and their skylines in order; at least one batch, be it empty. Without
        data elevation_tan and depth_m are NaN, and skylines flagged.
        """
        stop = -1
        while stop < len(viewpoints):
            start = max(stop, 0)
            part = slice(start, min(start + self._max_views, len(viewpoints)))
            try:
                rows = self._batch(viewpoints[part], heading[part], turn_rad[part])
            except moderngl.Error as error:
                if self._max_views == 1:
                    raise ContextError(
                        f"the GPU cannot hold one view of {self.width} columns over "
                        f"{self.field.cols} x {self.field.rows} samples ({error}); free its memory "
                        "or choose a smaller width"
                    ) from error
                self._max_views //= 2
                _log.warning(
                    "out of GPU memory (%s); going on with %d views a batch", error, self._max_views
                )
            else:
                yield part, rows
                stop = part.stop

    def _batch(
        self, viewpoints: Viewpoints, heading: NDArray[np.uint8], turn_rad: Float64Array
    ) -> Results:
        """Render one batch; see `_batches`."""
        eyes = Eyes(self.field, viewpoints, heading, self._near_error, turn_rad)
        self._marcher.begin(len(eyes))
        for place, window in enumerate(eyes.nearest_first(self._windows)):
            if place == 0 or self._may_rise(window, eyes):
                textures, near = self._load(window), eyes.relative_to(window)
                for rows, facing, double in eyes.groups():
                    self._marcher.run(facing, double, place == 0, textures, near[rows], rows.start)
        found = self._marcher.read()
        tan, depth = eyes.in_order(found.elevation_tan), eyes.in_order(found.depth_m)
        missing = tan == NOTHING
        flags = eyes.in_order(found.flags) | np.where(missing, np.uint8(FLAG_NO_DATA), np.uint8(0))
        nan = np.float32(np.nan)
        return Results(np.where(missing, nan, tan), np.where(missing, nan, depth), flags)

    def _may_rise(self, window: Window, eyes: Eyes) -> bool:
        """Return whether a window can raise any skyline found so far."""
        rows = slice(window.row, window.row + window.rows)
        cols = slice(window.col, window.col + window.cols)
        highest_m = float(np.fmax.reduce(self.field.heights_m[rows, cols], axis=None))
        if np.isnan(highest_m):
            return False
        least = self._marcher.read().elevation_tan.min(axis=1)
        bound = eyes.greatest_tan(window, highest_m, self.curvature.drop_per_m2)
        return bool((bound > least).any())

    def _load(self, window: Window) -> WindowTextures:
        """Return a window's textures, which stay while there is room for them."""
        if window not in self._resident:
            samples = sum(held.rows * held.cols for held in self._resident)
            if samples + window.rows * window.cols > _RESIDENT_SAMPLES:
                while self._resident:
                    self._resident.pop(next(iter(self._resident))).release()
            self._resident[window] = WindowTextures(self._context.ctx, self.field, window)
        return self._resident[window]


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """Settings of views of 90 degrees.

    Attributes
    ----------
    width : int
        Columns W of a view.
    tolerance_px : float
        How far a skyline may fall short of the exact one; 0 is exact but for float32.
    curvature : Curvature
    """

    width: int = DEFAULT_WIDTH
    tolerance_px: float = 0.05
    curvature: Curvature = field(default_factory=Curvature)


class HorizonRenderer(ColumnRenderer):
    """Renders the skylines of one height field in views of 90 degrees.

    Parameters
    ----------
    width : int
        Columns W of a view.
    curvature : Curvature, optional
        Defaults to the Earth's with k = 0.13.
    tolerance_px : float
        How far v may fall short of the skyline's; 0 is exact but for float32.

    Raises
    ------
    InputError
        A width or tolerance out of range, or samples much longer than wide.
    ContextError
        No OpenGL context can be made.
    """

    def __init__(
        self,
        field: HeightField,
        width: int = DEFAULT_WIDTH,
        curvature: Curvature | None = None,
        tolerance_px: float = 0.0,
    ) -> None:
        pixel = pixel_size(check_width(width))
        self.tolerance_px = check_tolerance(tolerance_px, "px")
        super().__init__(
            field,
            columns_u(width),
            np.full(width, self.tolerance_px * pixel),
            NEAR_ERROR_PX * pixel,
            curvature or Curvature(),
        )

    @classmethod
    def of(cls, field: HeightField, config: RenderConfig) -> Self:
        """Return a renderer with the settings of a configuration; raises as the class does."""
        return cls(field, config.width, config.curvature, config.tolerance_px)

    @property
    def description(self) -> str:
        """Name of this rasterizer and of the OpenGL renderer under it, for records."""
        tolerance = f", tolerance {self.tolerance_px:g} px" if self.tolerance_px else ""
        return f"horizon {self.width} columns{tolerance}; {self._context.renderer}"

    def render(self, viewpoints: Viewpoints, headings: ArrayLike | None = None) -> Views:
        """Render skylines.

        Parameters
        ----------
        viewpoints : Viewpoints
            N eyes.
        headings : (N,) array_like of int, optional
            One heading an eye; all four of each by default.

        Returns
        -------
        Views
            N views in order, or 4 N: the four headings of a viewpoint follow one another.
        """
        count = len(viewpoints)
        if headings is None:
            heading = np.tile(np.array(HEADINGS, dtype=np.uint8), count)
            eyes = viewpoints[np.repeat(np.arange(count), len(HEADINGS))]
        else:
            given, eyes = np.asarray(headings), viewpoints
            if given.shape != (count,) or not np.isin(given, HEADINGS).all():
                raise InputError(
                    f"headings have shape {given.shape}; expected ({count},), one of 0, 1, 2, 3 "
                    "an eye"
                )
            heading = given.astype(np.uint8)
        return Views.concatenate(
            [
                Views(
                    eyes.easting_m[part],
                    eyes.northing_m[part],
                    eyes.eye_elevation_m[part],
                    heading[part],
                    rows.elevation_tan,
                    rows.depth_m,
                    rows.flags,
                )
                for part, rows in self._batches(eyes, heading, np.zeros(len(eyes)))
            ]
        )


def check_tolerance(tolerance: float, unit: str) -> float:
    """Return ``tolerance`` if it is one, else raise `InputError`."""
    if not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise InputError(
            f"tolerance is {tolerance} {unit}; expected a finite number, 0 (exact) or more"
        )
    return float(tolerance)


def render_views(
    terrain: HeightField, viewpoints: Viewpoints, config: RenderConfig | None = None
) -> Views:
    """Render the skylines of viewpoints to grid north, east, south, west (4 N views)."""
    config = config or RenderConfig()
    with HorizonRenderer.of(terrain, config) as renderer:
        return renderer.render(viewpoints)

"""The horizon rasterizer: skylines in views and all round, without an image.

`RenderedScene` renders views of one terrain piece by piece, on the thread that owns the context.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Int64Array
from skyline.errors import InputError, SkylineError
from skyline.geodesy.earth import Curvature
from skyline.render.context import RenderThread
from skyline.render.field_windows import GpuLimits
from skyline.render.march import NEAR_ERROR_PX, ColumnRenderer
from skyline.skylines import (
    DEFAULT_WIDTH,
    HEADINGS,
    Horizons,
    Views,
    check_width,
    columns_u,
    pixel_size,
    quadrant_azimuths_rad,
)
from skyline.terrain.data_edge import DataEdge
from skyline.terrain.dem import Dem, read_dem
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints, in_four_views

_T = TypeVar("_T")
_Scalar = TypeVar("_Scalar", bound=np.generic)


@dataclass(frozen=True, slots=True)
class RenderConfig:
    """Settings of views of 90 degrees."""

    width: int = DEFAULT_WIDTH
    """Columns W of a view."""
    curvature: Curvature = field(default_factory=Curvature)


class HorizonRenderer(ColumnRenderer):
    """Renders the skylines of one height field in views of 90 degrees.

    Raises `InputError` if the width is out of range or samples are much longer than wide, and
    `ContextError` if no OpenGL context can be made.
    """

    def __init__(self, field: HeightField, config: RenderConfig) -> None:
        width = check_width(config.width)
        super().__init__(
            f"horizon {width} columns",
            field,
            columns_u(width),
            NEAR_ERROR_PX * pixel_size(width),
            config.curvature,
        )

    def render(self, viewpoints: Viewpoints, headings: ArrayLike | None = None) -> Views:
        """Render the skylines of N eyes, in order.

        ``headings`` (N,) gives each eye one view. By default there are 4 N: the four headings of
        an eye follow one another.
        """
        if headings is None:
            eyes, heading = in_four_views(viewpoints)
        else:
            eyes = viewpoints
            heading = np.asarray(headings, dtype=np.uint8)
        return self._skylines(eyes, heading, np.zeros(len(eyes)))


def render_views(terrain: Dem, viewpoints: Viewpoints, config: RenderConfig | None = None) -> Views:
    """Render skylines of viewpoints to their four headings, as 4 N views.

    The headings are grid north, east, south and west.
    """
    config = config or RenderConfig()
    with HorizonRenderer(read_dem(terrain), config) as renderer:
        return renderer.render(viewpoints)


class RenderedScene:
    """Renders skylines of a terrain, and of its surface if given.

    Any thread may render. With a ``thread`` all views are rendered on it, piece by piece.
    """

    def __init__(
        self,
        terrain: HeightField,
        config: RenderConfig,
        thread: RenderThread | None = None,
        surface: HeightField | None = None,
    ) -> None:
        self.ground_m = ground_of(terrain)
        self.height_sd_m = terrain.height_sd_m
        """Expected standard deviation of the terrain model's heights."""
        self._terrain = terrain
        self._curvature = config.curvature
        self._thread = thread
        # Views of 12,000 columns take a few milliseconds without a GPU.
        self._piece = max(1, 12_000 // config.width)
        fields = [terrain] if surface is None else [terrain, surface]
        self._renderers = self._run(lambda: [HorizonRenderer(one, config) for one in fields])
        # Loading takes a second on a CPU. A search reads its photo and retrieves meanwhile.
        self._loading = threading.Thread(target=self._load, name="loading")
        self._loading.start()

    @cached_property
    def edge(self) -> DataEdge:
        """Edge of the terrain's data."""
        return DataEdge.of(self._terrain, self._curvature)

    def render(
        self, viewpoints: Viewpoints, headings: ArrayLike, urgent: bool = False
    ) -> list[Views]:
        """Render each eye's view along its heading (N,).

        Views of the terrain come first, then those of the surface. A thread that renders for all
        takes ``urgent`` views first, between the pieces of others. Raises `InputError` if the scene
        is closed.
        """
        if not self._renderers:
            raise InputError("the matcher or viewer is closed; make another one")
        along = np.asarray(headings, dtype=np.uint8)
        step = len(along) if self._thread is None else self._piece
        starts = range(0, max(len(along), 1), max(step, 1))
        parts = [slice(start, start + step) for start in starts]
        return [
            Views.concatenate(
                [self._run(partial(one.render, viewpoints[p], along[p]), urgent) for p in parts]
            )
            for one in self._renderers
        ]

    def close(self) -> None:
        """Free the GPU memory of the scene; closing twice is fine."""
        self._loading.join()
        for renderer in self._renderers:
            self._run(renderer.close)
        self._renderers.clear()

    def _load(self) -> None:
        for renderer in self._renderers:
            # What fails here fails again, and is raised, when the scene renders. A program that
            # ends meanwhile starts no threads, which is a RuntimeError.
            with suppress(SkylineError, OSError, MemoryError, RuntimeError):
                self._run(renderer.load)

    def _run(self, task: Callable[[], _T], urgent: bool = False) -> _T:
        return task() if self._thread is None else self._thread.run(task, urgent)


class PanoramaRenderer(ColumnRenderer):
    """Renders the horizons of eyes on one height field.

    A horizon has B bins of azimuth, a multiple of 8. Raises as `HorizonRenderer`, and `InputError`
    if the bins are out of range.
    """

    def __init__(
        self,
        field: HeightField,
        bins: int,
        curvature: Curvature | None = None,
        limits: GpuLimits | None = None,
    ) -> None:
        if bins < 8 or bins % 8:
            raise InputError(f"{bins} azimuth bins; expected a positive multiple of 8")
        self.bins = bins
        self._frame = field.frame
        self._azimuth_rad = quadrant_azimuths_rad(bins)
        super().__init__(
            f"horizon {bins} azimuths",
            field,
            np.tan(self._azimuth_rad),
            NEAR_ERROR_PX * pixel_size(DEFAULT_WIDTH),
            curvature,
            limits,
        )

    def render(
        self, viewpoints: Viewpoints, first_azimuth_rad: ArrayLike | None = None
    ) -> Horizons:
        """Render the horizons of N eyes, in order.

        ``first_azimuth_rad`` (N,) is the grid azimuth of each eye's bin 0: the negative of the
        meridian convergence makes azimuths count from true north. By default the bins lie at
        `skyline.skylines.bin_azimuths_rad`.
        """
        step_rad = 2.0 * np.pi / self.bins
        first_rad = np.full(len(viewpoints), 0.5 * step_rad)
        if first_azimuth_rad is not None:
            first_rad[:] = first_azimuth_rad
        first_bin = np.floor(first_rad / step_rad)
        # Within half a step a column stays in its view of 90 degrees.
        turn_rad = np.repeat(first_rad - (first_bin + 0.5) * step_rad, len(HEADINGS))
        eyes, heading = in_four_views(viewpoints)
        views = self._skylines(eyes, heading, turn_rad)
        cosine = np.cos(self._azimuth_rad + turn_rad[:, np.newaxis]).astype(np.float32)
        bins = (np.arange(self.bins) + first_bin[:, np.newaxis]).astype(np.int64) % self.bins
        return Horizons(
            viewpoints.easting_m,
            viewpoints.northing_m,
            viewpoints.eye_elevation_m,
            self._turned(views.v * cosine, bins),
            self._turned(views.depth_m / cosine, bins),
            self._turned(views.flags, bins),
        )

    def render_from_north(self, viewpoints: Viewpoints, steps: int) -> Horizons:
        """Render N eyes' horizons in steps of azimuth from true north.

        The steps divide the bins.
        """
        turn_deg = self._frame.convergence_deg(
            easting_m=viewpoints.easting_m, northing_m=viewpoints.northing_m
        )
        found = self.render(viewpoints, -np.radians(turn_deg))
        every = slice(None, None, self.bins // steps)
        return replace(
            found,
            elevation_tan=found.elevation_tan[:, every],
            distance_m=found.distance_m[:, every],
            flags=found.flags[:, every],
        )

    def _turned(self, values: NDArray[_Scalar], bins: Int64Array) -> NDArray[_Scalar]:
        """Return values (4 N, B/4) of views in the bins' order."""
        # The first view begins an eighth of a turn before bin 0.
        turned = values.reshape(-1, self.bins)
        return np.take_along_axis(turned, (bins + self.bins // 8) % self.bins, axis=1)

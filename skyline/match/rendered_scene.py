"""The terrain of a store, rendered: in this thread, or piece by piece in one that renders."""

from collections.abc import Callable
from functools import partial
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from skyline.match.match_config import MatchConfig
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.render.thread import RenderThread
from skyline.skylines import Views
from skyline.store import StoreHeader
from skyline.store.stored_dem import curvature_of
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints

T = TypeVar("T")

_PIECE_COLUMNS = 12_000
"""Columns of the views rendered in one piece: a few milliseconds without a GPU."""


class RenderedScene:
    """Terrain as it is seen; see `skyline.match.pose.Scene`.

    Parameters
    ----------
    thread : RenderThread, optional
        Renders; by default the thread that calls does, and no other may.
    surface : HeightField, optional
        How high things on the terrain may rise; see `skyline.terrain.surface`.
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
        self.edge = DataEdge.of(terrain, config.curvature)
        self._thread = thread
        self._piece = max(1, _PIECE_COLUMNS // config.width)
        fields = [terrain] if surface is None else [terrain, surface]
        self._renderers = self._run(
            lambda: [HorizonRenderer.of(field, config) for field in fields], urgent=False
        )

    @classmethod
    def of_store(
        cls,
        terrain: HeightField,
        header: StoreHeader,
        config: MatchConfig,
        thread: RenderThread | None = None,
        surface: HeightField | None = None,
    ) -> Self:
        """Return the terrain of a store as matching renders it."""
        rendering = RenderConfig(
            width=config.render_width,
            tolerance_px=config.render_tolerance_px,
            curvature=curvature_of(header),
        )
        return cls(terrain, rendering, thread, surface)

    def render(self, viewpoints: Viewpoints, headings: ArrayLike, urgent: bool = False) -> Views:
        """Render one view an eye, each along its heading (N,), in order.

        What is ``urgent`` goes before what others wait for, where a thread renders for all.
        """
        return self._rendered(self._renderers[0], viewpoints, headings, urgent)

    def render_surface(self, viewpoints: Viewpoints, headings: ArrayLike) -> Views | None:
        """Render likewise what the surface lets rise above the terrain, where there is one."""
        if len(self._renderers) == 1:
            return None
        return self._rendered(self._renderers[1], viewpoints, headings)

    def release(self) -> None:
        """Free what it holds on the GPU."""
        for renderer in self._renderers:
            self._run(renderer.release, urgent=False)

    def _rendered(
        self,
        renderer: HorizonRenderer,
        viewpoints: Viewpoints,
        headings: ArrayLike,
        urgent: bool = False,
    ) -> Views:
        along = np.asarray(headings, dtype=np.uint8)
        step = len(along) if self._thread is None else self._piece
        starts = range(0, max(len(along), 1), max(step, 1))
        parts = [slice(start, start + step) for start in starts]
        return Views.concatenate(
            [self._run(partial(renderer.render, viewpoints[p], along[p]), urgent) for p in parts]
        )

    def _run(self, task: Callable[[], T], urgent: bool) -> T:
        return task() if self._thread is None else self._thread.run(task, urgent)

"""The terrain of a store, rendered: in this thread, or piece by piece in one that renders."""

from collections.abc import Callable
from typing import Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from skyline.matching.match_config import MatchConfig
from skyline.pipeline.config import RenderConfig, curvature_of, make_renderer
from skyline.render.thread import RenderThread
from skyline.store import StoreHeader
from skyline.terrain.heightfield import HeightField
from skyline.terrain.viewpoints import Viewpoints
from skyline.views import Views

T = TypeVar("T")

_PIECE_COLUMNS = 12_000
"""Columns of the views rendered in one piece: a few milliseconds without a GPU."""


class RenderedScene:
    """Terrain as it is seen; see `skyline.matching.pose.Scene`.

    Parameters
    ----------
    terrain : HeightField
    config : RenderConfig
    thread : RenderThread, optional
        Renders; by default the thread that calls does, and no other may.
    """

    def __init__(
        self, terrain: HeightField, config: RenderConfig, thread: RenderThread | None = None
    ) -> None:
        self.ground_m = terrain.height_at
        self.height_sd_m = terrain.height_sd_m
        self._thread = thread
        self._piece = max(1, _PIECE_COLUMNS // config.width)
        self._renderer = self._run(lambda: make_renderer(terrain, config), urgent=False)

    @classmethod
    def of_store(
        cls,
        terrain: HeightField,
        header: StoreHeader,
        config: MatchConfig,
        thread: RenderThread | None = None,
    ) -> Self:
        """Return the terrain of a store as matching renders it."""
        rendering = RenderConfig(
            width=config.render_width,
            tolerance_px=config.render_tolerance_px,
            curvature=curvature_of(header),
        )
        return cls(terrain, rendering, thread)

    def render(self, viewpoints: Viewpoints, headings: ArrayLike, urgent: bool = False) -> Views:
        """Render one view an eye, each along its heading, in order.

        Parameters
        ----------
        viewpoints : Viewpoints
        headings : (N,) array_like of int
        urgent : bool
            Whether it goes before what others wait for, where a thread renders for all.
        """
        along = np.asarray(headings, dtype=np.uint8)
        if self._thread is None or len(along) <= self._piece:
            return self._run(lambda: self._renderer.render(viewpoints, along), urgent)
        starts = range(0, len(along), self._piece)
        parts = (slice(start, start + self._piece) for start in starts)
        return Views.concatenate([self.render(viewpoints[p], along[p], urgent) for p in parts])

    def release(self) -> None:
        """Free what it holds on the GPU."""
        self._run(self._renderer.release, urgent=False)

    def _run(self, task: Callable[[], T], urgent: bool) -> T:
        return task() if self._thread is None else self._thread.run(task, urgent)

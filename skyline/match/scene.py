"""The terrain of a store: its files, and its rendered views, joined all the way round."""

import logging
from collections.abc import Callable
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float64Array, IntArray
from skyline.errors import InputError, SkylineError
from skyline.files import is_file
from skyline.render.context import RenderThread, acquire_context
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import FLAG_NO_DATA, Views
from skyline.store.format import StoreHeader
from skyline.terrain.heightfield import HeightField, ground_of
from skyline.terrain.sightlines import DataEdge
from skyline.terrain.viewpoints import Viewpoints

T = TypeVar("T")
Float = TypeVar("Float", np.float32, np.float64)

_log = logging.getLogger(__name__)

VIEW_WIDTH = 360
"""Columns of the views that refinement renders."""
_PIECE_COLUMNS = 12_000
"""Columns of the views rendered in one piece: a few milliseconds without a GPU."""


class RenderedScene:
    """Terrain that renders views of its skyline, and of a surface that may stand on it, if any.

    With a ``thread`` all views are rendered on it, piece by piece; without one only the thread that
    makes the scene may render.
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
        self._terrain, self._curvature = terrain, config.curvature
        self._thread = thread
        self._piece = max(1, _PIECE_COLUMNS // config.width)
        fields = [terrain] if surface is None else [terrain, surface]
        self._renderers = self._run(lambda: [HorizonRenderer(one, config) for one in fields])

    @cached_property
    def edge(self) -> DataEdge | None:
        """Edge of the terrain's data; None if no terrain is taken to lie past it."""
        return DataEdge.of(self._terrain, self._curvature)

    def render(
        self, viewpoints: Viewpoints, headings: ArrayLike, urgent: bool = False
    ) -> list[Views]:
        """Render one view an eye, each along its heading (N,): of the terrain, then of the surface.

        Where a thread renders for all, ``urgent`` views are rendered before those that are not, and
        the pieces leave room for them.

        Raises `InputError` after a release, and `ContextError` in another thread than the maker's.
        """
        if not self._renderers:
            raise InputError("the matcher or viewer has been released; make another one")
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

    def release(self) -> None:
        """Free the GPU memory of the scene."""
        for renderer in self._renderers:
            self._run(renderer.release)
        self._renderers.clear()

    def _run(self, task: Callable[[], T], urgent: bool = False) -> T:
        if self._thread is not None:
            return self._thread.run(task, urgent)
        acquire_context()
        return task()


def terrain_at_hand(header: StoreHeader, otherwise: str) -> HeightField | None:
    """Return the terrain a store was rendered from, read from its DEM files.

    If they cannot be read, a warning names the consequence ``otherwise``, and None is returned.
    Only plain files are read: a store from a stranger must not make the reader open anything else.
    """
    if not header.dem_files:
        why = "the store was built from heights that came from no file; give the DEM (--dem)"
    elif not all(map(is_file, header.dem_files)):
        files = ", ".join(header.dem_files)
        why = f"the store's DEM is not at hand (no file here is {files}); name its files with --dem"
    else:
        try:
            return header.read_dem()
        except SkylineError as error:
            why = f"the store's DEM cannot be used: {error}"
    _log.warning("%s: %s", otherwise, why)
    return None


def joined_views(
    views: Views, row: IntArray, count: int, bins: int
) -> tuple[Float64Array, Float64Array]:
    """Return elevation tangents and horizontal distances (M, B) of views joined by eye.

    ``row`` (N,) is the eye, of ``count`` M, that each view belongs to. Directions without a view,
    or without data, are NaN. On the border of the data and behind a hole the skyline is a lower
    bound. It is used as it is: farther terrain may rise above it in the query, as a tree may
    anywhere.
    """
    y, nearest, cosine = quadrants(views, bins, FLAG_NO_DATA, np.float64)
    distance = views.depth_m[:, nearest].astype(np.float64) / cosine
    bin_ = quadrant_bins(views.heading, bins)
    joined = np.full((2, count, bins), np.nan)
    joined[0, row[:, np.newaxis], bin_] = y
    joined[1, row[:, np.newaxis], bin_] = np.where(np.isfinite(y), distance, np.nan)
    return joined[0], joined[1]


def quadrants(
    views: Views, bins: int, unusable: int, dtype: type[Float]
) -> tuple[NDArray[Float], IntArray, NDArray[Float]]:
    """Return y (N, B / 4) at the bins of each view; NaN in columns with ``unusable`` flags.

    Also return the nearest column of each bin and the cosine of its azimuth, (B / 4,) each.
    Azimuths count from the heading and begin 45 degrees left of it. The left seam lies half a
    column outside the columns' centres and is extrapolated by that; the right one belongs to the
    next heading.
    """
    steps = np.arange(bins // 4) - bins // 8
    azimuth = 2.0 * np.pi / bins * steps
    position = (np.tan(azimuth) + 1.0) * views.width / 2.0 - 0.5
    left = np.clip(np.floor(position).astype(np.intp), 0, views.width - 2)
    share, cosine = (position - left).astype(dtype), np.cos(azimuth).astype(dtype)
    v = np.where(views.flags & unusable, np.nan, views.elevation_tan).astype(dtype)
    # v is linear between columns (exactly so along a straight edge); depth may jump.
    y = (v[:, left] * (1 - share) + v[:, left + 1] * share) * cosine
    return y, left + (share > 0.5), cosine


def quadrant_bins(heading: NDArray[np.integer], bins: int) -> IntArray:
    """Return the bins (N, B / 4) of the full turn that views along headings (N,) cover."""
    quarter = bins // 4
    first = heading[:, np.newaxis].astype(np.intp) * quarter - quarter // 2
    return (first + np.arange(quarter)) % bins

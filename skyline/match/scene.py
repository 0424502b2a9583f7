"""An opened store and its terrain, as matchers search them and render them for refinement."""

import logging
from collections.abc import Callable, Iterable
from functools import cached_property, partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skyline.arrays import Float64Array
from skyline.errors import InputError, SkylineError
from skyline.files import is_file
from skyline.match.profiles import Profiles
from skyline.render.context import RenderThread
from skyline.render.horizon import HorizonRenderer, RenderConfig
from skyline.skylines import Views
from skyline.store import Store, StoreHeader
from skyline.store.format import PLACES
from skyline.store.places import PlaceSource
from skyline.terrain.dem import Dem, read_surface
from skyline.terrain.edge import DataEdge
from skyline.terrain.heightfield import Ground, HeightField, ground_of
from skyline.terrain.viewpoints import Viewpoints

T = TypeVar("T")

_log = logging.getLogger(__name__)

_VIEW_WIDTH = 360
"""Columns of the views that refinement renders."""
_PIECE_COLUMNS = 12_000
"""Columns of the views rendered in one piece: a few milliseconds without a GPU."""
_SHOWN_EYES = 20_000


class RenderedScene:
    """Terrain that renders views of its skyline.

    Parameters
    ----------
    terrain : HeightField
    config : RenderConfig
    thread : RenderThread, optional
        Thread that renders for all others, piece by piece; without one only the thread that makes
        the scene may render.
    surface : HeightField, optional
        Surface of what may stand on the terrain; see `skyline.terrain.dem`.
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
        self.edge: DataEdge | None = DataEdge.of(terrain, config.curvature)
        """Edge of the terrain's data; None if no terrain is taken to lie past it."""
        self._thread = thread
        self._piece = max(1, _PIECE_COLUMNS // config.width)
        fields = [terrain] if surface is None else [terrain, surface]
        self._renderers = self._run(
            lambda: [HorizonRenderer.of(field, config) for field in fields], urgent=False
        )

    def render(self, viewpoints: Viewpoints, headings: ArrayLike, urgent: bool = False) -> Views:
        """Render one view an eye, each along its heading (N,), in order.

        Where a thread renders for all, ``urgent`` views are rendered before the views that are not.
        """
        return self._rendered(self._renderers[0], viewpoints, headings, urgent)

    def render_surface(self, viewpoints: Viewpoints, headings: ArrayLike) -> Views | None:
        """Render the same views of the surface; None if there is no surface."""
        if len(self._renderers) == 1:
            return None
        return self._rendered(self._renderers[1], viewpoints, headings)

    def release(self) -> None:
        """Free the GPU memory of the scene."""
        for renderer in self._renderers:
            self._run(renderer.release, urgent=False)

    def _rendered(
        self,
        renderer: HorizonRenderer,
        viewpoints: Viewpoints,
        headings: ArrayLike,
        urgent: bool = False,
    ) -> Views:
        """Render views; on a thread for all, in pieces that leave room for urgent ones."""
        along = np.asarray(headings, dtype=np.uint8)
        step = len(along) if self._thread is None else self._piece
        starts = range(0, max(len(along), 1), max(step, 1))
        parts = [slice(start, start + step) for start in starts]
        return Views.concatenate(
            [self._run(partial(renderer.render, viewpoints[p], along[p]), urgent) for p in parts]
        )

    def _run(self, task: Callable[[], T], urgent: bool) -> T:
        return task() if self._thread is None else self._thread.run(task, urgent)


class OpenedStore:
    """A store and its terrain, as a matcher is opened on them; each part is read when first used.

    Parameters
    ----------
    path : str or Path
    store : Store
        Open while matchers are opened.
    terrain : HeightField or None
        The terrain given by the user; otherwise it is read from the store's DEM files.
    refine : bool
        Whether `scene` gives the terrain to render.
    thread : RenderThread, optional
    surface : path, paths or HeightField, optional
    """

    def __init__(
        self,
        path: str | Path,
        store: Store,
        terrain: HeightField | None,
        refine: bool,
        thread: RenderThread | None = None,
        surface: Dem | None = None,
    ) -> None:
        self._path, self._store, self._refine = path, store, refine
        self._thread, self._surface = thread, surface
        self.terrain = terrain
        self._is_terrain_sought = False

    def places(self) -> PlaceSource:
        """Return the places; raises `InputError` for a store without any, or of renderings."""
        if not len(self._places):
            raise InputError(f"store {self._path} holds no places; build it first")
        return self._places

    def profiles(self) -> Profiles:
        """Return the renderings, joined; raises `InputError` for a store without any."""
        return Profiles.from_views(_chunks(self._store))

    def eyes(self) -> Callable[[], Viewpoints]:
        """Return a function that returns the store's eyes, or an even selection of very many.

        It reads the places when called, and the store may be closed by then.
        """
        if self._store.header.holds == PLACES:
            return partial(_spaced, self._places)
        views = self._store.eyes()
        eyes = np.stack([views.easting_m, views.northing_m, views.eye_elevation_m])
        found = _viewpoints(np.ascontiguousarray(np.unique(eyes, axis=1)))
        return lambda: found

    def ground(self) -> Ground | None:
        """Return the heights of the terrain; None if its DEM cannot be read."""
        terrain = self._found_terrain()
        return None if terrain is None else ground_of(terrain)

    def edge(self) -> DataEdge | None:
        """Return the edge of the terrain's data; None if its DEM cannot be read."""
        terrain = self._found_terrain()
        return None if terrain is None else DataEdge.of(terrain, self._store.header.curvature)

    def scene(self) -> RenderedScene | None:
        """Return the terrain to render; None without refinement, or if its DEM cannot be read.

        Raises `InputError` where a surface is given and the DEM cannot be read.
        """
        terrain = self._found_terrain()
        if terrain is None and self._surface is not None:
            raise InputError("a surface needs the store's DEM, which is not at hand; give it")
        if terrain is None or not self._refine:
            return None
        over = None if self._surface is None else read_surface(self._surface, terrain)
        curvature = self._store.header.curvature
        config = RenderConfig(_VIEW_WIDTH, curvature=curvature)
        return RenderedScene(terrain, config, self._thread, over)

    @cached_property
    def _places(self) -> PlaceSource:
        return self._store.places()

    def _found_terrain(self) -> HeightField | None:
        if self.terrain is None and not self._is_terrain_sought:
            self._is_terrain_sought = True
            self.terrain = terrain_at_hand(self._store.header, "answers unrefined")
        return self.terrain


def terrain_at_hand(header: StoreHeader, otherwise: str) -> HeightField | None:
    """Return the terrain a store was rendered from, read from its DEM files.

    If they cannot be read, a warning names the consequence ``otherwise``, and None is returned.
    Only plain files are read: a store from a stranger must not make the reader open anything else.
    """
    if not header.dem_files:
        _log.warning(
            "%s: the store was built from heights that came from no file; give the DEM (--dem)",
            otherwise,
        )
        return None
    if not all(map(is_file, header.dem_files)):
        _log.warning(
            "%s: the store's DEM is not at hand (no file here is %s); name its files with --dem",
            otherwise,
            ", ".join(header.dem_files),
        )
        return None
    try:
        return header.read_dem()
    except SkylineError as error:
        _log.warning("%s: the store's DEM cannot be used: %s", otherwise, error)
        return None


def given_terrain(header: StoreHeader, dem: Dem | None) -> HeightField | None:
    """Return a given terrain, read with the options of the store's build; None if none is given."""
    if isinstance(dem, HeightField):
        header.check_dem(dem)
        return dem
    if dem is None:
        return None
    return header.read_dem([dem] if isinstance(dem, str | Path) else dem)


def _spaced(places: PlaceSource) -> Viewpoints:
    """Return the eyes of every n-th place, without reading any skyline."""
    step = max(1, len(places) // _SHOWN_EYES)
    parts, first = [np.empty((3, 0))], 0
    for block in places.blocks():
        eyes = (block.easting_m, block.northing_m, block.eye_elevation_m)
        parts.append(
            np.stack([column[-first % step :: step] for column in eyes]).astype(np.float64)
        )
        first += len(block)
    return _viewpoints(np.concatenate(parts, axis=1))


def _viewpoints(eyes: Float64Array) -> Viewpoints:
    easting_m, northing_m, eye_elevation_m = eyes
    return Viewpoints(easting_m=easting_m, northing_m=northing_m, eye_elevation_m=eye_elevation_m)


def _chunks(store: Store) -> Iterable[tuple[Views, NDArray[np.uint16]]]:
    start = 0
    for views in store.iter_views():
        rows = slice(start, start + len(views))
        yield views, store.keypoint_columns(rows)
        start = rows.stop
